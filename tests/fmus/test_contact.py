"""What touches the arm from inside it: walls of three laws, and a hand that lets go and moves."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import fmus
from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.arms.dynamics import inertia
from fmus.build import toolchain
from fmus.models import planar2r
from fmus.models.planar2r import PRESETS, Planar2R

C = Path(fmus.__file__).parent / "c"
SL91 = np.array(PRESETS["SL91"]["theta"])
Values = dict[str, np.ndarray]

WRAPPER = """
#include "contact.h"
#include "export.h"

EXPORT void square_roots(const double *x, double *y, int n) {
    for (int i = 0; i < n; i++) y[i] = square_root(x[i]);
}
"""


@pytest.fixture(
    params=[pytest.param(Planar2R, marks=pytest.mark.slow), planar2r.kernel], ids=["numpy", "c"]
)
def arm(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


def run(arm: Component, u: Values, h: float, steps: int, first: int = 0) -> Iterator[Values]:
    """Outputs at h, 2 h, ... with the inputs `u` all the time."""
    for k in range(first, first + steps):
        yield {name: np.array(value) for name, value in arm.step(k * h, h, u).items()}


# --- walls -----------------------------------------------------------------------------------


LAWS = [0, 1, 2]
EXPONENT = [1.0, 1.0, 1.5]


@pytest.mark.parametrize("law", LAWS)
def test_a_wall_pushes_back_by_its_law_and_never_pulls(arm: Component, law: int) -> None:
    k_w, b_w, q_w = np.full(2, 200.0), np.full(2, 20.0), np.array([0.1, 5.0])
    arm.initialize({"k_w": k_w, "b_w": b_w, "q_w": q_w, "contact": np.array(float(law))})
    seen = list(run(arm, {"tau": np.array([10.0, 0.0])}, 2e-3, 1000))
    for y in seen:
        x = np.maximum(0.0, y["q"] - q_w)
        push = [k_w * x + b_w * y["dq"], x * (k_w + b_w * y["dq"]), x**1.5 * (k_w + b_w * y["dq"])]
        expected = np.where(x > 0, np.maximum(0.0, push[law]), 0.0)
        assert np.allclose(y["tau_e"], expected, rtol=1e-13, atol=1e-12)
    depths = np.array([y["q"][0] - 0.1 for y in seen])
    assert depths[0] < 0 < depths.max()


@pytest.mark.parametrize("law", LAWS)
def test_at_rest_the_wall_holds_the_torque_at_its_depth(arm: Component, law: int) -> None:
    """k_w x^n = tau."""
    wall = {"k_w": np.full(2, 200.0), "q_w": np.array([0.1, 0.7]), "contact": np.array(float(law))}
    arm.initialize({"q": np.array([0.0, 0.5]), "k_d": np.full(2, 30.0), **wall})
    tau = np.array([6.0, 4.0])
    *_, last = run(arm, {"tau": tau}, 5e-3, 2000)
    assert np.allclose(last["tau_e"], tau, atol=1e-3)
    depth = (tau / 200.0) ** (1 / EXPONENT[law])
    assert np.allclose(last["q"], np.array([0.1, 0.7]) + depth, atol=1e-5)


@pytest.mark.parametrize(("law", "continuous"), [(0, False), (1, True), (2, True)])
def test_only_hunt_and_crossley_begin_without_a_jump(
    arm: Component, law: int, continuous: bool
) -> None:
    """Just beyond the wall, at 2 rad/s: the spring and damper jump to b_w dq."""
    wall = {"k_w": np.full(2, 1e3), "b_w": np.full(2, 50.0), "contact": np.array(float(law))}
    arm.initialize({"q": np.array([1e-9, 1e-9]), "dq": np.full(2, 2.0), **wall})
    torque = np.array(arm.initial({})["tau_e"])
    assert np.allclose(torque, 0.0, atol=1e-5) if continuous else np.allclose(torque, 100.0)


def energy_after_a_bounce(arm: Component, law: int, damping: float) -> float:
    """Kinetic energy, J, when the first joint has left the wall it meets at 1 rad/s."""
    wall = {"k_w": np.full(2, 1e3), "b_w": np.full(2, damping), "q_w": np.array([0.1, 9.0])}
    law_of = {"contact": np.array(float(law)), "substeps": np.array(10.0)}
    arm.initialize({"dq": np.array([1.0, 0.0]), **wall, **law_of})
    touched = False
    for y in run(arm, {}, 5e-3, 200):
        if touched and y["q"][0] < 0.1:
            return float(0.5 * y["dq"] @ inertia(SL91, y["q"]) @ y["dq"])
        touched |= bool(y["tau_e"][0] > 0)
    raise AssertionError("the arm did not come back")


@pytest.mark.parametrize(("law", "damping"), [(0, 20.0), (1, 300.0), (2, 300.0)])
def test_a_bounce_gives_energy_back_without_damping_and_loses_it_with(
    arm: Component, law: int, damping: float
) -> None:
    start = 0.5 * float(inertia(SL91, np.zeros(2))[0, 0])
    assert energy_after_a_bounce(arm, law, 0.0) == pytest.approx(start, rel=1e-3)
    assert energy_after_a_bounce(arm, law, damping) < 0.97 * start


@pytest.mark.parametrize("law", [-1.0, 3.0, 0.5])
def test_a_law_that_is_none_is_refused(arm: Component, law: float) -> None:
    with pytest.raises(CosimError, match="contact"):
        arm.initialize({"contact": np.array(law)})


# --- the square root of x^1.5 ----------------------------------------------------------------


def arguments() -> np.ndarray:
    rng = np.random.default_rng(30)
    y = 1 + rng.integers(0, 2**26, 50_000) * 2.0**-26  # squares that are exact
    return np.concatenate(
        [
            rng.uniform(1, 4, 200_000),
            10.0 ** rng.uniform(-300, 300, 50_000),
            4 - np.arange(1, 2000) * 2.0**-51,
            1 + np.arange(2000) * 2.0**-52,
            y**2,
            np.nextafter(y**2, 9),
            np.nextafter(y**2, 0),
            [2.2250738585072014e-308, 1.7e308],
        ]
    )


@pytest.mark.parametrize("compiler", ["host", pytest.param("zig", marks=pytest.mark.slow)])
def test_the_square_root_is_rounded_correctly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: str
) -> None:
    if compiler == "zig":
        monkeypatch.setattr(toolchain, "host_compiler", lambda: None)
    (tmp_path / "wrapper.c").write_text(WRAPPER)
    sources = [tmp_path / "wrapper.c", C / "contact.c"]
    output = tmp_path / f"roots{toolchain.shared_suffix()}"
    toolchain.compile_shared(sources, output, include=[C])
    x = arguments()
    y = np.empty_like(x)
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (x, y)]
    ctypes.CDLL(str(output)).square_roots(*pointers, ctypes.c_int(len(x)))
    assert np.array_equal(y, np.sqrt(x))


# --- the hand --------------------------------------------------------------------------------


HAND = {"k_p": np.full(2, 40.0), "k_d": np.full(2, 20.0)}
U = {"q_h": np.array([2.0, 1.0])}


def test_a_hand_takes_the_arm_along_and_leaves_it_when_it_lets_go(arm: Component) -> None:
    arm.initialize({**HAND, "substeps": np.array(2.0)})
    for k, q_h in enumerate([np.array([0.5, -0.5]), np.array([-1.0, 0.25])]):
        *_, last = run(arm, {"q_h": q_h}, 5e-3, 800, first=800 * k)
        assert np.allclose(last["q"], q_h, atol=0.01)
    moving = list(run(arm, U, 5e-3, 40, first=1600))
    free = list(run(arm, {**U, "grip": np.array(0.0)}, 5e-3, 100, first=1640))
    energy = [float(y["dq"] @ inertia(SL91, y["q"]) @ y["dq"]) for y in (moving[-1], *free)]
    assert energy[0] > 0.1
    assert np.ptp(energy) < 1e-6 * energy[0]
    assert all(np.array_equal(np.abs(y["tau_h"]), np.zeros(2)) for y in free)


def test_a_grip_is_a_scale(arm: Component) -> None:
    arm.initialize({**HAND, "q": np.array([0.3, 0.1]), "dq": np.array([1.0, -2.0])})
    full = np.array(arm.initial(U)["tau_h"])
    half = np.array(arm.initial({**U, "grip": np.array(0.5)})["tau_h"])
    assert np.array_equal(half, 0.5 * full)
    expected = -20.0 * np.array([1.0, -2.0]) - 40.0 * np.array([0.3 - 2.0, 0.1 - 1.0])
    assert np.allclose(full, expected, rtol=1e-15)
