"""The paper's law for tips: C and NumPy, what its theory promises, special cases that are known."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from cosim.base.errors import CosimError, FmuError
from fmus.arms import chain, task_space
from fmus.arms.chain import Table
from fmus.models import arm_task, arm_tip
from fmus.models.arm_task import ArmTask
from fmus.models.arm_teleoperation import ArmTeleoperation
from fmus.models.arm_tip import ArmTip
from tests.fmus.chains import random_chain, random_rotation
from tests.fmus.test_arm_teleoperation import H, Values, motion, played, values_of
from tests.tiers import first_fast

pytestmark = pytest.mark.usefixtures("compiled_once")


def task_values(n: int, m: int, neighbours: int = 1, seed: int = 0, **given: object) -> Values:
    """Random tables, gains, frames and null motions; `given` instead of some of them."""
    rng = np.random.default_rng(seed)
    made = values_of(n, rng) | {
        "z": rng.uniform(-1, 1, m),
        "tip": rng.uniform(-0.3, 0.3, 3),
        "frame": random_rotation(rng) if m == 6 else rng.normal(size=(m, 3)),
        "lacks": np.zeros(m),
        "x_0": rng.uniform(-1, 1, 3),
        "scale": np.array(1.7),
        "K_x": rng.uniform(0, 20, m),
        "q_n": rng.uniform(-1, 1, n),
        "k_n": rng.uniform(0, 3, n),
        "k_l": rng.uniform(0, 3, n),
        "q_min": rng.uniform(-1, -0.5, n),
        "q_max": rng.uniform(0.5, 1, n),
        "margin": rng.uniform(0.1, 0.4, n),
        "psi_max": rng.uniform(0.5, 2, n),
        "sigma_0": np.array(0.05),
    }
    if m == 6:
        made |= {"q_0": rng.uniform(-1, 1, n), "length": np.array(0.4)}
    if neighbours:
        made["listens"] = rng.choice([0.0, 0.5, 1.0], (neighbours, m))
    return made | {name: np.asarray(value, dtype=float) for name, value in given.items()}


CASES = [
    (5, 3, 2, {"gravity": 2, "lambda_c": 3.0, "age_max": 0.5, "age_fade": 0.4}),
    (7, 6, 1, {"lacks": [0, 0, 0, 0, 1, 0]}),
    (4, 3, 1, {"sigma_0": 1.0, "gravity": 1, "tau_max": np.full(4, 40.0)}),  # always damped
    (3, 2, 0, {"gravity": 0, "sigma_0": 0.3}),  # sometimes
    (2, 3, 1, {"lacks": [0, 0, 1]}),
    (6, 1, 2, {"natural": 0.5}),
    (6, 6, 0, {"sigma_0": 0.3}),
]


@pytest.mark.parametrize(("n", "m", "neighbours", "given"), first_fast(CASES, 3))
def test_c_equals_numpy(n: int, m: int, neighbours: int, given: dict[str, object]) -> None:
    """The reference differentiates the definition of v, the C code has dv/dt in closed form."""
    values = task_values(n, m, neighbours, n, **given)
    made = {"joints": n, "coordinates": m, "neighbours": neighbours}
    reference = ArmTask(**made)
    u = motion(reference, 25, 5)
    in_numpy = played(reference, values, u)
    in_c = played(arm_task.kernel(**made), values, u)
    assert np.allclose(in_c, in_numpy, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_the_jacobian_is_the_derivative_of_the_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table, point, q = random_chain(rng, 6), rng.uniform(-0.3, 0.3, 3), rng.uniform(-2, 2, 6)
    place = partial(task_space.tip, table, point)
    steps = 1e-6 * np.eye(6)
    found = np.array([(place(q + e) - place(q - e)) / 2e-6 for e in steps]).T
    assert np.allclose(task_space.jacobian(table, point, q), found, rtol=0, atol=1e-9)
    twist = list(chain.jacobians(table, q))[-1]  # of the last link, in its own frame
    *_, (R, _) = chain.placements(table, q)
    by_twist = R @ (twist[3:] - chain.skew(point) @ twist[:3])
    assert np.allclose(task_space.jacobian(table, point, q), by_twist, rtol=0, atol=1e-12)


def test_rows_are_the_derivative_of_place_and_turn() -> None:
    values, rng = task_values(6, 6, seed=3, scale=1.0), np.random.default_rng(8)
    q, steps = rng.uniform(-1.5, 1.5, 6), 1e-6 * np.eye(6)
    at = partial(task_space.place, values)
    found = np.array([(at(q + e) - at(q - e)) / 2e-6 for e in steps]).T
    assert np.allclose(task_space.rows(values, q), found, rtol=0, atol=1e-9)


def turned(angle: float) -> tuple[Values, Values]:
    """An arm whose last joint, about z, has turned by `angle` from q_0; outputs of the C code."""
    values = task_values(6, 6, seed=5, length=1.0, frame=np.eye(3))
    values["joint_type"][5] = 0.0
    q = values["q_0"] + np.array([0.0, 0, 0, 0, 0, angle])
    kernel = arm_task.kernel(joints=6, coordinates=6)
    kernel.initialize(values)
    y = kernel.initial({"q": q, "dq": np.zeros(6), "xi_in": np.zeros((1, 6))})
    return values, {name: np.array(value) for name, value in y.items()}


@pytest.mark.parametrize("angle", [0.0, 0.1, -1.0, 1.57, 2.5, -3.1, 3.3, 4.0])
def test_the_turn_leads_the_short_way(angle: float) -> None:
    values, y = turned(angle)
    *_, (R, _) = chain.placements(chain.of_values(values), values["q_0"])
    short = (angle + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(y["x"][3:], 2 * np.sin(short / 2) * R[:, 2], rtol=0, atol=1e-12)


def reference_velocity(values: Values, n: int, m: int, u: Values) -> tuple[Values, np.ndarray]:
    """Outputs of the C code at the start, and dq - s, which is v."""
    kernel = arm_task.kernel(joints=n, coordinates=m)
    kernel.initialize(values)
    y = kernel.initial(u)
    return {k: np.array(a) for k, a in y.items()}, u["dq"] - np.array(y["s"])


def state(n: int, m: int, seed: int) -> Values:
    rng = np.random.default_rng(seed)
    return {
        "q": rng.uniform(-1, 1, n),
        "dq": rng.uniform(-1, 1, n),
        "xi_in": rng.uniform(-1, 1, (1, m)),
    }


@pytest.mark.parametrize(("n", "m"), [(7, 3), (3, 3), (2, 2)])
def test_the_tip_follows_z_and_does_not_notice_the_null_motion(n: int, m: int) -> None:
    """J s = dx - z where J has full rank, whatever psi is."""
    values, u = task_values(n, m, seed=2, sigma_0=1e-3), state(n, m, 3)
    for k in (0.0, 3.0):
        values |= {"k_n": np.full(n, k), "k_l": np.full(n, 2 * k)}
        y, v = reference_velocity(values, n, m, u)
        J = values["scale"] * task_space.rows(values, u["q"])
        assert y["sigma"] > 1e-2
        assert np.allclose(J @ y["s"], J @ u["dq"] - values["z"], rtol=0, atol=1e-12)
        assert np.allclose(y["xi"], J @ u["dq"] + 0.5 * y["x"], rtol=0, atol=1e-12)
        null = v - np.linalg.pinv(J) @ values["z"]
        assert np.linalg.norm(J @ null) < 1e-12
        assert (np.linalg.norm(null) > 0.1) == (k > 0 and n > m)


def test_the_null_motion_goes_to_the_posture_and_away_from_limits() -> None:
    """It is bounded by psi_max, also far from the posture."""
    values = task_values(4, 1, seed=4, k_n=np.ones(4), k_l=np.zeros(4), psi_max=np.full(4, 0.5))
    assert (np.abs(values["q_max"] - values["margin"]) > 0.05).all()
    u = state(4, 1, 5)
    psi = task_space.null_velocity(values, u["q"])
    assert (np.sign(psi) == np.sign(values["q_n"] - u["q"])).all()
    far = task_space.null_velocity(values, u["q"] + 1e6)
    assert np.allclose(far, -0.5, atol=1e-5)
    values |= {"k_n": np.zeros(4), "k_l": np.ones(4)}
    assert not task_space.null_velocity(values, np.zeros(4)).any()
    assert (task_space.null_velocity(values, values["q_max"]) < 0.0).all()
    assert (task_space.null_velocity(values, values["q_min"]) > 0.0).all()


def stretched(angle: float) -> Values:
    """Two links of 1 m in a plane, bent by `angle` rad; straight is singular."""
    return {"q": np.array([0.0, angle]), "dq": np.zeros(2), "xi_in": np.zeros((1, 2))}


PLANE: Values = {
    "origin": np.array([[0.0, 0, 0], [1, 0, 0]]),
    "tip": np.array([1.0, 0, 0]),
    "gravity": np.array(0.0),
    "Gamma": np.zeros((2, 10)),
}


def test_at_a_singularity_the_joints_stay_slow() -> None:
    """|v| <= 3 sqrt(3)/(4 sigma_0) |z|, whereas the undamped inverse grows beyond all bounds."""
    sigma_0, z = 0.2, np.array([-0.3, 0.1])
    bound = 0.75 * np.sqrt(3.0) / sigma_0 * np.linalg.norm(z)
    speeds = {}
    for angle in (0.0, 1e-4, 0.05, 0.2, 0.3, 0.45, 1.0, 2.0, np.pi):
        given = {**PLANE, "sigma_0": np.array(sigma_0), "z": z}
        y, v = reference_velocity(given, 2, 2, stretched(angle))
        speeds[angle] = float(np.linalg.norm(v))
        J = task_space.jacobian(chain.of_values(full(given)), PLANE["tip"], np.array([0, angle]))[
            :2
        ]
        exact = np.abs(J @ v - z).max() < 1e-12
        assert exact == (y["sigma"] >= sigma_0)
    assert max(speeds.values()) < bound
    free = reference_velocity({**PLANE, "sigma_0": np.array(1e-6), "z": z}, 2, 2, stretched(1e-4))
    assert np.linalg.norm(free[1]) > 100 * bound
    assert speeds[0.3] > 0.5 * bound


def full(given: Values) -> Values:
    """`given` with the defaults of the others."""
    declared = arm_task.model(joints=2, coordinates=2).variables
    return {v.name: np.reshape(v.starts, v.shape) for v in declared} | given


def test_sigma_is_just_below_the_smallest_singular_value() -> None:
    for seed in range(10):
        values, u = task_values(4, 3, seed=seed, frame=np.eye(3)), state(4, 3, seed)
        y, _ = reference_velocity(values, 4, 3, u)
        least = np.linalg.svd(task_space.rows(values, u["q"]), compute_uv=False)[-1]
        assert least / np.sqrt(3) * (1 - 1e-3) <= y["sigma"] <= least
    for angle in (0.0, 1e-5, 1e-3):  # two links of 1 m: sigma_min is angle / sqrt(5) there
        y, _ = reference_velocity({**PLANE, "sigma_0": np.array(0.2)}, 2, 2, stretched(angle))
        assert y["sigma"] == pytest.approx(angle / np.sqrt(5.0), rel=1e-3, abs=1e-9)


def test_of_three_orthogonal_slides_it_is_the_law_of_the_joints() -> None:
    """Their tip's coordinates are the joints' positions, so that both laws are one."""
    rng = np.random.default_rng(6)
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z to x, then on to y and to z
    table = random_chain(rng, 3)
    slides = Table(
        np.ones(3), np.array([turn] * 3), np.zeros((3, 3)), table.inertia, table.armature, table.g
    )
    axes = np.array([R[:, 2] for R, _ in chain.placements(slides, np.zeros(3))])
    common = values_of(3, rng) | slides.values()
    # K_x 4 in each direction, and K the rest.
    of_tip = common | {"frame": axes, "K": common["K"] - 0.9, "K_x": np.full(3, 0.9)}
    joints, tip = ArmTeleoperation(joints=3), arm_task.kernel(joints=3)
    u = motion(joints, 20, 8)
    joints.initialize(common)
    tip.initialize(of_tip)
    for k, given in enumerate(u):
        a, b = joints.step(k * H, H, given), tip.step(k * H, H, given)
        for name in ("tau", "xi", "s", "z", "theta_hat"):
            assert np.allclose(a[name], b[name], rtol=1e-10, atol=1e-10)


def test_a_coordinate_that_is_missing_changes_nothing_else() -> None:
    """A planar arm in a network of three coordinates is one in a network of two."""
    flat, high = arm_task.kernel(joints=2, coordinates=2), arm_task.kernel(joints=2)
    plane = {**PLANE, "K_x": np.full(2, 5.0), "z": np.array([0.3, -0.2])}
    flat.initialize(plane)
    lacking = {"lacks": np.array([0.0, 0, 1]), "z": np.array([0.3, -0.2, 0])}
    high.initialize(plane | {"K_x": np.full(3, 5.0)} | lacking)
    for k, u in enumerate(motion(flat, 20, 3)):
        xi_in = np.array([[*u["xi_in"][0], 7.0]])
        a, b = flat.step(k * H, H, u), high.step(k * H, H, u | {"xi_in": xi_in})
        for name in ("tau", "s", "theta_hat", "sigma"):
            assert np.allclose(a[name], b[name], rtol=0, atol=1e-12)
        assert np.allclose(b["xi"], [*np.array(a["xi"]), 0.0])
        assert np.array(b["z"])[2] == 0.0


def test_who_does_not_listen_to_a_coordinate_is_not_moved_by_it() -> None:
    values = task_values(4, 3, seed=1, listens=[[1, 1, 0]])
    kernel = arm_task.kernel(joints=4)
    ends = []
    for other in (0.0, 5.0):
        kernel.initialize(values)
        u = state(4, 3, 2)
        u["xi_in"] = np.array([[0.1, 0.2, other]])
        for k in range(3):
            y = kernel.step(k * H, H, u)
        ends.append(np.array(y["tau"]))
    assert np.array_equal(*ends)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"lacks": np.ones(3)}, "lacks every coordinate"),
        ({"theta_min": np.full((2, 10), 0.1)}, "theta_hat"),
        ({"alpha": 0.0}, "alpha"),
        ({"inertia": -np.ones((2, 10))}, "mass"),
    ],
)
@pytest.mark.parametrize("made", [ArmTask, arm_task.kernel])
def test_values_that_cannot_be_are_refused(
    made: object, given: dict[str, object], says: str
) -> None:
    component = made(joints=2)  # type: ignore[operator]
    with pytest.raises(CosimError, match=says):
        component.initialize({k: np.asarray(v, dtype=float) for k, v in given.items()})
        component.initial(motion(component, 1, 1)[0])


@pytest.mark.parametrize(
    ("sizes", "says"),
    [({"neighbours": -1}, "neighbours is -1"), ({"coordinates": 4}, "coordinates is 4")],
)
def test_sizes_that_cannot_be_are_refused(sizes: dict[str, int], says: str) -> None:
    with pytest.raises(FmuError, match=says):
        arm_task.model(**sizes)


@pytest.mark.parametrize("made", [ArmTask, arm_task.kernel])
def test_a_turn_needs_a_rotation(made: object) -> None:
    component = made(joints=6, coordinates=6)  # type: ignore[operator]
    with pytest.raises(CosimError, match="rotation"):
        component.initialize({"frame": np.diag([1.0, 1.0, -1.0])})
        component.initial(motion(component, 1, 1)[0])


def test_hand_and_wall_at_the_tip_in_c_and_numpy() -> None:
    rng = np.random.default_rng(3)
    values = random_chain(rng, 5).values() | {
        "tip": rng.uniform(-0.3, 0.3, 3),
        "K_h": rng.uniform(0, 100, 3),
        "B_h": rng.uniform(0, 9, 3),
        "k_w": np.array(500.0),
        "b_w": np.array(90.0),
        "x_w": np.array([0.0, 0.0, 0.1]),
        "normal": np.array([0.0, 0.0, -1.0]),
    }
    reference, kernel = ArmTip(joints=5), arm_tip.kernel(joints=5)
    for component in (reference, kernel):
        component.initialize(values)
    touched = 0
    for k, u in enumerate(motion(reference, 40, 4)):
        a, b = reference.step(k * H, H, u), kernel.step(k * H, H, u)
        for name in a:
            assert np.allclose(a[name], b[name], rtol=0, atol=1e-11)
        J = task_space.jacobian(chain.of_values(values), values["tip"], u["q"])
        f = np.array(a["f_h"]) - np.array(a["f_e"])
        assert np.array(a["tau_ext"]) @ u["dq"] == pytest.approx(f @ (J @ u["dq"]))  # power
        depth = 0.1 - np.array(a["x"])[2]
        touched += depth > 0
        assert np.array(a["f_e"])[2] <= 0.0  # it pushes into the wall, along the normal
        assert not (depth <= 0 and np.array(a["f_e"]).any())
    assert 0 < touched < 40


TIP = np.array([1, 2, 3]) / 64  # binary fractions: the tip just touches without rounding
SLIDES = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z to x, then on to y and to z


@pytest.mark.parametrize(
    ("x", "dx", "push"),
    [
        (0.3125, 0.5, 500.0 * 0.0625 + 90.0 * 0.5),  # goes further in
        (0.3125, -0.2, 500.0 * 0.0625 - 90.0 * 0.2),  # leaves slowly
        (0.3125, -0.5, 0.0),  # leaves faster than the wall follows
        (0.25, 0.5, 0.0),  # just touches
        (0.125, 3.0, 0.0),  # away from it
    ],
)
@pytest.mark.parametrize("made", [ArmTip, arm_tip.kernel])
def test_hand_and_wall_of_three_slides_are_springs_and_dampers(made, x, dx, push) -> None:  # type: ignore[no-untyped-def]
    """Joint positions are the tip's coordinates but for its place on the last link: by hand."""
    table = random_chain(np.random.default_rng(1), 3)
    slides = Table(
        np.ones(3), np.array([SLIDES] * 3), np.zeros((3, 3)), table.inertia, table.armature, table.g
    )
    turns = [R for R, _ in chain.placements(slides, np.zeros(3))]
    axes, offset = np.array([R[:, 2] for R in turns]), turns[-1] @ TIP
    component = made(joints=3)
    component.initialize(
        slides.values()
        | {
            "tip": TIP,
            "K_h": np.array([100.0, 200.0, 300.0]),
            "B_h": np.array([5.0, 6.0, 7.0]),
            "k_w": np.array(500.0),
            "b_w": np.array(90.0),
            "x_w": np.array([0.25, 7.0, -7.0]),  # a plane: only x counts
            "normal": np.array([1.0, 0.0, 0.0]),
        }
    )
    at, moving = np.array([x, 0.3, -0.4]), np.array([dx, 0.1, -0.2])
    given = {
        "q": axes @ (at - offset),
        "dq": axes @ moving,
        "x_h": np.array([0.5, 0.5, 0.5]),
        "dx_h": np.array([0.1, 0.0, -0.1]),
        "grip": np.array(0.5),
    }
    found = component.step(0.0, 1e-3, given)
    hand = 0.5 * np.array(
        [
            100.0 * (0.5 - x) + 5.0 * (0.1 - dx),
            200.0 * 0.2 - 6.0 * 0.1,
            300.0 * 0.9 + 7.0 * 0.1,
        ]
    )
    wall = np.array([push, 0.0, 0.0])
    assert np.allclose(found["x"], at, atol=1e-15)
    assert np.allclose(found["f_h"], hand, rtol=1e-12)
    assert np.allclose(found["f_e"], wall, rtol=1e-9, atol=1e-12)
    assert np.allclose(found["tau_ext"], axes @ (hand - wall), rtol=1e-9)
