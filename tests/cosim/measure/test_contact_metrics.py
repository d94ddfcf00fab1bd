"""Errors by phase and energy at the ports, against signals with known integrals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.measure.metrics import metric

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recorded:
    """Signals of given columns."""

    t: Array
    columns: Mapping[str, Array]
    units: Mapping[str, str]

    def array(self, prefix: str) -> Array:
        return self.columns[prefix]

    def entries(self, prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}[{i}]" for i in range(self.columns[prefix].shape[1]))

    def unit(self, prefix: str) -> str:
        return self.units[prefix]


T = np.linspace(0.0, 4.0, 4001)
#: q - q_s is (3, 4) in free motion, t < 1, and (0.3 t, 0) in contact.
TOUCH = T >= 1.0
RUN = Recorded(
    T,
    {
        "m.q": np.where(TOUCH[:, None], np.c_[0.3 * T, 0 * T], [3.0, 4.0]) + 1.0,
        "s.q": np.full((len(T), 2), 1.0),
        "s.tau_e": np.c_[np.where(TOUCH, 5.0, 0.0), np.zeros_like(T)],
        "m.tau": np.c_[np.sin(2 * pi * T), np.full_like(T, 2.0)],
        "m.dq": np.c_[np.cos(2 * pi * T), np.full_like(T, 0.5)],
        "s.dq": np.c_[np.full_like(T, 1.0), np.zeros_like(T)],
    },
    {"m.q": "rad", "s.q": "rad", "s.tau_e": "N.m", "m.tau": "N.m", "m.dq": "rad/s",
     "s.dq": "rad/s"},
)  # fmt: skip


def test_the_error_of_free_motion_and_of_contact_are_apart() -> None:
    free = metric("e", "rms_free", ["m.q"], target="s.q", contact=["s.tau_e"]).evaluate(RUN)
    touch = metric("e", "rms_contact", ["m.q"], target="s.q", contact=["s.tau_e"]).evaluate(RUN)
    assert free.value == pytest.approx(5.0) and free.unit == "rad"
    assert free.parts["lasts_s"] == pytest.approx(0.999)
    # 0.3 sqrt(mean of t² from 1 to 4) = 0.3 sqrt(7); the step at the edge adds one interval
    edge = 0.5 * 25.0 * 1e-3
    assert touch.value == pytest.approx(sqrt((0.09 * 21.0 + edge) / 3.001), rel=1e-4)


def test_a_fixed_target_and_a_phase_that_never_occurs() -> None:
    free = metric("f", "rms_free", ["m.tau"], target=[0.0, 0.0], contact=["s.tau_e"])
    assert free.evaluate(RUN).value == pytest.approx(sqrt(0.5 + 4.0), rel=1e-3)
    never = metric("f", "rms_contact", ["m.q"], target="s.q", contact=["s.q"])
    still = Recorded(RUN.t, {**RUN.columns, "s.q": np.zeros((len(T), 2))}, RUN.units)
    assert "never occurs" in never.evaluate(still).detail


def test_the_observer_is_the_integral_of_both_powers() -> None:
    """The hand: ∫ sin cos + 2·0.5 = t + sin²(2πt)/4π; the far port takes 5 (t - 1) from 1 s on."""
    found = metric("E", "energy", ["m.tau", "m.dq", "s.tau_e", "s.dq"]).evaluate(RUN)
    assert found.unit == "J" and found.unit_of("least_share") == "1"
    assert found.parts["final"] == pytest.approx(4.0 - 15.0, abs=0.02)
    assert found.value == found.parts["final"]
    one = metric("E", "energy", ["m.tau", "m.dq"]).evaluate(RUN)
    assert one.value == 0.0 and one.parts["final"] == pytest.approx(4.0, abs=1e-3)
    assert one.parts["put_in"] == pytest.approx(4.0, abs=1e-3)
    assert found.parts["least_share"] == pytest.approx(-11.0 / 4.0, abs=0.01)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"kind": "rms_free", "of": ["m.q"], "target": "s.q"}, "needs 'contact'"),
        ({"kind": "rms_free", "of": ["m.q"], "contact": ["s.tau_e"]}, "needs 'target'"),
        ({"kind": "energy", "of": ["m.tau"], "target": "s.q"}, "takes no 'target'"),
        ({"kind": "norm", "of": ["m.tau"], "contact": ["s.q"]}, "takes no 'contact'"),
    ],
)
def test_keys_that_do_not_fit_are_refused(given: dict[str, object], says: str) -> None:
    kind, of = given.pop("kind"), given.pop("of")
    with pytest.raises(ScenarioError, match=says):
        metric("x", kind, of, **given)  # type: ignore[arg-type]


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ScenarioError, match="force and velocity of one port or of two"):
        metric("x", "energy", ["m.tau", "m.dq", "s.dq"]).evaluate(RUN)
    with pytest.raises(ScenarioError, match="has size 2, its target 1"):
        metric("x", "rms_free", ["m.q"], target=[1.0], contact=["s.tau_e"]).evaluate(RUN)
