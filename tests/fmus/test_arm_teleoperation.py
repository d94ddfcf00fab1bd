"""The paper's law for serial arms: C and NumPy, the planar arm as a special case, its options."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import CosimError, ScenarioError
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record.run import Run
from fmus.arms import chain
from fmus.models import arm_teleoperation, teleoperation
from fmus.models.arm_teleoperation import ArmTeleoperation
from fmus.models.teleoperation import Teleoperation
from tests.fmus.chains import planar, random_body, random_chain

H = 2e-3
ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.usefixtures("compiled_once")
Values = dict[str, np.ndarray]


def motion(component: Component, steps: int, seed: int, **given: np.ndarray) -> list[Values]:
    rng = np.random.default_rng(seed)
    return [
        {p.name: rng.uniform(-1, 1, p.shape) for p in component.inputs} | given
        for _ in range(steps)
    ]


def played(component: Component, values: Values, u: list[Values]) -> list[np.ndarray]:
    """All outputs of every step, and of the start."""
    component.initialize(values)
    names = [p.name for p in component.outputs]
    outputs = [component.initial(u[0]), *(component.step(k * H, H, x) for k, x in enumerate(u))]
    return [np.concatenate([np.ravel(y[name]) for name in names]) for y in outputs]


def values_of(n: int, rng: np.random.Generator, **given: object) -> Values:
    """Random tables, gains and estimates."""
    table = random_chain(rng, n)
    bodies = np.array([random_body(rng) for _ in range(n)])
    made = {
        **table.values(),
        "theta_hat": 0.7 * bodies,
        "Gamma": rng.uniform(0, 1, (n, 10)),
        "K": rng.uniform(1, 5, n),
        "z": rng.uniform(-1, 1, n),
    }
    return made | {name: np.asarray(value, dtype=float) for name, value in given.items()}


@pytest.mark.parametrize(
    ("neighbours", "given"),
    [
        (1, {"gravity": 1}),
        (2, {"gravity": 2, "lambda_c": 3.0, "age_max": 0.5, "age_fade": 0.4}),
        (0, {"gravity": 0, "tau_max": np.full(4, 15.0)}),
        (1, {"gravity": 2, "natural": 0.5}),
    ],
)
def test_c_equals_numpy(neighbours: int, given: dict[str, object]) -> None:
    values = values_of(4, np.random.default_rng(neighbours), **given)
    values["theta_min"] = values["theta_hat"] - (0.0 if neighbours == 0 else 10.0)  # some at once
    reference = ArmTeleoperation(joints=4, neighbours=neighbours)
    u = motion(reference, 30, 5)
    in_numpy = played(reference, values, u)
    in_c = played(arm_teleoperation.kernel(joints=4, neighbours=neighbours), values, u)
    assert np.allclose(in_c, in_numpy, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("gravity", [0, 2])
def test_with_the_planar_arm_it_is_the_planar_law(gravity: int) -> None:
    """The same torques and motion of z where the estimates are the same and stand still."""
    theta, theta_g = np.array([3.34, 1.20, 0.97]), np.array([24.525, 11.772])
    table = planar(theta, theta_g)
    common = {"K": np.full(2, 16.0), "alpha": np.array(0.5), "lambda_M": np.array(3.0)}
    mode = {"gravity": np.array(float(gravity))}
    estimate = {"theta_hat": table.inertia, "Gamma": np.zeros((2, 10))}
    serial = ArmTeleoperation(joints=2)
    lumped = np.concatenate([theta, theta_g]) if gravity else theta
    flat = Teleoperation(gravity=bool(gravity))
    u = motion(serial, 25, 9)
    known = {"theta_hat": lumped, "Gamma": np.zeros(len(lumped))} | (mode if gravity else {})
    serial.initialize(common | mode | estimate | table.values())
    flat.initialize(common | known)
    assert np.allclose(serial.initial(u[0])["tau"], flat.initial(u[0])["tau"], atol=1e-11)
    for k, x in enumerate(u):
        a, b = serial.step(k * H, H, x), flat.step(k * H, H, x)
        for name in ("tau", "xi", "s", "z"):
            assert np.allclose(a[name], b[name], rtol=0, atol=1e-11)


def test_known_gravity_is_compensated_with_the_inertia_of_the_table() -> None:
    rng = np.random.default_rng(2)
    component = ArmTeleoperation(joints=3, neighbours=0)
    values = values_of(3, rng, gravity=1, theta_hat=np.zeros((3, 10)), z=np.zeros(3))
    component.initialize(values | {"armature": np.zeros(3)})
    q = rng.uniform(-1, 1, 3)
    still = np.zeros(3)
    expected = chain.inverse(chain.of_values(values), q, still, still)
    assert np.allclose(component.initial({"q": q, "dq": still})["tau"], expected)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"theta_min": np.full((2, 10), 0.1)}, "theta_hat"),
        ({"alpha": 0.0}, "alpha"),
        ({"natural": 1.0}, "natural adaptation"),
        ({"inertia": -np.ones((2, 10))}, "mass"),
    ],
)
@pytest.mark.parametrize("made", [ArmTeleoperation, arm_teleoperation.kernel])
def test_values_that_cannot_be_are_refused(
    made: object, given: dict[str, object], says: str
) -> None:
    component = made(joints=2)  # type: ignore[operator]
    with pytest.raises(CosimError, match=says):
        component.initialize({k: np.asarray(v, dtype=float) for k, v in given.items()})
        component.initial(motion(component, 1, 1)[0])


def test_fewer_than_no_neighbours_are_refused() -> None:
    with pytest.raises(ScenarioError, match="neighbours is -1, expected at least 0"):
        arm_teleoperation.model(neighbours=-1)
    assert arm_teleoperation.model(neighbours=0).identifier == "arm_adaptive"
    assert teleoperation.model(2).identifier == "teleoperation_n2"


def test_two_openarms_agree_over_the_delays_of_the_paper(tmp_path: Path) -> None:
    """configs/openarm.toml: all joints arrive where the hand is, which then feels nothing."""
    scenario = load(ROOT / "configs" / "openarm.toml", ["run.stop=20 s"])
    simulate(scenario, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    target = [0.6, 0.8, -0.4, 1.2, 0.3, 0.2, 0.4]
    for side in ("master", "slave"):
        assert np.allclose(run.array(f"{side}.q")[-1], target, rtol=0, atol=5e-3)
    assert abs(run.array("master_control.s")[-1]).max() < 1e-2
    assert abs(run.array("master.tau_h")[-1]).max() < 0.05
    assert abs(run.array("master_control.tau")).max(axis=0)[[0, 6]].tolist() > [1.0, 0.05]
