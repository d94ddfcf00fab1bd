"""The difference of a rehearsal from its twin: of positions, in each unit."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bridge.results.outcome import positions_rms, twin_text
from cosim.schedule.parts import Slot
from tests.bridge.replay.test_diff import made


def arm(*units: str) -> Any:
    """A system of one arm with a joint in each of these units, of which speeds are recorded too."""
    q = Slot("arm.q", "arm", "q", 0, (len(units),), "rad", units=units)
    dq = Slot("arm.dq", "arm", "dq", len(units), (len(units),), "rad/s")
    step = SimpleNamespace(kind="continuous", outputs=(q, dq))
    return SimpleNamespace(plan=SimpleNamespace(components=(step,)))


@pytest.mark.parametrize(
    ("units", "expected", "text"),
    [
        (("rad", "m", "m"), {"rad": 2.0, "m": np.sqrt(5.0)}, "2 rad RMS, 2.2 m RMS"),
        (("m", "m", "m"), {"m": np.sqrt(14 / 3)}, "2.2 m RMS"),
        (("rad", "rad", "rad"), {"rad": np.sqrt(14 / 3)}, "2.2 rad RMS"),
        (("N", "N", "N"), {}, ""),
    ],
)
def test_positions_differ_in_each_unit(
    tmp_path: Path, units: tuple[str, ...], expected: dict[str, float], text: str
) -> None:
    apart = (2.0, 3.0, 1.0)
    for run, sign, rows in (("a", 0.5, 6), ("b", -0.5, 4)):
        signals = {f"arm.q[{i}]": np.full(rows, sign * apart[i]) for i in range(3)}
        signals |= {f"arm.dq[{i}]": np.full(rows, 99.0 * sign) for i in range(3)}
        made(tmp_path / run, signals)
    found = positions_rms(arm(*units), tmp_path / "a", tmp_path / "b")
    assert found == pytest.approx(expected) and twin_text(found) == text
