"""The passive range of coupled robots, against the admittance of a pair written down by hand."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.analysis.contacts import margin
from cosim.base.copies import replace
from cosim.predict.ages import Age
from cosim.predict.network import RobotNetwork
from cosim.predict.passivity import passive_range, worst_posture
from tests.analysis.cases import DOCUMENTS, bench, net_of

Q = (0.0,)
#: K, M, alpha, lambda, delay there and back of a pair of joints whose far end is free, and the
#: lambda_M at which a scan of its admittance over 200 000 frequencies turns negative.
PAIRS = [
    (12.0, 5.5, 0.8, 1.3, 0.2, 0.52, 4.248),
    (16.0, 6.6, 0.5, 2.0, 0.75, 0.75, 4.781),
    (16.0, 6.6, 0.5, 2.0, 0.3, 1.2, 4.781),
    (16.0, 6.6, 0.5, 2.0, 0.0, 0.0, 4.924),
    (4.0, 1.0, 0.5, 5.0, 0.05, 0.05, 9.066),
    (4.0, 1.0, 0.5, 5.0, 1.0, 1.0, 8.264),
]


def pair(
    K: float, M: float, alpha: float, weight: float, *delays: float, friction: float = 0.0
) -> RobotNetwork:
    """Two arms of one joint of inertia `M`, each coupled by `weight` to the other over delays."""
    net = net_of(DOCUMENTS["pair-10"])
    joint = {"inertia": lambda theta, q: np.array([[M]]), "damping": (friction,)}
    arms = tuple(replace(arm, q=Q, heaviest=Q, inertia_range=(M, M), **joint) for arm in net.arms)
    laws = tuple(
        replace(law, K=(K,), alpha=alpha, lambda_=weight, lambda_M=alpha) for law in net.laws
    )
    edges = replace(
        net.couplings, strength=np.full(2, weight), kinds=np.array([0, 1]),
        ages=tuple(Age(delay, delay) for delay in delays),
    )  # fmt: skip
    return replace(net, arms=arms, laws=laws, couplings=edges, periods=())


def least_real_part(
    lambda_M: float, K: float, M: float, alpha: float, weight: float, *delays: float, D: float = 0.0
) -> float:
    """The least Re Y/|Y| of dq over tau_h, the far arm free: two equations, one eliminated."""
    p = 1j * np.geomspace(1e-3, 1e4, 40_000)
    far = near = (M * p + K) * (p + alpha)
    near = near / (p + lambda_M)
    far = far / (p + alpha)  # lambda_M of the other arm is that of `pair`
    own = near * (p + weight) + D * p
    other = far * (p + weight) + D * p
    echo = near * far * weight**2 * np.exp(-p * sum(delays)) / other
    Y = p / (own - echo)
    return float((Y.real / np.abs(Y)).min())


@pytest.mark.parametrize("case", PAIRS)
def test_the_limit_of_a_pair_is_where_its_admittance_turns_negative(
    case: tuple[float, ...],
) -> None:
    *values, limit = case
    net = pair(*values)
    found = passive_range(net, Q)
    assert found.limit == pytest.approx(limit, rel=2e-3)
    for share, passive in ((0.99, True), (1.01, False)):
        lambda_M = share * found.limit
        assert (least_real_part(lambda_M, *values) >= 0) is passive
        assert (found.margin(lambda_M) >= 0) is passive


def test_friction_of_the_joints_adds_to_the_limit() -> None:
    values = (16.0, 6.6, 0.5, 2.0, 0.75, 0.75)
    found = passive_range(pair(*values, friction=5.0), Q)
    assert found.limit > 5.2
    assert least_real_part(0.99 * found.limit, *values, D=5.0) >= 0
    assert least_real_part(1.01 * found.limit, *values, D=5.0) < 0


def test_a_weak_coupling_has_a_least_lambda_m() -> None:
    """With lambda_M = 0 the echo turns the phase of the admittance beyond 90 degrees."""
    values = (16.0, 1.0, 2.0, 0.1, 0.75, 0.75)
    found = passive_range(pair(*values), Q)
    assert found.least > 0.0
    assert (
        least_real_part(0.95 * found.least, *values)
        < 0
        <= least_real_part(1.05 * found.least, *values)
    )
    assert found.margin(0.5 * found.least) == pytest.approx(-0.5 * found.least)


def test_one_robot_alone_has_the_limit_of_o9() -> None:
    net = net_of(DOCUMENTS["single-6"])
    found = passive_range(net, net.arms[0].heaviest)
    assert (found.least, found.limit) == (0.0, pytest.approx(2.0 + 16.0 / 6.58, rel=1e-3))


def test_margin_and_admittance_of_a_teleoperator_give_one_verdict() -> None:
    """The heaviest posture of the paper's teleoperator: passive up to 4.79, not up to 2.93."""
    held = bench(DOCUMENTS["pair-10"], (0.0, 0.0), known=True)
    net = held.network
    assert net is not None
    for lambda_M, passive in ((4.0, True), (6.0, False)):
        laws = tuple(replace(law, lambda_M=lambda_M) for law in net.laws)
        changed = replace(net, laws=laws)
        posture, _ = worst_posture(changed)
        assert posture == net.arms[net.port].heaviest
        assert (passive_range(changed, posture).margin(lambda_M) >= 0) is passive
        p = 1j * np.geomspace(0.03, 60.0, 400)
        Y = p[:, None, None] * changed.at(posture, changed.true_estimates()).gain(p)
        least = np.linalg.eigvalsh(Y + np.conj(np.swapaxes(Y, 1, 2))).min()
        assert bool(least >= 0) is passive
    notes = {q.name: q for q in margin(held)}
    assert notes["margin"].values == pytest.approx([4.79 - 10.0], abs=0.01)
    assert notes["margin"].note.startswith("below 0: not passive")
    assert "λΣw" in notes["margin"].how
