"""The column "stable?" for motions with a known result."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError
from cosim.comparison.spec import Stability
from cosim.comparison.verdict import judge

HOW = Stability(
    position=("q",), velocity=("dq",), position_limit=50.0, velocity_limit=100.0, rest=0.01,
    window=5.0,
)  # fmt: skip
T = np.arange(0.0, 60.0, 0.01)


@dataclass(frozen=True)
class Motion:
    """One joint: positions and velocities over `t`, (n,)."""

    q: np.ndarray
    dq: np.ndarray
    t: np.ndarray

    def array(self, prefix):
        return {"q": self.q, "dq": self.dq}[prefix][:, None]

    def entries(self, prefix):
        return (prefix,)

    def unit(self, prefix):
        return {"q": "rad", "dq": "rad/s"}[prefix]


def swing(rate: float, amplitude: float = 1.0, t: np.ndarray = T) -> Motion:
    """An oscillation of 3 rad/s whose amplitude grows as exp(rate t)."""
    envelope = amplitude * np.exp(rate * t)
    return Motion(envelope * np.sin(3 * t) / 3, envelope * np.cos(3 * t), t)


@given(st.floats(0.3, 3.0))
def test_what_decays_quickly_is_at_rest(rate: float) -> None:
    verdict = judge(swing(-rate), HOW)
    assert (verdict.kind, verdict.stable, verdict.text) == ("at rest", True, "yes")


@given(st.floats(0.01, 0.06))
def test_what_decays_slowly_is_settling(rate: float) -> None:
    verdict = judge(swing(-rate), HOW)
    assert (verdict.kind, verdict.stable) == ("settling", True)
    assert verdict.text.startswith("yes: settling, 0.")


@given(st.floats(-0.005, 0.005), st.floats(0.1, 5.0))
def test_what_goes_on_is_moving(rate: float, amplitude: float) -> None:
    verdict = judge(swing(rate, amplitude), HOW)
    assert (verdict.kind, verdict.stable) == ("moving", False)


@given(st.floats(0.01, 0.06))
def test_what_grows_within_the_limits_is_growing(rate: float) -> None:
    verdict = judge(swing(rate), HOW)
    assert (verdict.kind, verdict.stable, verdict.ended) == ("growing", False, True)


@given(st.floats(0.2, 1.0))
def test_what_passes_a_limit_has_diverged_there(rate: float) -> None:
    verdict = judge(swing(rate), HOW)
    assert (verdict.kind, verdict.stable, verdict.ended) == ("diverged", False, False)
    assert np.exp(rate * verdict.time) >= 100.0
    assert np.exp(rate * (verdict.time - 1.2)) < 100.0  # half a swing and a bit later at most


def test_a_failure_within_the_limits_is_a_stop() -> None:
    failure = RunError("motor: no torque left", component="motor", time=1.5)
    verdict = judge(swing(0.0), HOW, failure)
    assert (verdict.kind, verdict.time, verdict.text) == ("stopped", 1.5, "no: stopped at 1.50 s")
    assert verdict.reason == "motor: no torque left"


def test_a_failure_after_a_limit_is_a_divergence() -> None:
    early = swing(4.0, t=T[:200])
    verdict = judge(early, HOW, RunError("left the range", time=2.0))
    assert verdict.kind == "diverged"
    assert verdict.time == pytest.approx(1.15, abs=0.1)
    assert verdict.reason == "left the range"


@pytest.mark.parametrize("value", [nan, np.inf, -np.inf])
def test_what_is_no_number_is_outside(value: float) -> None:
    motion = swing(0.0)
    motion.q[1000] = value
    assert judge(motion, HOW).kind == "diverged"
    assert judge(motion, HOW).time == pytest.approx(10.0)
