"""Drives that tell their state more seldom than their profile says are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.records.node_lives import Life
from bridge.results.drive_states import seldom_told
from tests.bridge.deployments import named

HEARTBEAT, STEP = 1, 32
MS = 1_000_000


def frame(t_ns: int, identifier: int, flags: int) -> NDArray[np.void]:
    """A row of a log."""
    row = np.zeros((), frame_dtype())
    row["t_ns"], row["id"], row["length"], row["flags"] = t_ns, identifier, 8, flags
    return row


def said(folder: Path, periods: dict[int, float]) -> list[str]:
    """The sentences on a log of heartbeats; `periods`: of each drive on the left bus, ms."""
    life = Life("master_control")
    times = [
        (round(t * MS), STEP * drive + HEARTBEAT)
        for drive, period in periods.items()
        for t in np.arange(0.0, 1000.0, period)
    ]
    with Journal.create(folder / life.frames("left"), frame_dtype(), len(times) + 1) as log:
        for t, identifier in sorted(times):
            log.append(*frame(t, identifier, 0).item())
        log.append(*frame(0, STEP + HEARTBEAT, Flags.SENT).item())  # a question of ours
    return list(seldom_told(named("six_axis"), [life], folder))


def test_drives_that_tell_it_as_their_profile_says_are_not_named(tmp_path: Path) -> None:
    assert said(tmp_path, {n: 10.0 for n in range(1, 7)}) == []
    assert said(tmp_path, {1: 25.0}) == []


def test_drives_that_tell_it_seldom_are_named_with_the_setting(tmp_path: Path) -> None:
    (text,) = said(tmp_path, {1: 100.0, 2: 100.0, 3: 10.0})
    assert text.startswith(
        "master_control: drive 1 (and 2) on bus left told its state every 100 ms"
    )
    assert "expected 10 ms (axis.config.can.heartbeat_msg_rate_ms)" in text


def test_one_state_is_no_period(tmp_path: Path) -> None:
    assert said(tmp_path, {1: 2000.0}) == []
