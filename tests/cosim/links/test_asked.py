"""Every rule takes as many delays from a law as it declares, in chunks of any size."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.links.drawing import TableDrawing
from cosim.links.laws import Constant
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.table import DrawnTable
from tests.cosim.links.queues import QUEUES

RULES = [
    SignalSemantics(),
    PacketSemantics("last-arrival"),
    PacketSemantics("newest-stamp"),
    PacketSemantics("fifo"),
    PlayoutSemantics(0.0),
    PlayoutSemantics(0.03),
    PlayoutSemantics(0.5),
    *QUEUES,
]


@dataclass
class Counted:
    """A constant delay of 0 s that counts what is taken of it, and remembers the period (s)."""

    period: Fraction = Fraction(0)
    taken: int = 0

    def stream(self, period, rng):
        self.period = period
        return self

    def take(self, n):
        self.taken += n
        return np.zeros(n)

    def __getattr__(self, name):
        return getattr(Constant(0.0), name)


@pytest.mark.parametrize("rule", RULES, ids=str)
@given(
    n_s=st.integers(1, 7),
    n_r=st.integers(1, 7),
    chunks=st.lists(st.integers(0, 60), max_size=6),
)
def test_what_a_rule_asks_for_is_what_it_takes(rule, n_s, n_r, chunks):
    law = Counted()
    table = DrawnTable("x", Grid(n_s, n_r, 0.005), law, rule, 0)
    drawn = TableDrawing([table])
    given = []  # the address behind the delays that C was handed over
    ask = law.take
    law.take = lambda n: given.append(ask(n)) or given[-1]
    for n in chunks:
        drawn.fill(np.empty(n, np.int32), np.zeros(1, int), np.array([n]))
        if n:
            assert drawn._state["delays"] == given[-1].ctypes.data + given[-1].nbytes
    assert (law.period, law.taken) == rule.asks(table.grid, sum(chunks))
