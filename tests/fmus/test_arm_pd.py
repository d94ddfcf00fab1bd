"""PD of a serial arm with gravity and friction compensated: C, NumPy, and the planar law."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.errors import CosimError
from fmus.arms import chain
from fmus.models import arm_pd, damping, pd
from tests.fmus.chains import planar
from tests.fmus.test_arm_teleoperation import H, motion, played, values_of

pytestmark = pytest.mark.usefixtures("compiled_once")
FRICTION = {
    "F_c": np.array([0.3, 0.0, 0.2, 0.5]), "v_c": np.full(4, 0.2),
    "F_v": np.array([0.0, 0.4, 0.1, 0.2]), "F_o": np.array([0.1, -0.2, 0.0, 0.3]),
}  # fmt: skip


def values(limit: float) -> dict[str, np.ndarray]:
    """Those of a random arm of four joints, with friction that is compensated."""
    declared = {p.name for p in arm_pd.ArmPD(joints=4).parameters}
    drawn = values_of(4, np.random.default_rng(1), gravity=0)
    table = {k: v for k, v in drawn.items() if k in declared}
    gains = {"K_p": np.arange(4) + 10.0, "K_d": np.arange(4) + 1.0}
    return table | gains | FRICTION | {"tau_max": np.full(4, limit)}


@pytest.mark.parametrize("limit", [1e9, 15.0])
def test_c_equals_numpy(limit: float) -> None:
    reference = arm_pd.ArmPD(joints=4)
    u = motion(reference, 20, 5)
    in_numpy = played(reference, values(limit), u)
    in_c = played(arm_pd.kernel(joints=4), values(limit), u)
    assert np.allclose(in_c, in_numpy, rtol=1e-12, atol=1e-12)
    assert (np.abs(in_c).max() == limit) == (limit == 15.0)


def test_its_terms_are_those_of_the_equation() -> None:
    """Gravity alone where the arms are together, friction by dq, the coupling of ``pd``."""
    law, x = arm_pd.ArmPD(joints=4), values(1e9)
    law.initialize(x)
    q, dq, other = np.array([0.3, -0.5, 0.2, 0.9]), np.array([0.5, -0.1, 0.0, 2.0]), np.ones(4)
    table = chain.of_values(x)
    g = chain.inverse(table, q, np.zeros(4), np.zeros(4))
    together = law.step(0.0, H, {"q": q, "dq": np.zeros(4), "q_j": q, "dq_j": np.zeros(4)})
    assert together["tau"] == pytest.approx(g + x["F_o"], abs=1e-12)
    moving = law.step(0.0, H, {"q": q, "dq": dq, "q_j": other, "dq_j": -dq})
    friction = x["F_c"] * np.tanh(dq / 0.2) + x["F_v"] * dq + x["F_o"]
    coupling = x["K_p"] * (other - q) - 2.0 * x["K_d"] * dq
    assert moving["tau"] == pytest.approx(g + friction + coupling, abs=1e-12)


def test_with_a_level_planar_arm_it_is_the_planar_law() -> None:
    table = planar(np.array([3.34, 1.20, 0.97]), np.zeros(2)).values()
    serial, flat = arm_pd.ArmPD(joints=2), pd.PD()
    gains = {"K_p": np.array([7.0, 9.0]), "K_d": np.array([2.0, 3.0])}
    serial.initialize(gains | table)
    flat.initialize(gains)
    for k, u in enumerate(motion(serial, 10, 3)):
        tau = flat.step(k * H, H, u)["tau"]
        assert serial.step(k * H, H, u)["tau"] == pytest.approx(tau, abs=1e-11)


def test_a_table_that_cannot_be_is_refused() -> None:
    for make in (arm_pd.ArmPD, arm_pd.kernel):
        component = make(joints=4)
        with pytest.raises(CosimError, match="mass"):
            component.initialize({"inertia": -np.ones((4, 10))})
            component.initial(motion(component, 1, 1)[0])


def test_without_a_spring_it_is_damping_with_gravity_compensated() -> None:
    """Eq. (24): the planar law with its gravity, and arm_pd with K_p = 0 and the planar table."""
    theta, theta_g, d = (
        np.array([3.0, 0.7, 0.9]),
        np.array([30.0, 0.7 * 9.81]),
        np.array([5.0, 3.0]),
    )
    table = planar(theta, theta_g)
    plain, serial = damping.kernel(), arm_pd.kernel(joints=2)
    plain.initialize({"d": d, "theta_g": theta_g})
    serial.initialize({**table.values(), "K_p": np.zeros(2), "K_d": d})
    still = {"q_j": np.zeros(2), "dq_j": np.zeros(2)}
    for q, dq in np.random.default_rng(2).uniform(-2, 2, (20, 2, 2)):
        u = {"q": q, "dq": dq}
        expected = plain.step(0.0, H, u)["tau"]
        assert serial.step(0.0, H, u | still)["tau"] == pytest.approx(expected, abs=1e-12)
