"""What is measured through engine and FMUs, against the closed forms and the reading's numbers."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.analysis.analysis import Analysis, analyse
from cosim.analysis.analyzed_port import Subject, find_port
from cosim.analysis.conditions import unmet_conditions
from cosim.analysis.contacts import by_grip
from cosim.analysis.experiments import stiffest
from cosim.analysis.force_tests import by_push, sweep
from cosim.analysis.quantity import quantity, with_error
from cosim.base.copies import replace
from cosim.predict.closed_form import manipulability_bound
from cosim.predict.frequency import MultiSine, PortGain, degree
from cosim.predict.network import network as network_around
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from fmus.paper.experiments import single, teleoperator
from tests.analysis.cases import (
    CONSTANT,
    DOCUMENTS,
    Document,
    analysed,
    bench,
    net_of,
    number,
    pointmass,
    subject,
)
from tests.tiers import first_fast

# ---- one arm, Sec. VII-A ------------------------------------------------------------------------


def test_numbers_of_the_paper_s_single_arm() -> None:
    found = analysed("single-6")
    assert number(found, "effort").values == pytest.approx([46.0], rel=0.01)
    assert number(found, "holding").values[0] < 0.01
    assert number(found, "growth").values == pytest.approx([0.5], abs=0.1)
    M = number(found, "manipulability")
    assert M.values == pytest.approx([0.429], rel=3e-3)
    assert not M.expected and "no bound: O6 (2.419 rad/(N.m)) needs θ known" in M.note
    assert number(found, "observer_min").values[0] >= -1e-9


def test_closed_forms_stand_next_to_what_is_measured() -> None:
    found = analysed("single-6")
    for name, tolerance in (
        ("degree", 1e-3),
        ("push_damping", 1e-3),
        ("damping_slowly_started", 2e-3),
        ("damping_slowly_known", 2e-3),
        ("inertia_quickly_known", 0.05),
        ("grip_known", 0.12),
        ("approach", 0.05),
    ):
        q = number(found, name)
        assert q.expected, name
        assert q.values == pytest.approx(np.broadcast_to(q.expected, len(q.values)), rel=tolerance)


def test_a_push_gets_the_share_of_the_gain_that_the_reading_says() -> None:
    """8.608 of a push against a gain of 9.510 rad/(N.m) after 80 s, without inertia: 0.905."""
    assert number(analysed("single-6"), "push_share").values == pytest.approx([0.905], abs=2e-3)


def test_a_pd_hand_is_recognised_as_such() -> None:
    felt = number(analysed("single-6"), "felt")
    assert felt.missing and "k_d = 5 N.m.s/rad, k_p = 10 N.m/rad" in felt.note


# ---- degree: lambda_M, alpha --------------------------------------------------------------------


@pytest.mark.parametrize(("name", "k"), [("single-6", 1), ("single-0", 0), ("no-alpha", 2)])
def test_degree_is_the_number_of_integrals(name: str, k: int) -> None:
    for known in (False, True):
        found, whole = degree(sweep(bench(DOCUMENTS[name], known=known)).measured)
        assert whole and found == pytest.approx(k, abs=0.02)


def test_without_alpha_the_velocity_has_degree_one() -> None:
    found = analysed("velocity")
    assert found.port.response == "robot.dq"
    assert number(found, "degree").values == pytest.approx([1.0], abs=0.02)
    assert not [q for q in found.tests if q.name.startswith(("real_part", "push_damping"))]


def test_without_integral_the_push_comes_to_rest() -> None:
    (rest,) = [q for q in by_push(bench(DOCUMENTS["single-0"])) if q.name == "push_stiffness"]
    assert np.array(rest.values) == pytest.approx(32.0, rel=1e-3)
    assert rest.expected == pytest.approx([32.0], rel=1e-5)


# ---- passivity ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "passive"), [("single-2", True), ("single-6", False)])
def test_o9_margin_says_whether_the_port_is_passive(name: str, passive: bool) -> None:
    """Heaviest posture, estimate right: alpha + K/6.58 = 4.43 lies between 2 and 6."""
    heavy = bench(DOCUMENTS[name], (0.0, 0.0), known=True)
    found = sweep(heavy)
    assert (found.measured.least()[2] > 0) == passive
    assert found.closed is not None
    assert found.measured.least()[2] == pytest.approx(found.closed.least()[2], abs=5e-3)


def test_without_estimate_the_port_is_passive_at_any_gain() -> None:
    assert sweep(bench(DOCUMENTS["single-6"], (0.0, 0.0))).measured.least()[2] > 0


def test_the_grip_that_swings_is_where_the_closed_form_says() -> None:
    (found,) = by_grip(bench(DOCUMENTS["pair-10"], (0.0, 0.0), known=True))
    assert found.values == pytest.approx(found.expected, rel=0.1)


# ---- the teleoperator, Sec. VII-C ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "damping", "kappa"), first_fast([("pair-1", 40.0, 16.0), ("pair-10", 4.0, 1.6)])
)
def test_o4_and_o5_of_the_pair(name: str, damping: float, kappa: float) -> None:
    found = analysed(name)
    felt, stiffness = number(found, "push_damping"), number(found, "stiffness")
    assert np.array(felt.values) == pytest.approx(damping, rel=1e-3)
    assert np.array(stiffness.values) == pytest.approx(kappa, rel=1e-3)
    assert np.array(number(found, "reflection").values) == pytest.approx(1.0, rel=1e-3)
    assert number(found, "degree").values == pytest.approx([1.0], abs=0.02)


def test_o4_without_delay() -> None:
    (felt,) = [q for q in by_push(bench(DOCUMENTS["pair-10-wire"])) if q.name == "push_damping"]
    assert np.array(felt.values) == pytest.approx(1.6, rel=2e-3)


def test_o4_over_delays_that_jump() -> None:
    (felt,) = [q for q in by_push(bench(DOCUMENTS["pair-10-jitter"])) if q.name == "push_damping"]
    assert np.array(felt.values) == pytest.approx(4.0, rel=0.03)


def test_port_of_a_pair_by_frequency_is_the_closed_form() -> None:
    for known in (False, True):
        found = sweep(bench(DOCUMENTS["pair-10"], known=known))
        assert found.closed is not None
        error = np.abs(found.measured.G - found.closed.G).max(axis=(1, 2))
        slow = found.measured.omega < 5.0
        assert (error / found.closed.size)[slow].max() < 0.02
        assert (error / found.closed.size).max() < 0.08  # sampled at 5 ms, ω up to 60 rad/s


@pytest.mark.slow
def test_z_width_is_told_with_what_limits_it() -> None:
    found = number(analysed("pair-10"), "z_width")
    assert found.values[0] > 1e4 and "at least" in found.note and "free: 4" in found.note


def test_effort_of_lambda_1_is_that_of_the_reading() -> None:
    """85 N.m √s over the paper's links, and 1.6 times what lambda_M = 10 takes."""
    ten, one = (number(analysed(name), "effort").values[0] for name in ("pair-10", "pair-1"))
    assert ten == pytest.approx(47.0, rel=0.03) and one == pytest.approx(85.0, rel=0.03)


# ---- what is claimed only where it holds, and with its uncertainty ------------------------------


def apart(distance: float) -> Document:
    """A pair with known parameters over constant delays, `distance` (rad) apart, hardly pushed."""
    known = {"theta_hat": [3.34, 1.2, 0.97], "Gamma": 0.0}
    pair = teleoperator(
        30.0, link=CONSTANT, back={"delay": {"law": "constant", "delay": 0.1}}, grip={},
        master={"tau_ext": [1e-3, 0.0]}, **known,
    )  # fmt: skip
    for name, q in (("master", 0.0), ("slave", distance)):
        pair["components"][name]["start"]["q"] = [q, 0.0]
    return pair


def test_o6_is_claimed_only_for_arms_that_start_together() -> None:
    """Arms that start apart move each other, whatever the hand does: M^t has no bound then.

    Their mean moves too, as the delays there and back differ.
    """
    for distance in (0.0, 1.0):
        found = analyse(subject(apart(distance), "master"), tests=False)
        M = number(found, "manipulability")
        assert bool(M.expected) == (distance == 0.0)
        if M.expected:
            assert M.values[0] < M.expected[0] and found.bound is not None
        else:
            net = net_of(apart(distance), "master")
            limit = manipulability_bound(net, np.array([30.0]), 16.0)[0]
            assert M.values[0] > limit and found.bound is None
            assert "equal ξ_i(0), found 0.5 rad/s apart" in M.note


def test_conditions_of_o6_are_named_one_by_one() -> None:
    scenario = build(single(theta_hat=[3.34, 1.2, 0.97], Gamma=0.0, z=[0.1, 0.0]), Path("t.toml"))
    known, _ = find_port(scenario, assemble(scenario))
    net = network_around(known, "robot")
    assert net is not None and unmet_conditions(known, net) == ("dq(0) = z(0) = 0",)
    jumping = build(teleoperator(slave={"k_w": 5.0}), Path("t.toml"))
    known, _ = find_port(jumping, assemble(jumping))
    net = network_around(known, "master")
    assert net is not None
    assert {phrase.split(",")[0] for phrase in unmet_conditions(known, net)} == {
        "equal ξ_i(0)", "θ known", "no other force", "delays and weights that are constant",
    }  # fmt: skip


def test_the_rate_of_approach_agrees_with_the_pole_of_all_estimates() -> None:
    """-0.377 1/s with the estimates of both arms; with that of the port alone it was -0.51."""
    rate = number(analyse(subject(teleoperator()), tests=False), "approach")
    assert abs(rate.values[0] - rate.expected[0]) < rate.error[0]
    assert rate.expected == pytest.approx([-0.377], rel=0.02)


def test_a_lossless_mass_is_passive_and_its_units_are_those_of_a_line() -> None:
    """1/(m p): Re Y is 0 up to rounding; a felt mass is in kg."""
    share = number(analysed_mass(), "real_part_started")
    assert abs(share.values[0]) < 1e-9
    assert (
        share.note.startswith("passive from 0.03 rad/s to 60 rad/s; Re Y =")
        and "m/(N.s) at" in share.note
    )
    assert number(analysed_mass(), "inertia_quickly_started").unit == "kg"
    assert number(analysed_mass(), "damping_slowly_started").unit == "N.s/m"


@lru_cache(maxsize=1)
def analysed_mass() -> Analysis:
    return analyse(subject(pointmass(0.0)))


def test_noise_is_in_the_uncertainty_and_undecided_ports_get_no_verdict() -> None:
    omega, share = np.array([0.1, 1.0]), -0.05
    Y = np.array([[[1.0]], [[share + 1j * np.sqrt(1 - share**2)]]])
    G = Y / (1j * omega[:, None, None])
    for noise, verdict in ((1e-3, False), (0.1, None)):
        sd = noise * np.abs(G)
        assert PortGain(omega, G, 1e-9, 0.1, sd).passive() is verdict
        error = PortGain(omega, G, 1e-9, 0.1, sd).error
        assert error == pytest.approx([2 * noise / np.sqrt(2)] * 2)
    assert PortGain(omega[:1], G[:1], 1e-9).passive() is True


def test_the_deviation_of_a_transform_is_that_of_the_noise() -> None:
    """White noise of sd σ: a bin of n values has variance n σ², and 1/p of that over p periods."""
    sines = MultiSine.spread(0.1, 10.0, 0.01, 20, 1.0)
    noise = np.random.default_rng(0).normal(0.0, 0.3, (8, sines.n, 1))
    clean = 5.0 * sines.values()[None, :, None]
    for periods in (1, 8):
        found = sines.deviation(clean + noise[:periods])
        expected = 0.3 * np.sqrt(sines.n / periods)
        assert np.sqrt((found**2).mean()) == pytest.approx(expected, rel=0.2)


def test_uncertain_numbers_are_printed_with_their_uncertainty() -> None:
    q = quantity("x", "x", [18.934, 2.0], "s", "", error=[1.13, 0.0])
    assert q.text == "(18.9 ± 1.1, 2) s" and q.as_data()["error"] == [1.13, 0.0]
    assert with_error(-0.398, 0.1289) == "-0.40 ± 0.13"
    assert with_error(3.26e4, 1234.0) == "32600 ± 1234"
    assert with_error(4.014, 1e-4) == "4.014"


def test_delays_that_jump_act_by_their_mean_over_the_distribution() -> None:
    """U[0.3, 1.2] s: E exp(-pT) = exp(-0.75 p) sin(0.45 ω)/(0.45 ω) at p = jω."""
    net = net_of(DOCUMENTS["pair-10-jitter"])
    omega = np.array([0.3, 2.0, 5.0])
    L = net.L(1j * omega)
    expected = -2.0 * np.exp(-0.75j * omega) * np.sinc(0.45 * omega / np.pi)
    assert L[:, 0, 1] == pytest.approx(expected, abs=0.03)


# ---- nothing known ------------------------------------------------------------------------------


@pytest.mark.parametrize(("b", "k"), [(2.0, 1), (0.0, 2)])
def test_a_point_mass_without_facts(b: float, k: int) -> None:
    """Sec. III: 1/(m p² + b p); what is felt is m and b."""
    found = analyse(subject(pointmass(b)))
    assert number(found, "degree").values == pytest.approx([float(k)], abs=0.02)
    assert number(found, "inertia_quickly_started").values == pytest.approx([1.5], rel=0.02)
    assert number(found, "damping_slowly_started").values == pytest.approx([b], abs=1e-2)
    assert all(not q.expected for q in found.tests)
    if b:
        assert number(found, "push_damping").values == pytest.approx([b], rel=1e-3)


def test_a_run_that_diverges_is_analysed_up_to_there() -> None:
    document = DOCUMENTS["single-6"]
    control = document["components"]["control"]
    wild = document["components"] | {
        "control": control | {"start": control["start"] | {"K": 200.0}}
    }
    s = subject(document | {"components": wild})
    assert s.signals.stopped  # type: ignore[attr-defined]
    found = analyse(s, tests=False)
    assert number(found, "effort").values[0] > 0 and not found.tests


def test_tests_that_cannot_be_done_say_why() -> None:
    s = subject(DOCUMENTS["single-6"])
    found = analyse(Subject(s.title, s.signals, replace(s.port, inject=""), s.system))
    assert not found.tests and "no input for them is named" in found.remarks[0]


def test_bands_without_the_slow_part_tell_of_a_whole_degree_only_if_it_is() -> None:
    """At 2 rad/s the corner at alpha is in the way: not a whole number, and said so."""
    found, whole = degree(sweep(bench(DOCUMENTS["single-6"]), lowest=2.0).measured)
    assert not whole and 1.0 < found < 2.0


def test_network_of_a_bench_knows_its_port() -> None:
    assert bench(DOCUMENTS["pair-10"]).network is not None
    assert net_of(DOCUMENTS["pair-10"]).law.lambda_M == 10.0


# ---- bisection ----------------------------------------------------------------------------------


@given(limit=st.floats(2.0, 9e3))
def test_the_stiffest_is_found_to_five_percent(limit: float) -> None:
    tried: list[float] = []

    def settles(k: float) -> bool:
        tried.append(k)
        return k < limit or k > 3e4  # settles again where it is stiffer still

    found = stiffest(settles, 1e5)
    assert found <= limit < found * 1.06 and len(tried) < 20


def test_all_or_nothing_settles() -> None:
    assert stiffest(lambda k: True, 1e5) == np.inf
    assert stiffest(lambda k: False, 1e5) == 0.0
