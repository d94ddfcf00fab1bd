"""A joint with elastic gear and stand: C and NumPy agree; modes of springs; rigid limits."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import CosimError, RunError
from fmus.build.reference import Values
from fmus.models import elastic_joint
from fmus.models.elastic_joint import ElasticJoint

pytestmark = pytest.mark.usefixtures("compiled_once")
#: A rigid joint, one with a gear, one on a stand, and one with both.
KINDS = {"k_g": np.array([0.0, 900.0, 0.0, 700.0]), "k_s": np.array([0.0, 0.0, 500.0, 800.0])}
NUMBER = 4


def random_values(rng: np.random.Generator) -> Values:
    """Joints of the four kinds, with everything that a joint can have."""
    ranges = {
        "K_p": (0, 50), "K_d": (0, 2), "F_c": (0, 0.3), "v_c": (0.05, 1), "F_v": (0, 0.3),
        "tau_max": (1, 20), "J": (0.05, 0.2), "M": (0.1, 0.5), "damping": (0, 0.5),
        "friction": (0, 0.4), "v_f": (0.05, 1), "d_g": (0, 1), "M_s": (1, 3), "d_s": (0, 2),
        "q": (-1, 1), "dq": (-1, 1), "e": (-0.1, 0.1), "de": (-1, 1), "phi": (-0.1, 0.1),
        "dphi": (-1, 1),
    }  # fmt: skip
    return {name: rng.uniform(*ends, NUMBER) for name, ends in ranges.items()} | KINDS


def inputs(rng: np.random.Generator) -> Values:
    return {name: rng.uniform(-1, 1, NUMBER) for name in ("q_d", "dq_d", "dq_c", "tau_ext")}


@pytest.mark.parametrize("seed", range(5))
def test_numpy_and_c_agree(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = random_values(rng) | {"substeps": np.array(float(1 + seed % 3))}
    pair = ElasticJoint(NUMBER), elastic_joint.kernel(NUMBER)
    start = inputs(rng)
    for one in pair:
        one.initialize(values)
    first, second = (one.initial(start) for one in pair)
    for k in range(50):
        for name, found in second.items():
            assert found == pytest.approx(first[name], abs=1e-12), (k, name)
        u = inputs(rng)
        first, second = (one.step(k * 1e-3, 1e-3, u) for one in pair)


def swing(values: Values, steps: int, h: float = 1e-4) -> dict[str, np.ndarray]:
    """Outputs of one joint without inputs."""
    joint = elastic_joint.kernel(1)
    joint.initialize({"K_p": 0.0, "K_d": 0.0} | values)
    still = {name: np.zeros(1) for name in ("q_d", "dq_d", "dq_c", "tau_ext")}
    rows = [joint.initial(still)]
    rows += [joint.step(k * h, h, still) for k in range(steps)]
    return {name: np.array([row[name][0] for row in rows]) for name in rows[0]}


def test_a_gear_swings_at_its_frequency_and_keeps_energy_and_momentum() -> None:
    J, M, k = 0.02, 0.3, 400.0
    y = swing({"J": J, "M": M, "k_g": k, "e": 0.05}, 5000)
    t = 1e-4 * np.arange(5001)
    omega = np.sqrt(k * (J + M) / (J * M))
    assert y["e"] == pytest.approx(0.05 * np.cos(omega * t), abs=1e-6)
    assert J * y["dq"] + M * (y["dq"] + y["de"]) == pytest.approx(0.0, abs=1e-12)
    energy = J * y["dq"] ** 2 + M * (y["dq"] + y["de"]) ** 2 + k * y["e"] ** 2
    assert energy == pytest.approx(k * 0.05**2, rel=1e-7)


def test_a_stiff_gear_and_a_stiff_stand_are_rigid_ones() -> None:
    """On an elastic stand, and with an elastic gear: the rigid limits."""
    for limit, kept in (("k_g", "k_s"), ("k_s", "k_g")):
        values = {"J": 0.05, "M": 0.3, "K_p": 30.0, "q": 0.1, "M_s": 2.0, kept: 200.0}
        rigid = swing(values | {limit: 0.0}, 3000)
        stiff = swing(values | {limit: 1e6, "d_g": 30.0, "d_s": 300.0} | {f"d_{kept[-1]}": 0.0},
                      3000)  # fmt: skip
        assert stiff["q"] == pytest.approx(rigid["q"], abs=2e-4), limit
        assert abs(rigid["q"] - 0.1).max() > 0.05


def test_the_torque_keeps_its_limit_and_compensates_friction() -> None:
    joint: Component = elastic_joint.kernel(1)
    joint.initialize({"K_p": 100.0, "K_d": 2.0, "F_c": 0.3, "F_v": 0.5, "tau_max": 20.0})
    u = {"q_d": [0.1], "dq_d": [0.5], "dq_c": [1.0], "tau_ext": [0.0]}
    assert joint.initial(u)["tau"] == pytest.approx([10.0 + 1.0 + 0.3 * np.tanh(10.0) + 0.5])
    assert joint.initial(u | {"q_d": [1.0]})["tau"] == [20.0]


@pytest.mark.parametrize(
    "values", [{"M": 0.0}, {"k_g": 10.0, "J": 0.0}, {"k_s": 10.0, "M_s": 0.0}], ids=str
)
def test_an_inertia_of_nothing_is_refused(values: dict[str, float]) -> None:
    for joint in (ElasticJoint(), elastic_joint.kernel()):
        with pytest.raises(CosimError, match="more than 0"):
            joint.initialize({name: np.full(2, value) for name, value in values.items()})
            joint.initial({name: np.zeros(2) for name in ("q_d", "dq_d", "dq_c", "tau_ext")})


@pytest.mark.parametrize("gear", [0.0, 1e4])
def test_steep_dry_friction_stops_a_joint_where_coulomb_friction_does(gear: float) -> None:
    """F = 1 N.m with v_f = 1e-3 rad/s at 1 ms: a slide of 1 rad/s ends after J / (2 F) rad."""
    ends = []
    for joint in (elastic_joint.kernel(1), ElasticJoint(1)):
        values = {"J": 0.01, "M": 0.02, "friction": 1.0, "v_f": 1e-3, "K_p": 0.0, "K_d": 0.0}
        values |= {"k_g": gear, "d_g": 1.0 if gear else 0.0, "dq": 1.0}
        joint.initialize({name: np.array([value]) for name, value in values.items()})
        still = {name: np.zeros(1) for name in ("q_d", "dq_d", "dq_c", "tau_ext")}
        joint.initial(still)
        for k in range(60):
            y = joint.step(k * 1e-3, 1e-3, still)
        ends.append(float(np.ravel(y["q"])[0]))
        assert abs(np.ravel(y["dq"])[0]) < 1e-3
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)
    if not gear:
        assert ends[0] == pytest.approx(0.5 * 0.03, rel=0.01)


def test_friction_that_no_step_bears_is_refused() -> None:
    for joint in (elastic_joint.kernel(1), ElasticJoint(1)):
        joint.initialize({"friction": np.ones(1), "v_f": np.full(1, 1e-6), "M": np.full(1, 0.01)})
        still = {name: np.zeros(1) for name in ("q_d", "dq_d", "dq_c", "tau_ext")}
        joint.initial(still)
        with pytest.raises(RunError, match=r"friction.*steps\s+of the integrator in a step"):
            joint.step(0.0, 1e-3, still)
