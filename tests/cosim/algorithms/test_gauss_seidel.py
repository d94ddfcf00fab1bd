"""Gauss-Seidel: the order given or found, and what each component then sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import PlanError
from cosim.schedule.order import sequence
from tests.cosim.algorithms.networks import column, networks, record
from tests.cosim.oracle import execute, start
from tests.cosim.scenarios import plan

#: x' = v, v' = -x, each with the other held over a step.
OSCILLATOR = {
    "x": {"model": "Integrator", "start": {"x": 1.0}, "inputs": {"u": "v.y"}},
    "v": {"model": "Integrator", "inputs": {"u": {"from": "x.y", "gain": -1.0}}},
}


def told(p):
    """Outputs by name and tick, (ticks + 1,), as the definition of Gauss-Seidel says them.

    Over its interval [a, b) a component holds what those before it in the order have at b, and
    what the others (itself among them) had at a.
    """
    signals, _ = start(p)
    y = {c.name: [signals[c.outputs[0].start]] for c in p.components}
    held = {c.name: signals[c.inputs[0].start] for c in p.components}
    for tick in range(p.ticks):
        now = {name: values[-1] for name, values in y.items()}
        for name in p.later:
            c = p.component(name)
            for w in (w for w in p.wires if w.target.component == name):
                source = w.source.component
                earlier = p.later.index(source) < p.later.index(name)
                if not earlier and tick % c.period == 0:
                    held[name] = w.gain * y[source][tick] + w.offset
                if earlier and (tick + 1) % c.period == 0:
                    held[name] = w.gain * now[source] + w.offset
            if (tick + 1) % c.period == 0:
                first = tick + 1 - c.period
                u = {"u": np.array(held[name])}
                now[name] = c.component.step(first * p.h, c.period * p.h, u)["y"]
        for name, values in y.items():
            values.append(now[name])
    return y


@given(networks(), st.data())
def test_the_engine_does_what_the_definition_says_to_the_bit(components, data):
    order = data.draw(st.one_of(st.just([]), st.permutations(list(components))))
    args = {"algorithm": "gauss-seidel", "order": order, "stop": 6.0}
    one, two, three = (plan(components, **args) for _ in range(3))
    rows = record(one, [data.draw(st.integers(1, 9))])
    assert rows.tobytes() == execute(two).tobytes()
    for name, values in told(three).items():
        assert column(one, rows, f"{name}.y") == pytest.approx(values, rel=0, abs=0)


@given(networks(), st.sampled_from(["jacobi", "gauss-seidel"]), st.integers(0, 3))
def test_links_and_rates_equal_the_oracle(components, algorithm, seed):
    components["late"] = {"model": "Gain", "period": 0.5}
    law = {"law": "uniform", "low": 0.0, "high": 1.5}
    links = [{"from": "a.y", "to": "late.u", "delay": law}]
    one, two = (plan(components, links, algorithm=algorithm, stop=9.0, seed=seed) for _ in range(2))
    assert record(one, [5, 2]).tobytes() == execute(two).tobytes()


def test_an_oscillator_keeps_its_amplitude_where_jacobi_lets_it_grow():
    # Gauss-Seidel is here the symplectic Euler method, which keeps x^2 + v^2 - h x v (v first).
    h = 0.25
    p = plan(OSCILLATOR, algorithm="gauss-seidel", order=["v", "x"], stop=100.0)
    rows = record(p)
    x, v = (column(p, rows, f"{name}.y") for name in "xv")
    kept = x * x + v * v - h * x * v
    assert kept == pytest.approx(kept[0], rel=1e-12)
    p = plan(OSCILLATOR, algorithm="jacobi", stop=100.0)
    rows = record(p)
    energy = sum(column(p, rows, f"{name}.y") ** 2 for name in "xv")
    assert energy[-1] == pytest.approx((1 + h * h) ** p.ticks, rel=1e-9)  # explicit Euler


def test_an_order_that_nobody_waits_in_leaves_jacobi():
    chain = {
        "a": {"model": "Integrator", "start": {"x": 1.0}, "inputs": {"u": "b.y"}},
        "b": {"model": "Integrator", "start": {"x": 2.0}, "inputs": {"u": "c.y"}},
        "c": {"model": "Integrator", "start": {"x": 3.0}},
    }
    late = record(plan(chain, algorithm="gauss-seidel", order=list("abc")))
    assert late.tobytes() == record(plan(chain, algorithm="jacobi")).tobytes()
    assert plan(chain, algorithm="gauss-seidel").later == ("c", "b", "a")  # as the wires go


@given(st.lists(st.tuples(st.sampled_from("abcdef"), st.sampled_from("abcdef")), max_size=20))
def test_an_order_that_is_found_depends_on_names_and_wires_only(edges):
    found = sequence("abcdef", edges)
    assert sorted(found) == list("abcdef")
    assert found == sequence("fedcba", edges[::-1] + edges)


def test_loops_are_begun_where_the_fewest_are_waited_for():
    # a and b wait for each other, c for both: one of the loop comes first, by name.
    assert sequence("abc", [("a", "b"), ("b", "a"), ("a", "c"), ("b", "c")]) == ("a", "b", "c")
    assert sequence("abc", [("c", "a"), ("a", "b"), ("b", "a")]) == ("c", "a", "b")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ({"order": ["x"]}, "wrong: v (there are: v, x)"),
        ({"order": ["x", "v", "w"]}, "wrong: w"),
        ({"order": ["x", "v", "x"]}, "wrong: x"),
        ({"algorithm": "jacobi", "order": ["x", "v"]}, 'the algorithm is "jacobi"'),
    ],
)
def test_an_order_has_every_component_once_and_needs_gauss_seidel(args, message):
    with pytest.raises(PlanError) as error:
        plan(OSCILLATOR, **{"algorithm": "gauss-seidel", **args})
    assert message in str(error.value)
    assert "test.toml: run.order" in str(error.value)
