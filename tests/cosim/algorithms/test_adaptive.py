"""Adaptive macro steps: the algorithm step by step, closed forms, tolerances, refusals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import PlanError, RunError, ScenarioError
from cosim.engine.engine import Engine
from tests.cosim.algorithms import masses
from tests.cosim.algorithms.networks import column, networks, record
from tests.cosim.algorithms.test_gauss_seidel import OSCILLATOR
from tests.cosim.oracle import execute, start
from tests.cosim.scenarios import plan

SOLVERS = "tests.cosim.algorithms.solvers"
TROUBLE = "tests.cosim.algorithms.trouble"


def adaptive(components, links=(), tolerance=1e-4, step=0.5, stop=10.0, settings=None, **run):
    """The plan of components with macro steps."""
    given = {"tolerance": tolerance, **(settings or {})}
    return plan(
        components, links, algorithm="adaptive", adaptive=given, step=step, stop=stop, **run
    )


def errors(make, tolerance, **settings):
    """(largest error of both positions, macro steps, repeated steps) of the two masses."""
    p = adaptive(make(), tolerance=tolerance, settings=settings)
    rows = record(p)
    exact = masses.exact(np.arange(p.ticks + 1) * p.h)
    found = [np.abs(column(p, rows, name) - exact[:, i]).max()
             for name, i in (("first.x", 0), ("second.x", 2))]  # fmt: skip
    done = [int(column(p, rows, f"first.macro_{what}").sum()) for what in ("steps", "rejections")]
    return max(found), *done


# ---- what it does, step by step -----------------------------------------------------------------


@given(networks(models=("Integrator", f"{TROUBLE}:Passing")), st.data())
def test_the_engine_equals_the_oracle_to_the_bit(components, data):
    settings = {
        "iterations": data.draw(st.integers(1, 4)),
        "smallest": data.draw(st.sampled_from([0.25 / 2**k for k in (0, 3, 7)])),
    }
    tolerance = 10.0 ** -data.draw(st.integers(1, 5))
    components["late"] = {"model": "Gain", "period": 0.5}
    components["sampler"] = {"model": "Gain", "period": 0.5, "inputs": {"u": "b.y"}}
    components["held"] = {"model": "Integrator", "inputs": {"u": "sampler.y"}}
    law = {"law": "uniform", "low": 0.0, "high": 1.5}
    links = [{"from": "a.y", "to": "late.u", "delay": law}]
    one, two = (
        adaptive(components, links, tolerance, step=0.25, stop=6.0, settings=settings)
        for _ in range(2)
    )
    assert record(one, [data.draw(st.integers(1, 9))]).tobytes() == execute(two).tobytes()


@pytest.mark.parametrize("iterations", [1, 5])
@pytest.mark.parametrize("make", [masses.with_spring, masses.force_displacement])
def test_the_two_masses_equal_the_oracle_to_the_bit(make, iterations):
    one, two = (
        adaptive(make(), stop=2.0, tolerance=1e-3, settings={"iterations": iterations})
        for _ in range(2)
    )
    assert record(one, [1]).tobytes() == execute(two).tobytes()


def test_what_wires_convert_equals_the_oracle_to_the_bit():
    components = {
        name: {
            "model": f"{TROUBLE}:{model}",
            "start": {"x": 300.0},
            "inputs": {"u": {"from": f"{other}.y", "gain": -0.5}},
        }
        for name, other, model in (("a", "b", "Warming"), ("b", "a", "PassingHeat"))
    }
    one, two = (adaptive(components) for _ in range(2))
    rows = record(one)
    assert rows.tobytes() == execute(two).tobytes()
    assert column(one, rows, "a.macro_steps").max() > 1


def test_macro_steps_follow_each_other_without_gap_and_end_with_the_period():
    p = adaptive(masses.with_spring(), step=0.25, stop=3.0, tolerance=1e-3)
    _, (group,) = start(p)
    for tick in range(p.ticks):
        group.period(tick)
    times = np.array(group.kept)
    assert times[0, 0] == 0.0
    assert (times[1:, 0] == times[:-1].sum(axis=1)).all()  # the step is a power of two here
    assert times[-1].sum() == 3.0
    assert len(set(times[:, 1])) > 1
    assert set(np.log2(times[:, 1])) <= {-2.0 - k for k in range(11)}


# ---- closed forms -------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [masses.with_spring, masses.force_displacement])
def test_the_error_is_proportional_to_the_tolerance(make):
    tolerances = (1e-2, 1e-3, 1e-4, 1e-5)
    found = [errors(make, tolerance) for tolerance in tolerances]
    for (error, steps, rejected), tolerance in zip(found, tolerances, strict=True):
        assert 0.2 * tolerance < error < 3.0 * tolerance
        assert rejected < 0.1 * steps
    for (_, fewer, _), (_, more, _) in pairwise(found):
        assert 2.0 < more / fewer < 5.0  # the square root of 10, in steps of two


@pytest.mark.parametrize("make", [masses.with_spring, masses.force_displacement])
def test_the_coupling_has_order_two_also_with_direct_feedthrough(make):
    found = [_fixed(make, h) for h in (0.02, 0.01)]
    assert np.log2(found[0] / found[1]) == pytest.approx(2.0, abs=0.15)


def _fixed(make, h):
    """The error with macro steps of one size."""
    p = adaptive(make(), step=h, tolerance=1e9, settings={"smallest": h})
    exact = masses.exact(np.arange(p.ticks + 1) * p.h)
    return float(np.abs(column(p, record(p), "first.x") - exact[:, 0]).max())


def test_a_stiff_coupling_takes_as_small_steps_as_it_needs():
    stiff = masses.with_spring(k=1e4, d=20.0)
    p = adaptive(stiff, tolerance=1e-3, step=0.1, stop=2.0)
    rows = record(p)
    exact = masses.exact(np.arange(p.ticks + 1) * p.h, 1e4, 20.0)
    assert np.abs(column(p, rows, "first.x") - exact[:, 0]).max() < 3e-3
    size = column(p, rows, "first.macro_size")[1:]
    assert size[0] <= 0.1 / 2**6 < 0.1 / 2**5 <= size[-1]  # the fast motion has decayed


def test_an_oscillator_of_integrators_keeps_its_amplitude():
    p = adaptive(OSCILLATOR, tolerance=1e-5, stop=20.0)
    t = np.arange(p.ticks + 1) * p.h
    assert column(p, record(p), "x.y") == pytest.approx(np.cos(t), abs=1e-4)


def test_more_iterations_couple_more_strongly():
    # One fixed step of the implicit trapezoidal rule conserves the energy of the oscillator.
    def amplitude(iterations):
        p = adaptive(OSCILLATOR, tolerance=1e-9, step=0.25, stop=50.0,
                     settings={"iterations": iterations, "smallest": 0.25})  # fmt: skip
        rows = record(p)[-1]
        return float(np.hypot(*(rows[p.slots()[f"{n}.y"].start] for n in "xv")))

    assert amplitude(200) == pytest.approx(1.0, abs=1e-8)
    assert abs(amplitude(1) - 1.0) > 0.01


def test_what_is_not_coupled_is_stepped_once_in_its_period():
    alone = {"a": {"model": "Integrator"}, "b": {"model": "Integrator", "inputs": {"u": "a.y"}}}
    one = adaptive({"a": alone["a"]})
    assert not one.groups
    assert record(one).tobytes() == record(plan({"a": alone["a"]}, step=0.5, stop=10.0)).tobytes()
    held = adaptive(alone, settings={"fixed": ["b"]})
    assert not held.groups


def test_sampled_components_and_rates_bound_the_groups():
    components = {
        **masses.with_spring(),
        "slow": {"model": "Integrator", "period": 1.0, "inputs": {"u": "first.x"}},
        "sampler": {"model": "Gain", "period": 1.0, "inputs": {"u": "second.x"}},
    }
    p = adaptive(components)
    (group,) = p.groups
    assert [p.components[i].name for i in group.components] == ["first", "second", "spring"]
    assert p.order == ("sampler",)
    assert record(p).tobytes() == execute(adaptive(components)).tobytes()


def test_two_groups_have_steps_of_their_own():
    components = masses.with_spring() | {
        f"other_{name}": {**spec, "inputs": {k: v.replace("first", "other_first").replace(
            "second", "other_second").replace("spring", "other_spring")
            for k, v in spec["inputs"].items()}}
        for name, spec in masses.with_spring(k=400.0).items()
    }  # fmt: skip
    p = adaptive(components, stop=2.0)
    rows = record(p)
    sizes = [column(p, rows, f"{name}.macro_size")[-1] for name in ("first", "other_first")]
    assert sizes[0] > sizes[1]
    alone = adaptive(masses.with_spring(), stop=2.0)
    assert (column(p, rows, "first.x") == column(alone, record(alone), "first.x")).all()


def test_the_same_bytes_again_and_in_any_chunks():
    rows = record(adaptive(masses.force_displacement()))
    assert rows.tobytes() == record(adaptive(masses.force_displacement()), [3, 1, 7]).tobytes()


# ---- limits, and what goes wrong ----------------------------------------------------------------


def test_steps_at_the_limit_are_kept_and_counted():
    p = adaptive(masses.with_spring(k=1e4), step=0.1, stop=0.5, settings={"smallest": 0.05})
    with Engine(p) as engine:
        engine.initialize()
        engine.run(p.ticks)
        (facts,) = engine.macro_steps()
    assert facts["forced"] > 0
    assert facts["largest_error"] > 1.0
    assert facts["forced_at"] == 0.0
    assert [row["size"] for row in facts["sizes"]] == [0.1, 0.05]
    assert facts["accepted"] == sum(row["accepted"] for row in facts["sizes"]) == 10


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"fixed": ["nobody"]}, "no component 'nobody'"),
        ({"smallest": 1.0}, "expected at most the period"),
        ({"smallest": 0.0}, "must be positive"),
    ],
)
def test_invalid_settings_are_refused(settings, message):
    with pytest.raises((PlanError, ScenarioError), match=message):
        adaptive(OSCILLATOR, settings=settings)


def test_settings_of_another_algorithm_are_refused():
    with pytest.raises(ScenarioError, match=r'algorithm = "jacobi", expected "adaptive"'):
        plan(OSCILLATOR, algorithm="jacobi", adaptive={"tolerance": 1e-3})


def test_extrapolation_is_refused():
    given = {name: {**spec, "extrapolate": "linear"} for name, spec in OSCILLATOR.items()}
    with pytest.raises(PlanError, match="has lines of its own"):
        adaptive(given)


def test_a_component_that_cannot_save_its_state_is_named_with_the_way_out():
    given = {**OSCILLATOR, "v": {**OSCILLATOR["v"], "model": f"{SOLVERS}:Stateless"}}
    with pytest.raises(ScenarioError, match=r'v cannot save its state.*run.adaptive.fixed = \["v"'):
        adaptive(given)
    assert not adaptive(given, settings={"fixed": ["v"]}).groups


@pytest.mark.parametrize("model", ["Raises", "NotANumber"])
def test_a_failure_in_a_trial_step_ends_the_run_and_says_where(model):
    given = {**OSCILLATOR, "v": {**OSCILLATOR["v"], "model": f"{TROUBLE}:{model}"}}
    p = adaptive(given, step=0.5, stop=10.0)
    rows = np.empty((p.ticks + 1, p.n_signals))
    with Engine(p) as engine:
        engine.initialize()
        with pytest.raises(RunError) as caught:
            engine.run(p.ticks, rows)
        assert engine.tick == 4
        assert engine.rows == 5
    assert (caught.value.component, caught.value.tick) == ("v", 4)
    good = record(adaptive(OSCILLATOR, step=0.5, stop=10.0))
    assert rows[:5].tobytes() == good[:5].tobytes()


def test_a_step_too_long_for_a_component_is_halved_until_it_is_not():
    given = {**OSCILLATOR, "v": {**OSCILLATOR["v"], "model": f"{TROUBLE}:OnlyShort"}}
    p = adaptive(given, tolerance=1.0)
    rows = record(p)
    assert column(p, rows, "v.macro_size")[1:].max() == 0.0625
    assert column(p, rows, "v.macro_rejections").sum() >= 3


def test_a_state_that_cannot_be_restored_ends_the_run():
    given = {**OSCILLATOR, "v": {**OSCILLATOR["v"], "model": f"{TROUBLE}:NoWayBack"}}
    with Engine(adaptive(given)) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"v: .*there is no way back.*at tick 0"):
            engine.run(1)
