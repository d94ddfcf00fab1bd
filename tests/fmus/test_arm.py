"""The serial arm: what its equation promises, in C; and that NumPy gives the same numbers."""

from __future__ import annotations

from itertools import pairwise
from math import log2

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.copies import replace
from cosim.base.errors import FmuError, RunError, ScenarioError
from fmus.arms import chain
from fmus.models import arm, planar2r
from fmus.models.arm import Arm
from tests.fmus.chains import energy, fr3, planar, random_chain
from tests.fmus.test_parity import differ, inputs

pytestmark = pytest.mark.usefixtures("compiled_once")

Values = dict[str, np.ndarray]
START = {"q": np.array([0.1, -0.4, 0.2, -1.9, 0.3, 1.6, -0.5])}
ROTOR = np.full(7, 0.02)


def run(component: Component, u: Values, h: float, steps: int) -> list[Values]:
    """Outputs at 0, h, 2 h, ... with the inputs `u` all the time."""
    seen = [component.initial(u)]
    seen += [component.step(k * h, h, u) for k in range(steps)]
    return [{name: np.array(value) for name, value in y.items()} for y in seen]


def fr3_arm(values: Values) -> Component:
    kernel = arm.kernel(joints=7)
    kernel.initialize({**fr3().values(), **START, **values})
    return kernel


def single(inertia: list[float] | None = None, **of_first: float) -> Component:
    """One joint with a rod, 0.03025 kg.m2 about it; a second joint moves a motor only, at rest."""
    kernel = arm.kernel(joints=2)
    rod = [1.0, 0.15, 0.0, 0.0, 0.0005, 0.0, 0.03025, 0.0, 0.0, 0.03025]
    values = {name: np.array([value, 0.0]) for name, value in of_first.items()}
    values |= {"inertia": np.array([inertia or rod, [0.0] * 10]), "armature": np.array([0.0, 1.0])}
    substeps = np.array(of_first.get("substeps", 20.0))
    values |= {"v_f": np.full(2, 1e-3), "substeps": substeps}
    if "q_min" in of_first:
        values["q_min"][1] = -1.0
    kernel.initialize(values)
    return kernel


def random_values(rng: np.random.Generator, n: int) -> Values:
    """A random arm with friction, stops, a grip and walls."""
    return {
        **random_chain(rng, n).values(),
        "armature": rng.uniform(0.05, 0.2, n),
        "q": rng.uniform(-1, 1, n),
        "dq": rng.uniform(-1, 1, n),
        "damping": rng.uniform(0, 1, n),
        "friction": rng.choice([0.0, 0.3], n),
        "v_f": rng.uniform(0.05, 0.2, n),
        "q_min": rng.uniform(-2, -1, n),
        "q_max": rng.uniform(1, 2, n),
        "k_s": rng.choice([0.0, 60.0], n),
        "b_s": rng.uniform(0, 1, n),
        "k_p": rng.uniform(0, 20, n),
        "k_d": rng.uniform(0, 2, n),
        "k_w": rng.uniform(0, 60, n),
        "b_w": rng.uniform(0, 1, n),
        "q_w": rng.uniform(-2, 2, n),
        "contact": np.array(float(rng.integers(0, 3))),
        "substeps": np.array(2.0),
    }


@pytest.mark.parametrize("n", [2, 7, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 16))])
def test_numpy_and_c_agree_on_random_arms(n: int) -> None:
    rng = np.random.default_rng(n)
    kernel, reference = arm.kernel(joints=n), Arm(joints=n)
    for _ in range(3):
        values = random_values(rng, n)
        u = inputs(kernel, rng)
        kernel.initialize(values)
        reference.initialize(values)
        for a, b in zip(run(kernel, u, 1e-3, 6), run(reference, u, 1e-3, 6), strict=True):
            assert not differ(a, b)


def test_a_free_arm_keeps_its_energy() -> None:
    table = fr3()
    seen = run(fr3_arm({"dq": np.array([0.5, -0.4, 0.3, 0.8, -0.6, 0.7, -0.9])}), {}, 1e-3, 400)
    energies = [energy(table, y["q"], y["dq"]) for y in seen[::20]]
    kinetic = [e[0] for e in energies]
    assert max(kinetic) > 10.0
    assert np.ptp([sum(e) for e in energies]) < 1e-6 * max(kinetic)


def test_gravity_is_held_by_the_same_torque() -> None:
    table, q = fr3(), START["q"]
    hold = {"tau": chain.inverse(table, q, np.zeros(7), np.zeros(7))}
    last = run(fr3_arm({"armature": ROTOR}), hold, 1e-3, 200)[-1]
    assert np.allclose(last["q"], q, rtol=0, atol=1e-10)


def test_the_table_of_the_planar_arm_moves_as_the_planar_arm() -> None:
    """With grip and wall, also in a vertical plane."""
    for preset in ("SL91", "SL91-upright"):
        theta = np.array(planar2r.PRESETS[preset]["theta"])
        theta_g = np.array(planar2r.PRESETS[preset].get("theta_g", (0.0, 0.0)))
        shared = {
            "q": np.array([0.3, -1.0]), "dq": np.array([0.5, -0.4]), "k_p": np.array([40.0, 20.0]),
            "k_d": np.array([5.0, 2.0]), "k_w": np.array([300.0, 200.0]),
            "b_w": np.array([3.0, 2.0]), "q_w": np.array([0.8, -0.2]), "contact": np.array(1.0),
        }  # fmt: skip
        of_table, special = arm.kernel(joints=2), planar2r.kernel()
        of_table.initialize({**planar(theta, theta_g).values(), **shared})
        special.initialize({"theta": theta, "theta_g": theta_g, **shared})
        u = {"tau": np.array([1.0, 0.5]), "q_h": np.array([1.5, 0.5])}
        pairs = zip(run(of_table, u, 1e-3, 500), run(special, u, 1e-3, 500), strict=True)
        assert all(not differ(a, b) for a, b in pairs)
        assert run(special, u, 1e-3, 10)[-1]["tau_e"].any()


def test_integrator_has_order_four_and_substeps_are_shorter_steps() -> None:
    u = {"tau": np.array([1.0, 5.0, 0, 5.0, 0, 0, 0])}

    def end(n: int, substeps: float = 1.0) -> np.ndarray:
        values = {"armature": ROTOR, "damping": np.full(7, 0.3), "substeps": np.array(substeps)}
        last = run(fr3_arm(values), u, 0.25 / n, n)[-1]
        return np.concatenate([last["q"], last["dq"]])

    exact = end(512)
    errors = [np.linalg.norm(end(n) - exact) for n in (16, 32, 64)]
    orders = [log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert all(3.8 < order < 4.3 for order in orders), orders
    assert np.allclose(end(16, substeps=4), end(64), rtol=0, atol=1e-12)


def test_friction_stops_the_arm_and_a_stop_holds_it() -> None:
    """Coulomb friction of 0.2 N.m ends a slide of 1 rad/s after v^2 / (2 a)."""
    last = run(single(dq=1.0, friction=0.2), {}, 1e-3, 250)[-1]
    assert last["q"][0] == pytest.approx(0.5 * 0.03025 / 0.2, rel=0.01)
    assert abs(last["dq"][0]) < 1e-6
    for torque, end in ((2.0, 0.24), (-2.0, -0.24)):
        held = single(k_s=50.0, b_s=1.0, q_min=-0.2, q_max=0.2)
        last = run(held, {"tau": np.array([torque, 0.0])}, 1e-3, 2000)[-1]
        assert last["q"][0] == pytest.approx(end, abs=1e-6)


def test_steep_dry_friction_takes_energy_and_stops_a_light_arm() -> None:
    """1 N.m with v_f = 1e-3 rad/s at 1 ms: a decay of 100 and more in a step of the integrator."""
    table = replace(fr3(), g=np.zeros(3), armature=np.full(7, 0.01))
    kernel = arm.kernel(joints=7)
    friction = {"friction": np.ones(7), "v_f": np.full(7, 1e-3), "dq": np.full(7, 0.1)}
    kernel.initialize({**table.values(), **START, **friction})
    seen = run(kernel, {}, 1e-3, 250)
    energies = [energy(table, y["q"], y["dq"])[0] for y in seen]
    assert all(later <= before for before, later in pairwise(energies)), energies
    assert energies[0] > 0.01 and energies[-1] < 1e-4 * energies[0]


def test_steep_dry_friction_stops_a_joint_where_coulomb_friction_does() -> None:
    """F = 1 N.m on J: a slide of 1 rad/s ends after J / F and J / (2 F) rad."""
    last = run(single(friction=1.0, dq=1.0, substeps=1.0), {}, 1e-3, 40)[-1]
    assert last["q"][0] == pytest.approx(0.5 * 0.03025, rel=0.01)
    assert abs(last["dq"][0]) < 1e-6


def test_numpy_makes_as_many_steps_for_friction() -> None:
    values = {**fr3().values(), **START, "friction": np.ones(7), "v_f": np.full(7, 0.02)}
    values |= {"dq": np.full(7, 0.5), "armature": np.full(7, 0.01)}
    ends = []
    for one in (arm.kernel(joints=7), Arm(joints=7)):
        one.initialize(values)
        ends.append(run(one, {}, 1e-3, 2)[-1]["dq"])
    assert np.allclose(*ends, rtol=0.0, atol=1e-12)


def test_a_steep_stop_takes_energy() -> None:
    """A rod of 0.03 kg.m2 at 1 rad/s against 1e6 N.m/rad: 5.7 rad of its oscillation in a step."""
    stop = single(dq=1.0, k_s=1e6, b_s=20.0, q_min=-0.2, q_max=0.01, substeps=1.0)
    seen = run(stop, {}, 1e-3, 60)
    speeds = [abs(y["dq"][0]) for y in seen]
    assert max(speeds) <= 1.0 and seen[-1]["dq"][0] < 0.0 and seen[-1]["q"][0] < 0.01


def test_a_stop_without_stiffness_has_no_damping_either() -> None:
    limits = {"q_min": -0.2, "q_max": 0.05, "dq": 1.0}
    ends = [run(single(**limits, b_s=b), {}, 1e-2, 10)[-1]["dq"][0] for b in (0.0, 5.0)]
    assert ends == [1.0, 1.0]


def test_friction_that_no_step_bears_is_refused() -> None:
    values = {"friction": np.ones(2), "v_f": np.full(2, 1e-6)}
    kernel, reference = arm.kernel(joints=2), Arm(joints=2)
    for one, words in ((kernel, "damping, friction / v_f"), (reference, "friction and stops need")):
        one.initialize(values)
        one.initial({})
        with pytest.raises(RunError, match=f"{words}.*a shorter step"):
            one.step(0.0, 1e-3, {})


def test_a_lift_carries_its_weight() -> None:
    """A vertical prismatic joint: m g / k below the grip, with a period of 2 pi sqrt(m / k)."""
    seen = [y["q"][0] for y in run(single(joint_type=1.0, k_p=100.0), {}, 1e-3, 350)]
    assert min(seen) == pytest.approx(-2 * 9.81 / 100.0, rel=1e-3)
    assert np.argmin(seen) == pytest.approx(1e3 * np.pi * 0.1, abs=2)


def wrong(name: str, index: tuple[int, ...], value: float) -> Values:
    values = {**fr3().values(), **START, "k_s": np.zeros(7), "q_min": np.full(7, -3.0)}
    values[name] = values[name].copy()
    values[name][index] = value
    return values


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (wrong("inertia", (2, 0), -1.0), "link 2: no body has this `inertia`"),
        (wrong("inertia", (3, 9), 0.9), "link 3: no body has this `inertia`"),
        (wrong("inertia", (1, 4), -0.1), "link 1: no body has this `inertia`"),
        (wrong("inertia", (5, 1), 1.0), "link 5: no body has this `inertia`"),
        (wrong("inertia", (5, 2), 1.0), "link 5: no body has this `inertia`"),
        (wrong("inertia", (5, 3), 1.0), "link 5: no body has this `inertia`"),
        (wrong("rotation", (4, 0, 0), 0.9), "link 4: `rotation` is not a rotation matrix"),
        (wrong("rotation", (6,), -np.eye(3)), "link 6: `rotation` is not a rotation matrix"),
        (wrong("q_min", (0,), 2e6), "q_min must be below q_max"),
        (wrong("q_min", (0,), 0.2) | {"k_s": np.ones(7)}, "q is outside the stops"),
        ({"inertia": np.zeros((7, 10))}, "a joint moves no inertia"),
    ],
)
def test_an_arm_that_cannot_be_is_refused(values: Values, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        arm.kernel().initialize(values)
    with pytest.raises(ScenarioError, match="arm"):
        Arm().initialize(values)


def test_rods_laminae_points_and_motors_without_links_are_arms() -> None:
    """Inertias on the border of what can be, with numbers rounded as in a file."""
    for theta in (
        [1.0, 0.5, 0, 0, 0.0, 0, 0.3333333333, 0, 0, 0.3333333333],
        [1.0, 0, 0, 0, 1.0, 0, 2.0, 0, 0, 3.0],
        [3.0, 1.0, 0, 0, 0, 0, 0.3333333333, 0, 0, 0.3333333333],
    ):
        single(theta)
    arm.kernel().initialize({"inertia": np.zeros((7, 10)), "armature": ROTOR})


def test_limits_without_stops_do_not_bind_the_start() -> None:
    fr3_arm({"q_min": np.full(7, 2.0), "q_max": np.full(7, 3.0)})


def test_a_diverging_motion_is_said_and_changes_nothing() -> None:
    kernel = fr3_arm({"k_d": np.full(7, 50.0)})
    before = kernel.get_state()
    with pytest.raises(RunError, match="the motion left the range of numbers"):
        for k in range(50):
            before = kernel.get_state()
            kernel.step(k * 1e-3, 1e-3, {})
    assert np.array_equal(kernel.get_state(), before)  # type: ignore[arg-type]


def test_seventeen_joints_are_refused() -> None:
    with pytest.raises(FmuError, match="joints is 17; expected at most 16"):
        arm.model(joints=17)
