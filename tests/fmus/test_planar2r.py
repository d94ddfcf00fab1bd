"""The arm: what its equations promise, in NumPy and in C."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import log2

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.models import planar2r
from fmus.models.planar2r import PRESETS, Planar2R, gravity, inertia

STILL = {"tau": np.zeros(2), "tau_ext": np.zeros(2)}
SL91 = np.array(PRESETS["SL91"]["theta"])


@pytest.fixture(
    params=[pytest.param(Planar2R, marks=pytest.mark.slow), planar2r.kernel], ids=["numpy", "c"]
)
def arm(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


def run(
    arm: Component, u: dict[str, np.ndarray], h: float, steps: int
) -> Iterator[dict[str, np.ndarray]]:
    """Outputs at 0, h, 2 h, ... with the inputs `u` all the time."""
    yield {name: np.array(value) for name, value in arm.initial(u).items()}
    for k in range(steps):
        yield {name: np.array(value) for name, value in arm.step(k * h, h, u).items()}


def kinetic_energy(y: dict[str, np.ndarray]) -> float:
    return float(0.5 * y["dq"] @ inertia(SL91, y["q"]) @ y["dq"])


def test_free_arm_keeps_its_energy_and_the_momentum_of_its_first_joint(arm: Component) -> None:
    arm.initialize({"q": np.array([0.3, -1.0]), "dq": np.array([1.5, -2.0])})
    seen = list(run(arm, STILL, 2e-3, 1000))
    energy = [kinetic_energy(y) for y in seen]
    momentum = [float((inertia(SL91, y["q"]) @ y["dq"])[0]) for y in seen]
    assert np.ptp(energy) < 1e-8 * energy[0]
    assert np.ptp(momentum) < 1e-9 * abs(momentum[0])


@pytest.mark.parametrize("preset", ["SL91-upright", "unit-upright"])
def test_with_gravity_kinetic_and_potential_energy_change_into_each_other(
    arm: Component, preset: str
) -> None:
    values = {name: np.array(value) for name, value in PRESETS[preset].items()}
    arm.initialize({**values, "q": np.array([0.3, -1.0])})
    seen = list(run(arm, STILL, 1e-3, 800))
    kinetic = [float(0.5 * y["dq"] @ inertia(values["theta"], y["q"]) @ y["dq"]) for y in seen]
    height = [np.sin([y["q"][0], y["q"].sum()]) for y in seen]
    energy = np.array(kinetic) + np.array(height) @ values["theta_g"]
    assert max(kinetic) > 5.0
    assert np.ptp(energy) < 1e-6 * max(kinetic)


def test_gravity_is_held_by_the_same_torque(arm: Component) -> None:
    theta_g, q = np.array(PRESETS["SL91-upright"]["theta_g"]), np.array([0.4, 0.7])
    arm.initialize({"theta_g": theta_g, "q": q})
    *_, last = run(arm, {"tau": gravity(theta_g, q)}, 1e-3, 100)
    assert np.allclose(last["q"], q, rtol=0, atol=1e-12)
    assert np.allclose(last["dq"], 0.0, atol=1e-10)


def test_work_of_a_constant_torque_is_the_energy_gained(arm: Component) -> None:
    tau, tau_ext = np.array([2.0, -1.0]), np.array([-0.5, 0.25])
    first, *_, last = run(arm, {"tau": tau, "tau_ext": tau_ext}, 2e-3, 500)
    work = float((tau + tau_ext) @ (last["q"] - first["q"]))
    assert kinetic_energy(last) == pytest.approx(work, rel=1e-9)


def test_joints_are_not_wrapped(arm: Component) -> None:
    arm.initialize({"dq": np.array([5.0, 0.0])})
    *_, last = run(arm, STILL, 1e-2, 300)
    assert last["q"][0] > 2 * np.pi


def end(arm: Component, h: float, substeps: float = 1.0) -> np.ndarray:
    """(q, dq) after a second in a soft grip."""
    arm.initialize(
        {
            "q": np.array([0.2, -1.2]),
            "dq": np.array([0.5, -0.4]),
            "k_p": np.array([4.0, 2.0]),
            "k_d": np.array([2.0, 1.0]),
            "substeps": np.array(substeps),
        }
    )
    *_, last = run(arm, {"tau": np.array([1.0, 0.5]), "tau_ext": np.zeros(2)}, h, round(1 / h))
    return np.concatenate([last["q"], last["dq"]])


def test_integrator_has_order_four(arm: Component) -> None:
    exact = end(arm, 1 / 512)
    errors = [np.linalg.norm(end(arm, 1 / n) - exact) for n in (32, 64, 128)]
    orders = [log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert all(3.9 < order < 4.3 for order in orders), orders


def test_substeps_are_shorter_steps_with_the_inputs_held(arm: Component) -> None:
    assert np.allclose(end(arm, 1 / 32, substeps=4), end(arm, 1 / 128), rtol=0, atol=1e-13)


def test_outputs_at_the_start_are_the_start_values_and_the_torques_there(arm: Component) -> None:
    q, dq = np.array([0.5, 2.0]), np.array([-1.0, 0.5])
    k_p, k_d, q_h = np.array([10.0, 20.0]), np.array([5.0, 2.0]), np.array([3.5, 3.0])
    arm.initialize({"q": q, "dq": dq, "k_p": k_p, "k_d": k_d})
    y = arm.initial({"tau": np.array([9.0, 9.0]), "tau_ext": np.array([9.0, 9.0]), "q_h": q_h})
    assert np.array_equal(y["q"], q)
    assert np.array_equal(y["dq"], dq)
    assert np.allclose(y["tau_h"], -k_d * dq - k_p * (q - q_h), rtol=1e-15)
    assert np.array_equal(y["tau_e"], np.zeros(2))


def holds(arm: Component, grip: dict[str, np.ndarray]) -> bool:
    """Whether the arm is at q_h after a second of 5 ms steps."""
    arm.initialize(grip)
    q_h = np.array([0.3, -0.2])
    try:
        with np.errstate(all="ignore"):
            *_, last = run(arm, {**STILL, "q_h": q_h}, 5e-3, 200)
    except CosimError:
        return False
    return np.allclose(last["q"], q_h, atol=1e-2)


def test_a_grip_too_stiff_for_the_step_needs_substeps_only(arm: Component) -> None:
    grip = {"k_p": np.full(2, 5000.0), "k_d": np.full(2, 100.0)}
    assert holds(arm, {**grip, "substeps": np.array(20.0)})
    assert not holds(arm, grip)


def test_a_saved_state_continues_exactly(arm: Component) -> None:
    u = {"tau": np.array([1.0, -2.0]), "tau_ext": np.array([0.1, 0.0])}
    arm.initialize({"dq": np.array([0.3, 0.2])})
    arm.step(0.0, 1e-2, u)
    saved = arm.get_state()
    first = {name: np.array(value) for name, value in arm.step(1e-2, 1e-2, u).items()}
    arm.step(2e-2, 1e-2, u)
    arm.set_state(saved)
    again = arm.step(1e-2, 1e-2, u)
    assert all(np.array_equal(first[name], again[name]) for name in first)


@pytest.mark.parametrize(
    "values",
    [
        {"theta": np.array([1.0, 1.0, 0.5])},
        {"theta": np.array([1.0, 0.0, 0.0])},
        {"theta": np.array([-1.0, 0.0, -0.5])},
        {"substeps": np.array(0.0)},
        {"k_p": np.array([-1.0, 0.0])},
        {"q": np.array([np.nan, 0.0])},
        {"gravity": np.array(9.81)},
        {"q": np.zeros(3)},
    ],
    ids=lambda values: f"{next(iter(values))}",
)
def test_values_it_cannot_take_are_refused_with_their_name(
    arm: Component, values: dict[str, np.ndarray]
) -> None:
    with pytest.raises(CosimError, match=next(iter(values))):
        arm.initialize(values)
        arm.initial(STILL)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_input_that_is_not_finite_stops_the_step_and_is_named(
    arm: Component, bad: float
) -> None:
    arm.initialize({})
    before = arm.step(0.0, 1e-3, STILL)
    before = {name: np.array(value) for name, value in before.items()}
    with pytest.raises(CosimError, match="tau_ext"):
        arm.step(1e-3, 1e-3, {**STILL, "tau_ext": np.array([0.0, bad])})
    after = arm.step(1e-3, 1e-3, STILL)
    assert np.allclose(after["q"], before["q"])
