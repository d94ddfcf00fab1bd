"""Two joints that follow each other with delay: predictions against closed forms and motions."""

from __future__ import annotations

from itertools import pairwise
from math import inf, log, pi

import numpy as np
import pytest

from cosim.base.component import Outputs
from docs.evidence.coupled_joints import CoupledJoints, rigid_limit
from fmus.build.reference import Values
from fmus.models import elastic_joint

pytestmark = pytest.mark.usefixtures("compiled_once")
K, D, J, M = 240.0, 3.0, 0.0158, 0.06
H = 1e-4


def joint(**changed: float) -> Values:
    """Joint 2 of OpenArm, rigid and without friction, but for what is changed."""
    values = {
        "K_p": K, "K_d": D, "F_c": 0.0, "v_c": 0.35, "F_v": 0.0, "tau_max": 1e9, "J": J, "M": M,
        "damping": 0.0, "friction": 0.0, "v_f": 0.35, "k_g": 0.0, "d_g": 0.0, "M_s": 1.0,
        "k_s": 0.0, "d_s": 0.0,
    }  # fmt: skip
    return {name: np.array([value]) for name, value in (values | changed).items()}


def motion(values: Values, T: float, T_o: float, seconds: float, start: float = 1e-3) -> np.ndarray:
    """Velocity of one joint, rad/s, by steps of C code with delayed references."""
    pair = elastic_joint.kernel(1), elastic_joint.kernel(1)
    past: list[list[np.ndarray]] = [[], []]
    for k, one in enumerate(pair):
        one.initialize(values | {"dq": np.array([start * (1 - k)])})
        still = {name: np.zeros(1) for name in ("q_d", "dq_d", "dq_c", "tau_ext")}
        past[k].append(state(one.initial(still)))
    back, own = round(T / H), round(T_o / H)
    for n in range(round(seconds / H)):
        rows = []
        for k, one in enumerate(pair):
            other = past[1 - k][max(n - back, 0)]
            u = {"q_d": other[:1], "dq_d": other[1:], "dq_c": past[k][max(n - own, 0)][1:]}
            rows.append(state(one.step(n * H, H, u | {"tau_ext": np.zeros(1)})))
        for k, row in enumerate(rows):
            past[k].append(row)
    velocity: np.ndarray = np.array(past[0])[:, 1]
    return velocity


def state(y: Outputs) -> np.ndarray:
    """q and dq."""
    return np.concatenate([np.asarray(y["q"]), np.asarray(y["dq"])])


def growth_and_frequency(x: np.ndarray) -> tuple[float, float]:
    """1/s and Hz, from the greatest values between crossings of 0 in the second half."""
    x = x[len(x) // 2 :]
    crossings = np.flatnonzero(x[:-1] * x[1:] < 0)
    peaks = [abs(x[a:b]).max() for a, b in pairwise(crossings)]
    apart = (crossings[-1] - crossings[0]) * H / (len(crossings) - 1)
    return log(peaks[-1] / peaks[0]) / (apart * (len(peaks) - 1)), 0.5 / apart


def test_a_rigid_pair_is_stable_up_to_the_closed_form() -> None:
    pair, limit = CoupledJoints(joint()), rigid_limit(K, D, J + M)
    assert limit == pytest.approx(19.67e-3, abs=1e-5)
    onset, frequency = pair.onset()
    assert onset == pytest.approx(limit, abs=1e-6)
    assert frequency == pytest.approx((2 * K / (J + M)) ** 0.5 / (2 * pi), rel=1e-4)
    assert pair.mode(limit - 1e-4, 0.0).growth < 0.0 < pair.mode(limit + 1e-4, 0.0).growth


KINDS = {
    "rigid": (joint(), 0.021, 0.0),
    "gear": (joint(k_g=1000.0, d_g=0.14, F_v=0.9), 0.017, 0.017),
    "stand": (joint(M_s=0.1, k_s=395.0, d_s=0.25, F_v=0.9), 0.022, 0.021),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_grows_as_the_roots_say(kind: str) -> None:
    values, T, T_o = KINDS[kind]
    expected = CoupledJoints(values).mode(T, T_o)
    growth, frequency = growth_and_frequency(motion(values, T, T_o, 1.2))
    assert frequency == pytest.approx(expected.frequency, rel=0.01)
    assert growth == pytest.approx(expected.growth, abs=0.15)


def test_the_limit_cycle_of_a_compensation_that_saturates() -> None:
    """A gear that the compensation of friction excites: it settles from above and below."""
    values = joint(k_g=1000.0, d_g=0.14, F_c=0.306, F_v=0.063)
    found = CoupledJoints(values).cycle(0.017, 0.017)
    assert found is not None
    for start in (1.0, 8.0):  # rad/s
        x = motion(values, 0.017, 0.017, 3.0, start)[-3000:]
        omega = 2 * pi * found.frequency
        assert 0.5 * np.ptp(x) == pytest.approx(found.angle * omega, rel=0.05)
    assert growth_and_frequency(x)[1] == pytest.approx(found.frequency, rel=0.01)


def test_a_limit_of_the_torque_keeps_the_frequency_of_an_amplitude() -> None:
    """A limit takes away stiffness: slower, and less growth."""
    pair = CoupledJoints(joint(tau_max=40.0))
    small, large = (pair.mode(0.022, 0.0, amplitude) for amplitude in (1e-3, 0.1))
    assert small.frequency == pytest.approx(pair.mode(0.022, 0.0).frequency)
    assert large.frequency < small.frequency and large.growth < small.growth
    assert pair.cycle(0.010, 0.0) is None
    assert pair.onset(longest=0.005)[0] == inf
