"""Closed forms O3 to O6 and O9: against the numbers of the reading, and against each other."""

from __future__ import annotations

import copy
import sys
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.checks import laws
from cosim.loading.files import load
from cosim.predict import closed_form as closed
from cosim.predict import elimination
from cosim.predict import network as network_module
from cosim.predict.facts import DynamicFeedback
from cosim.predict.network import Complex, RobotNetwork, network
from cosim.predict.system import system
from cosim.scenario.assemble import assemble
from fmus.paper import oracles
from fmus.paper.experiments import THETA
from tests.analysis.cases import DOCUMENTS, net_of
from tests.bridge.zenoh.rehearsed import CONFIGS

K = 16.0

gains = st.floats(0.2, 20.0)
inertias = st.floats(0.1, 10.0)


def law(lambda_M: float, alpha: float = 0.5, feedback: float = K, **rest: float) -> DynamicFeedback:
    return DynamicFeedback(
        K=(feedback, feedback), Gamma=(1.0,) * 3, alpha=alpha, lambda_M=lambda_M, **rest
    )


# ---- O3: poles ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("lambda_M", "slow", "fast"), [(2.0, -0.476, -2.0), (6.0, -1.43, -2.0)])
def test_o3_of_the_paper(lambda_M: float, slow: float, fast: float) -> None:
    roots = closed.quasi_static_poles(law(lambda_M, 2.0), K, 10.0, 5.0)
    assert roots.real == pytest.approx([slow, fast], abs=5e-3)
    assert roots.real == pytest.approx(oracles.poles(K, 2.0, lambda_M, 10.0, 5.0))


def test_poles_with_inertia_are_those_of_the_known_polynomial() -> None:
    net, q = net_of(DOCUMENTS["single-6"]), (3.5, 3.0)
    found = closed.poles(net, q, net.true_estimates(), (10.0, 10.0), (5.0, 5.0))
    masses = np.linalg.eigvalsh(net.arms[0].inertia(THETA, q))
    each = np.concatenate([oracles.poles(K, 2.0, 6.0, 10.0, 5.0, m) for m in masses])
    assert found[0].real == pytest.approx(each.max(), rel=1e-6)
    for p in found:
        assert np.abs(np.real(p) - each).min() < 1e-5


def test_poles_of_a_pair_with_delay_solve_its_characteristic_equation() -> None:
    net, q = net_of(DOCUMENTS["pair-10"]), (0.3, 0.2)
    for p in closed.poles(net, q, net.true_estimates(), (10.0,), (5.0,)):
        A = net.at(q, net.true_estimates()).A(p)
        A[:2, :2] += (10.0 + 5.0 * p) * np.eye(2)
        assert np.linalg.svd(A, compute_uv=False)[-1] < 1e-6 * np.abs(A).max()


# ---- O4, O5: what is felt -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "damping"),
    [("pair-10", 4.0), ("pair-10-wire", 1.6), ("pair-1", 40.0), ("single-6", 32.0 / 6.0),
     ("single-2", 16.0), ("pair-10-jitter", 4.0)],
)  # fmt: skip
def test_o4_felt_damping_of_the_paper(name: str, damping: float) -> None:
    assert closed.felt_damping(net_of(DOCUMENTS[name]), K) == pytest.approx(damping, rel=1e-4)


def test_without_integral_a_spring_is_felt_and_no_damper() -> None:
    net = net_of(DOCUMENTS["single-0"])
    assert closed.felt_damping(net, K) == np.inf
    assert closed.felt_stiffness(net, K) == pytest.approx(
        1 / oracles.finite_manipulability(K, 2.0), rel=1e-5
    )


def test_with_integral_no_spring_is_felt() -> None:
    assert closed.felt_stiffness(net_of(DOCUMENTS["single-6"]), K) == 0.0


@pytest.mark.parametrize(("lambda_M", "kappa"), [(10.0, 1.6), (1.0, 16.0)])
def test_o5_static_stiffness_of_the_paper(lambda_M: float, kappa: float) -> None:
    pair = law(lambda_M, lambda_=2.0)
    assert closed.static_stiffness(pair, 1.0, K) == pytest.approx(kappa)
    assert closed.static_stiffness(pair, 1.0, K) == pytest.approx(
        oracles.static_stiffness(K, 0.5, lambda_M, 2.0)
    )


def test_o5_without_integral_is_rigid() -> None:
    assert closed.static_stiffness(law(0.0, lambda_=2.0), 1.0, K) == np.inf


# ---- O6: the bound ------------------------------------------------------------------------------


def test_o6_of_one_arm() -> None:
    t = np.array([0.0, 1.0, 60.0])
    found = closed.manipulability_bound(net_of(DOCUMENTS["single-6"]), t, K)
    assert found == pytest.approx(oracles.manipulability_bound(t, K, 2.0, 6.0))


def test_o6_of_a_pair_is_that_of_one_arm_times_what_the_other_makes_of_it() -> None:
    """Of the mean position of both arms: half of one arm's, and more with a delay there and back.

    Two arms that hear each other with lambda = 2/s and T = 0.75 s: the sum of a column of L⁻¹ is
    1/(p + lambda (1 - exp(-pT))).
    """
    t = np.array([10.0])
    one = oracles.manipulability_bound(t, K, 0.5, 10.0)
    wired = closed.manipulability_bound(net_of(DOCUMENTS["pair-10-wire"]), t, K)
    delayed = closed.manipulability_bound(net_of(DOCUMENTS["pair-10"]), t, K)
    p = 1j * np.geomspace(1e-3, 1e3, 20_000)
    H = np.abs(p / (p + 2.0 * (1 - np.exp(-0.75 * p)))).max() / 2
    assert wired == pytest.approx(one / 2, rel=1e-3)
    assert delayed[0] / one[0] == pytest.approx(H, rel=0.01)


def test_o6_without_alpha_bounds_nothing() -> None:
    assert (
        closed.manipulability_bound(net_of(DOCUMENTS["no-alpha"]), np.array([1.0]), K)[0] == np.inf
    )


# ---- O9: passivity ------------------------------------------------------------------------------


def test_o9_of_the_paper() -> None:
    M = oracles.inertia(THETA, np.zeros((1, 2)))[0]
    assert closed.passive_limit(law(10.0), M, (K, K)) == pytest.approx(2.93, abs=5e-3)
    assert closed.passive_limit(law(10.0), M, (K, K)) == pytest.approx(
        oracles.passive_limit(THETA, (0.0, 0.0), K, 0.5)
    )
    assert closed.passive_limit(law(10.0, lambda_c=6.0), M, (K, K)) == 6.5


@given(lambda_M=gains, alpha=gains, M=inertias, feedback=st.floats(1.0, 50.0))
def test_o9_is_where_the_admittance_stops_being_positive_real(
    lambda_M: float, alpha: float, M: float, feedback: float
) -> None:
    limit = closed.passive_limit(law(lambda_M, alpha), M * np.eye(1), (feedback,))
    p = 1j * np.geomspace(1e-3, 1e5, 2000)
    Y = (p + lambda_M) / ((M * p + feedback) * (p + alpha))
    if abs(lambda_M - limit) > 1e-2 * limit:
        assert (Y.real.min() >= 0) == (lambda_M <= limit)


def stiffest_grip(law: DynamicFeedback, M: float, K: float, k_d: float = 0.0) -> float:
    """The k_p at which such a grip begins to swing, N.m/rad; inf where none does."""
    a = K + law.alpha * M + k_d
    excess = M * law.lambda_M - a
    return inf if excess <= 0 else a * (law.alpha * K + law.lambda_M * k_d) / excess


@given(lambda_M=gains, alpha=gains, M=inertias, k_p=st.floats(1.0, 1e4), k_d=st.floats(0.0, 20.0))
def test_routh_says_what_the_roots_say(
    lambda_M: float, alpha: float, M: float, k_p: float, k_d: float
) -> None:
    one = law(lambda_M, alpha)
    rise = oracles.poles(K, alpha, lambda_M, k_p, k_d, M).max()
    if abs(rise) > 1e-9:
        assert (k_p < stiffest_grip(one, M, K, k_d)) == (rise < 0)


@pytest.mark.parametrize("lambda_M", [6.0, 10.0])
def test_stiffest_grip_by_frequency_is_that_of_routh(lambda_M: float) -> None:
    document = DOCUMENTS["single-6"]
    net = net_of(document)
    one = law(lambda_M, 2.0)
    changed = replace(net, laws=(one,), periods=())
    M = np.linalg.eigvalsh(net.arms[0].inertia(THETA, (0.0, 0.0)))
    expected = min(stiffest_grip(one, float(m), K) for m in M)
    assert closed.stiffest_network_grip(changed, (0.0, 0.0)) == pytest.approx(expected, rel=2e-3)


# ---- the network --------------------------------------------------------------------------------


def test_gain_of_one_arm_is_the_admittance_of_the_reading() -> None:
    net, q, p = net_of(DOCUMENTS["single-6"]), (0.3, 0.2), 1.3j
    M = net.arms[0].inertia(THETA, q)
    Y = (p + 6.0) / (p + 2.0) * np.linalg.inv(M * p + K * np.eye(2))
    assert p * net.at(q, net.true_estimates()).gain(p) == pytest.approx(Y)


def test_with_no_estimate_the_impedance_is_a_mass_and_a_passive_filter() -> None:
    net, q, p = net_of(DOCUMENTS["single-6"]), (0.3, 0.2), 0.7j
    M = net.arms[0].inertia(THETA, q)
    Z = M * p + K * (p + 2.0) / (p + 6.0) * np.eye(2)
    assert np.linalg.inv(p * net.at(q, net.initial_estimates()).gain(p)) == pytest.approx(Z)


def test_a_pair_is_two_robots_with_the_delay_of_each_link() -> None:
    net = net_of(DOCUMENTS["pair-10"])
    assert net.names == ("master_control", "slave_control") and net.port == 0
    edges = net.couplings
    assert edges.strength.tolist() == [2.0, 2.0]
    assert (edges.receivers.tolist(), edges.senders.tolist()) == ([0, 1], [1, 0])
    assert [age.mean for age in edges.ages] == [0.75] and not any(edges.kinds)
    assert not net.outside.any()


def test_many_robots_are_felt_as_a_damping_in_proportion_and_not_as_a_spring() -> None:
    """O4: the sum over all robots, also where that is a thousand times the damping of one.

    Without lambda_M they are springs: alpha K (1 + lambda T) each, for delays of 75 ms.
    """
    few, more = many(20), many(400)
    damping = closed.felt_damping(few, K)
    assert closed.felt_damping(more, K) == pytest.approx(20 * damping, rel=1e-3)
    assert closed.felt_damping(more, 100 * K) == pytest.approx(2000 * damping, rel=1e-3)
    assert closed.felt_stiffness(more, 100 * K) == 0.0
    still = replace(few, laws=tuple(replace(law, lambda_M=0.0) for law in few.laws))
    assert closed.felt_damping(still, K) == np.inf
    assert closed.felt_stiffness(still, K) == pytest.approx(20 * 1.6 * 1.075 * K, rel=1e-3)


def test_a_network_of_many_robots_feels_as_one_that_is_taken_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    net = many(12)
    dense = [closed.felt_damping(net, K, D) for D in (0.0, 0.7)]
    monkeypatch.setattr(network_module, "DENSE", 0)
    sparse = [closed.felt_damping(net, K, D) for D in (0.0, 0.7)]
    assert sparse == pytest.approx(dense, rel=1e-6)


def test_the_couplings_are_late_by_the_age_of_each_link() -> None:
    """One link with a varying delay, one with a constant delay, between two robots."""
    document = copy.deepcopy(DOCUMENTS["pair-10-jitter"])
    document["links"][1]["delay"] = {"law": "constant", "delay": 0.4}
    L = net_of(document).L(np.array([0.0, 2.0j]))
    assert L[0] == pytest.approx(np.array([[2.0, -2.0], [-2.0, 2.0]]))
    assert L[1, 1, 0] == pytest.approx(-2 * np.exp(-0.8j))
    jittery = -2 * np.exp(-2.0j * np.linspace(0.3, 1.2, 2000)).mean()
    assert L[1, 0, 1] == pytest.approx(jittery, rel=0.05) and abs(L[1, 0, 1]) < 1.9


def test_what_is_held_by_several_hands_is_one_network_with_several_ports() -> None:
    settings = ('graphs.net.kind="ring"', "graphs.net.n=5", "components.robot.parameters.k_p=10")
    scenario = load(CONFIGS / "many.toml", settings)
    found = system(scenario, assemble(scenario))
    nets = [network(found, name) for name in found.held()]
    assert len(nets) == 5 and None not in nets
    assert [net.port for net in nets if net is not None] == [0, 1, 2, 3, 4]
    assert len({id(net.couplings) for net in nets if net is not None}) == 1


@pytest.mark.parametrize("n", [3, 6, 11])
def test_the_slowest_pole_that_a_hand_feels_is_that_of_the_whole_network(
    n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    net = many(n)
    place, grip = net.arms[net.port].grip.place, ((10.0, 10.0), (5.0, 5.0))
    whole = closed.poles(net, place, net.true_estimates(), *grip)
    monkeypatch.setattr(closed, "WHOLE", 0)
    felt = closed.poles(net, place, net.true_estimates(), *grip)
    assert felt[0].real == pytest.approx(whole[0].real, rel=1e-6)
    assert abs(felt[0].imag) < 1e-9


def test_a_larger_network_is_slower_in_proportion(monkeypatch: pytest.MonkeyPatch) -> None:
    rates = []
    for n in (20, 40, 80):
        net = many(n)
        place = net.arms[net.port].grip.place
        roots = closed.poles(net, place, net.true_estimates(), (10.0, 10.0), (5.0, 5.0))
        rates.append(n * roots[0].real)
    assert rates == pytest.approx([rates[0]] * 3, rel=0.05)
    monkeypatch.setattr(closed, "MANY", 100)
    assert not len(closed.poles(many(60), place, many(60).true_estimates(), (10.0,), (5.0,)))


def many(n: int) -> RobotNetwork:
    """The network of configs/many.toml on a ring of n robots."""
    settings = ('graphs.net.kind="ring"', f"graphs.net.n={n}")
    scenario = load(CONFIGS / "many.toml", settings)
    net = network(system(scenario, assemble(scenario)), "robot1")
    assert net is not None and len(net.laws) == n
    return net


def test_a_network_is_the_same_taken_whole_by_its_edges_and_without_scipy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every column at the port: with friction, late gravity, and arms that differ."""
    net = many(12)
    arms = [replace(arm, damping=(0.3, 0.1), gravity=(3.0, 1.0)) for arm in net.arms]
    slower = [replace(law, alpha=law.alpha + 0.1 * i) for i, law in enumerate(net.laws)]
    net = replace(net, arms=tuple(arms), laws=tuple(slower))
    estimates = [tuple(0.7 * x for x in arm.parameters) for arm in net.arms]
    p = np.array([1e-3 + 0j, 0.03 + 0.1j, 2.0j, 60.0j])

    def found() -> list[Complex]:
        linear = net.at((0.5, 0.8), estimates)
        felt = np.array(closed.felt_damping(net, K, 0.7), dtype=np.complex128)
        return [linear.gain(p), linear.mean_gain(p), net.mean_inverse(p), felt]

    whole = found()
    monkeypatch.setattr(network_module, "DENSE", 0)
    by_edges = found()
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    for a, b, c in zip(whole, by_edges, found(), strict=True):
        assert a.shape == b.shape and np.allclose(a, b, rtol=1e-8, atol=0.0)
        assert np.allclose(a, c, rtol=1e-8, atol=0.0)
    monkeypatch.setattr(elimination, "WITHOUT_SCIPY", 23)
    with pytest.raises(ScenarioError, match="12 robots need SciPy: pip install"):
        found()
    known = system(scenario := load(CONFIGS / "many.toml"), assemble(scenario))
    (finding,) = laws.prediction(known)
    assert finding.reason.startswith("not computed: closed forms of 25 robots need SciPy")
