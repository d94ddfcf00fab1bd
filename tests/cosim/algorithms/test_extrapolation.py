"""Inputs as lines over a step: second order where holding has first, and what refuses it."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from benchmarks.cases import rings
from cosim.base.errors import CosimError, PlanError
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from tests.cosim.algorithms.networks import column, networks, record
from tests.cosim.algorithms.test_gauss_seidel import OSCILLATOR
from tests.cosim.oracle import execute
from tests.cosim.scenarios import plan


def linear(components, names=None):
    """The components, those in `names` (default: all) extrapolating."""
    return {
        name: {**spec, "extrapolate": "linear"} if names is None or name in names else spec
        for name, spec in components.items()
    }


@given(
    networks(models=("Integrator", "Integrator", "Gain")),
    st.sets(st.sampled_from("abcde")),
    st.sampled_from(["sampled", "jacobi", "gauss-seidel"]),
)
def test_the_engine_equals_the_oracle_to_the_bit(components, names, algorithm):
    try:
        one, two = (
            plan(linear(components, names), algorithm=algorithm, stop=8.0) for _ in range(2)
        )
    except PlanError:
        assume(False)
    assert record(one, [3, 8]).tobytes() == execute(two).tobytes()


def test_two_integrators_become_adams_and_bashforth():
    h = 0.25
    p = plan(linear(OSCILLATOR), algorithm="jacobi", stop=10.0)
    rows = record(p)
    x, v = [1.0, 1.0], [0.0, 0.0]  # before the start: as at the start
    for _ in range(p.ticks):
        x, v = (
            [x[1], x[1] + h * (1.5 * v[1] - 0.5 * v[0])],
            [v[1], v[1] - h * (1.5 * x[1] - 0.5 * x[0])],
        )
    assert column(p, rows, "x.y")[-1] == pytest.approx(x[1], rel=1e-12)
    assert column(p, rows, "v.y")[-1] == pytest.approx(v[1], rel=1e-12)


def test_with_gauss_seidel_the_second_takes_the_mean_of_both_ends():
    h = 0.25
    p = plan(linear(OSCILLATOR, "x"), algorithm="gauss-seidel", order=["v", "x"], stop=10.0)
    rows = record(p)
    x, v = (column(p, rows, f"{name}.y") for name in "xv")
    assert np.diff(x) == pytest.approx(h / 2 * (v[1:] + v[:-1]), abs=1e-14)
    assert np.diff(v) == pytest.approx(-h * x[:-1], abs=1e-14)


@pytest.mark.parametrize(("algorithm", "names"), [("jacobi", "xv"), ("sampled", "xv")])
def test_holding_is_of_first_order_and_a_line_of_second(algorithm, names):
    def error(spec, step):
        p = plan(spec, algorithm=algorithm, step=step, stop=4.0)
        return abs(column(p, record(p), "x.y")[-1] - np.cos(4.0))

    for spec, order in ((OSCILLATOR, 1), (linear(OSCILLATOR, names), 2)):
        assert np.log2(error(spec, 1 / 64) / error(spec, 1 / 128)) == pytest.approx(order, abs=0.15)


def test_what_is_sampled_stays_held():
    sensed = {
        **OSCILLATOR,
        "plant": {"model": "Integrator", "inputs": {"u": "control.y"}, "start": {"x": 1.0}},
        "control": {"model": "Gain", "inputs": {"u": "x.y"}},
    }
    with pytest.raises(PlanError, match="sampled signals and signals of links are held"):
        plan(linear(sensed, ["plant"]))
    with pytest.raises(PlanError, match="it is sampled; expected a continuous component"):
        plan(linear(sensed, ["control"]))


def test_a_slow_source_is_no_line():
    slow = {**OSCILLATOR, "v": {**OSCILLATOR["v"], "period": 0.5}}
    with pytest.raises(PlanError, match=r"expected a multiple, so that v\.y is new"):
        plan(linear(slow, ["x"]))
    assert (
        record(plan(linear(slow, ["v"]))).tobytes() == execute(plan(linear(slow, ["v"]))).tobytes()
    )


@pytest.mark.parametrize("choice", ["fmi2", "fmi3"])
def test_fmus_extrapolate_like_anything_else(choice):
    def made():
        scenario = rings(3, 200).scenario(choice, 200)
        specs = {n: _extrapolating(c) for n, c in scenario.components.items()}
        return assemble(_with(scenario, specs))

    one, two = made(), made()
    rows = np.empty((one.ticks + 1, one.n_signals))
    with Engine(one) as engine:
        engine.initialize()
        engine.run(one.ticks, rows)
        rows[-1] = engine.signals
    assert rows.tobytes() == execute(two).tobytes()
    for step in two.components:
        step.component.close()


def _extrapolating(spec):
    return type(spec)(**{**_fields(spec), "extrapolate": "linear"})


def _with(scenario, components):
    return type(scenario)(**{**_fields(scenario), "components": components})


def _fields(struct):
    return {name: getattr(struct, name) for name in struct.__struct_fields__}


def test_a_word_that_is_no_way_to_extrapolate_is_refused():
    spec = {**OSCILLATOR["x"], "extrapolate": "cubic"}
    with pytest.raises(CosimError, match=r"components\.x\.extrapolate"):
        plan({**OSCILLATOR, "x": spec})
