"""Every rule takes as many delays from a law as it declares, in chunks of any size."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.links.grid import Grid
from cosim.links.laws import Constant
from cosim.links.semantics import PacketSemantics, PlayoutSemantics, SignalSemantics

RULES = [
    SignalSemantics(),
    PacketSemantics("last-arrival"),
    PacketSemantics("newest-stamp"),
    PacketSemantics("fifo"),
    PlayoutSemantics(0.0),
    PlayoutSemantics(0.03),
    PlayoutSemantics(0.5),
]


@dataclass(slots=True)
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
    law, grid = Counted(), Grid(n_s, n_r, 0.005)
    rows = rule.stream(law, grid, np.random.default_rng(0))
    for n in chunks:
        assert len(rows.take(n)) == n
    assert (law.period, law.taken) == rule.asks(grid, sum(chunks))
