"""Rows of several lives of a node, joined and compared in pieces, against whole tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.recording.run_folder import _JoinedLives
from bridge.records.node_lives import Life
from bridge.replay import replay

ROW = np.dtype([("slot", "i8"), ("signals", "f8", 3), ("sent", "f8", 2)])


def rows(slots: Any, seed: int = 0) -> Any:
    found = np.zeros(len(slots), ROW)
    random = np.random.default_rng(seed)
    found["slot"] = slots
    found["signals"], found["sent"] = (random.normal(size=(len(slots), k)) for k in (3, 2))
    return found


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(0, 5)), min_size=1, max_size=4),
    st.integers(1, 3),
    st.integers(1, 50),
)
def test_lives_are_joined_as_one_table(
    lives: list[tuple[int, int]], ticks: int, chunk: int
) -> None:
    """Each life has some slots, and begins some slots after the one before has ended."""
    there, begin = {}, 0
    for boot, (length, gap) in enumerate(lives, 1):
        begin += gap
        there[Life("arm", boot)] = rows(range(begin, begin + length), boot)
        begin += length
    joined = _JoinedLives(there, "arm", ticks)
    every = np.concatenate(list(there.values()))
    assert joined.at.tolist() == (ticks * every["slot"]).tolist()
    end = int(joined.at[-1]) + 3
    found = [joined.signals(first, min(chunk, end - first)) for first in range(0, end, chunk)]
    index = [max(0, int((joined.at <= tick).sum()) - 1) for tick in range(end)]
    assert np.concatenate(found).tolist() == every["signals"][index].tolist()


@pytest.mark.parametrize("block", [1, 7, 1 << 13])
def test_the_greatest_difference_of_all_blocks(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "_ROWS", block)
    recorded, found = rows(range(20)), rows(range(18))
    assert replay._greatest(recorded, recorded[:18]) == 0.0
    found[:] = recorded[:18]
    found["signals"][2, 1] -= 5.0
    found["sent"][17, 1] -= 1.0
    found["signals"][3, 0] = np.nan
    recorded["sent"][19] = 100.0  # the other has no such row
    expected = abs(recorded["signals"][2, 1] - found["signals"][2, 1])
    assert replay._greatest(recorded, found) == expected
