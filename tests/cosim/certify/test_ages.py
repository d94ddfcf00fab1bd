"""Ages that laws and rules allow, in samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim.certify.scenario import age_limits
from cosim.links.laws import Constant, Uniform
from cosim.links.losses import Independent, Lossy
from cosim.links.segments import Segment, Segments
from cosim.links.semantics import (
    Grid,
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    SignalSemantics,
)
from cosim.links.table import DrawnTable
from cosim.predict.ages import age_bound
from tests.cosim.links.queues import QUEUES


def limits(law: Any, rule: Any) -> tuple[int, int | None, bool]:
    return age_limits(DrawnTable("link", Grid(5, 5, 0.001), law, rule, 0), 1000)


def test_ages_that_laws_allow() -> None:
    """In samples of 5 ms; a stale sample that arrives last waits for the next one."""
    law = Uniform(0.1, 0.2, 0.03)
    assert limits(law, SignalSemantics()) == (20, 40, False)
    assert limits(law, PacketSemantics("newest-stamp")) == (20, 40, True)
    assert limits(law, PacketSemantics("last-arrival")) == (20, 60, False)
    assert limits(law, PlayoutSemantics(0.2)) == (40, 40, True)
    assert limits(law, PlayoutSemantics(0.15)) == (30, None, True)
    assert limits(Constant(0.1), PacketSemantics("fifo")) == (20, 20, True)
    lost = Lossy(Constant(0.1), Independent(0.1))
    assert limits(lost, PacketSemantics("newest-stamp")) == (20, None, True)
    assert limits(Constant(0.1), QueueSemantics(50)) == (20, 20, True)
    assert limits(law, QueueSemantics(1)) == (20, 61, False)
    assert limits(lost, QueueSemantics(50)) == (20, None, True)


@pytest.mark.parametrize("rule", QUEUES, ids=str)
@pytest.mark.parametrize("n_r", [5, 10, 20])
@pytest.mark.parametrize("law", [Constant(0.03), Uniform(0.02, 0.025), Uniform(0.02, 0.11, 0.05)])
def test_ages_in_queues_keep_to_the_limits(rule: QueueSemantics, n_r: int, law: Any) -> None:
    table = DrawnTable("x", Grid(5, n_r, 0.001), law, rule, 3)
    least, greatest, ordered = age_limits(table, 1000)
    rows = table.stream().rows(6000)
    held = rows[rows >= 0]
    ages = np.flatnonzero(rows >= 0) * (n_r // 5) - held
    assert greatest is not None and least <= ages.min() and ages.max() <= greatest
    assert not isinstance(law, Constant) or rule.take == "all" or ages.max() >= greatest - n_r // 5
    assert not ordered or (np.diff(held) >= 0).all()


@pytest.mark.parametrize("order", ["last-arrival", "newest-stamp", "fifo"])
@pytest.mark.parametrize("hold", [None, 0.05, 0.2])
def test_drawn_ages_keep_to_the_limits(order: Any, hold: float | None) -> None:
    table = DrawnTable("x", Grid(5, 5, 0.001), Uniform(0.02, 0.11, hold), PacketSemantics(order), 3)
    least, greatest, ordered = age_limits(table, 1000)
    rows = table.stream().rows(20_000)
    held = rows[rows >= 0]
    ages = np.flatnonzero(rows >= 0) - held
    assert greatest is not None and least <= ages.min() and ages.max() <= greatest
    assert ages.max() >= (greatest - 6 if ordered else (least + greatest) // 2)
    assert not ordered or (np.diff(held) >= 0).all()


def test_a_stale_sample_that_arrives_last_is_held() -> None:
    """Sample 0 takes 0.2 s, the next 19 take 0.1 s, then 0.2 s: it is held up to 0.3 s."""
    slow = (Segment(0.0, 0.005, 0.2), Segment(0.1, 1.0, 0.2))
    table = DrawnTable(
        "x", Grid(5, 5, 0.001), Segments(0.1, slow), PacketSemantics("last-arrival"), 0
    )
    rows = table.stream().rows(100)
    held = np.flatnonzero(rows == 0)
    assert held.max() == 59  # looks, of 5 ms each
    _, greatest, _ = age_limits(table, 1000)
    assert greatest is not None and held.max() <= greatest
    assert held.max() * 0.005 <= age_bound(table)
