"""Outputs in macro steps that depend on each other at once: algebraic loops, solved at each end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.reporting.macro_steps import macro_lines
from tests.cosim.algorithms import direct
from tests.cosim.algorithms.networks import column, record
from tests.cosim.algorithms.test_adaptive import adaptive
from tests.cosim.oracle import execute

TOLERANCE = 1e-4


def found(components, threads=1, **run):
    """(times, y of each component, facts of the groups) of a run."""
    p = adaptive(components, tolerance=TOLERANCE, **run)
    rows = np.empty((p.ticks + 1, p.n_signals))
    with Engine(p, threads=threads) as engine:
        engine.initialize()
        engine.run(p.ticks, rows)
        rows[p.ticks] = engine.signals
        facts = engine.macro_steps()
    y = np.stack([column(p, rows, f"{name}.y") for name in components], axis=1)
    return np.arange(p.ticks + 1) * p.h, y, facts


def assert_solved(components, **run):
    t, y, _ = found(components, **run)
    expected = direct.solution(components, t)
    largest = np.maximum.accumulate(np.abs(expected))
    assert (np.abs(y - expected) <= TOLERANCE * (0.01 + largest)).all()


@pytest.mark.parametrize("gain", [0.5, -0.9, -1.0, 0.99, 2.0, -20.0])
def test_two_plants_in_a_loop_agree_with_each_other(gain):
    assert_solved(direct.pair(gain, 1.0))


@st.composite
def loops(draw, most):
    """Plants in a ring, with further wires among them; their gains add up to `most` at most."""
    names = "abcd"[: draw(st.integers(1, 4))]
    number = st.floats(-1.0, 1.0).map(lambda x: round(x, 6))
    components = {}
    for i, name in enumerate(names):
        sources = {"u0": names[i - 1]}
        for port in draw(st.sets(st.sampled_from(direct.INPUTS[1:]))):
            sources[port] = draw(st.sampled_from(names))
        fed = {port: {"from": f"{source}.y", "gain": draw(st.sampled_from([1.0, -0.5]))}
               for port, source in sources.items()}  # fmt: skip
        d = most / 3.0 * np.array([draw(number) for _ in range(3)])
        assume(abs(d[0]) > 0.01)
        components[name] = direct.plant(draw(number), draw(number), d.tolist(), **fed)
    return components


@given(loops(most=0.95))
def test_linear_loops_with_a_gain_below_one_are_solved_to_the_tolerance(components):
    assert_solved(components, stop=2.0)


@given(loops(most=3.0), st.integers(1, 3), st.sampled_from([0.5, 0.125]))
def test_loops_of_any_gain_are_solved_and_equal_the_oracle_to_the_bit(
    components, iterations, smallest
):
    assume(np.linalg.cond(np.eye(len(components)) - direct.gains(components)) < 30.0)
    settings = {"iterations": iterations, "smallest": smallest}
    one, two = (adaptive(components, stop=2.0, settings=settings) for _ in range(2))
    assert record(one, [1]).tobytes() == execute(two).tobytes()
    assert_solved(components, stop=2.0, settings=settings)


def test_the_oracle_agrees_about_a_loop_with_a_chain_before_and_behind_it():
    components = {
        "before": direct.plant(0.3, 1.0, (0.5, 0.0, 0.0), u0="c.z"),
        "c": direct.plant(0.2, -1.0, u0="behind.z"),
        **direct.pair(-3.0, 0.7, "Cubing"),
        "behind": direct.plant(0.1, 0.0, (2.0, -1.0, 0.0), u0="b.y", u1="before.y"),
    }
    components["a"]["inputs"]["u1"] = "before.y"
    components["a"]["parameters"]["d"] = [-3.0, 0.5, 0.0]
    one, two = (adaptive(components, settings={"smallest": 0.0625}) for _ in range(2))
    rows = record(one)
    assert rows.tobytes() == execute(two).tobytes()
    y = {name: column(one, rows, f"{name}.y") for name in components}
    behind = 0.1 + 2.0 * y["b"] - y["before"]
    assert y["behind"] == pytest.approx(behind, abs=1e-3)


@pytest.mark.parametrize(("model", "d"), [("Mixing", 2.0), ("Mixing", 0.5), ("Wide", 0.8)])
def test_loops_of_vectors_are_solved_and_equal_the_oracle_to_the_bit(model, d):
    """y = x + d M u of two plants. All scalars are fed back, at first more than are remembered."""
    components = {
        name: {"model": f"{direct.HERE}:{model}", "parameters": {"x": x, "v": v, "d": d},
               "inputs": {"u": f"{other}.y"}}
        for name, other, x, v in (("a", "b", 1.0, 0.5), ("b", "a", 0.2, -0.3))
    }  # fmt: skip
    one, two = (adaptive(components, stop=3.0) for _ in range(2))
    rows = record(one)
    assert rows.tobytes() == execute(two).tobytes()
    kind = getattr(direct, model)
    gain, offset = d * kind.matrix(), 0.1 * np.arange(kind.SIZE)
    t = (np.arange(one.ticks + 1) * one.h)[:, None]
    first, second = 1.0 + 0.5 * t + offset, 0.2 - 0.3 * t + offset
    expected = np.linalg.solve(np.eye(kind.SIZE) - gain @ gain, (first + second @ gain.T).T).T
    at = one.slots()["a.y"].start
    error = np.abs(rows[:, at : at + kind.SIZE] - expected)
    assert (error <= TOLERANCE * (0.01 + np.maximum.accumulate(np.abs(expected)))).all()


def test_a_nonlinear_loop_is_solved():
    """y_a = 1 + t - y_b³ and y_b = 0.5 - t/2 + y_a: passes over it alone would diverge."""
    t, y, _ = found(direct.pair(-1.0, 1.0, "Cubing"), stop=5.0)
    a, b = y.T
    assert (3.0 * b[1:] ** 2 > 1.0).all()  # the gain of the loop
    assert b == pytest.approx(0.5 - 0.5 * t + a, abs=1e-3)
    assert a == pytest.approx(1.0 + t - b**3, abs=1e-3)


def test_plants_that_move_by_what_the_loop_says_are_coupled_with_order_two():
    """x' = u - x, y = x + u and u = -y/2 of the other one, which is alike: y = 2x/3, x' = -4x/3."""
    components = {
        name: {"model": f"{direct.HERE}:Relaxing", "start": {"x": 1.0},
               "inputs": {"u": {"from": f"{other}.y", "gain": -0.5}}}
        for name, other in ("ab", "ba")
    }  # fmt: skip

    def error(h):
        t, y, _ = found(components, step=h, stop=2.0, settings={"smallest": h})
        return np.abs(y[:, 0] - 2.0 / 3.0 * np.exp(-4.0 / 3.0 * t)).max()

    assert error(0.05) < 1e-3
    assert np.log2(error(0.1) / error(0.05)) == pytest.approx(2.0, abs=0.2)


def test_what_is_no_loop_costs_what_it_did():
    """b takes the output of a at once, and moves what a takes: two short steps, not passes."""
    components = {
        "b": direct.plant(0.2, 0.0, (0.5, 0.0, 0.0), "Crossing", u0="a.y", u1="c.z"),
        "a": direct.plant(0.1, 0.0, (0.5, 0.0, 0.0), "Crossing", u0="c.z", u1="b.y"),
        "c": direct.plant(1.0, -0.1, u0="b.z"),
    }
    p = adaptive(components, settings={"smallest": 0.5})
    with Engine(p) as engine:
        engine.initialize()
        engine.run(p.ticks)
        (facts,) = engine.macro_steps()
    assert facts["loops"] == []
    steps = {step.name: step.component.steps for step in p.components}
    assert steps == {"a": 4 * p.ticks, "b": 4 * p.ticks, "c": 2 * p.ticks}
    one, two = (adaptive(components, stop=2.0) for _ in range(2))
    assert record(one).tobytes() == execute(two).tobytes()


def test_what_was_done_is_counted_and_said():
    t, _, (facts,) = found(direct.pair(0.5, 1.0))
    (loop,) = facts["loops"]
    assert loop["components"] == ["a", "b"]
    assert loop["solved"] == 2 * (len(t) - 1)
    assert 2.0 <= loop["passes"] / loop["solved"] <= 3.0  # one scalar is fed back
    assert any(what == "algebraic loop" and "a, b" in text for what, text in macro_lines([facts]))


def test_the_result_does_not_depend_on_threads():
    components = direct.pair(-0.9, 1.0) | {
        name: {**spec, "inputs": {"u0": f"{other}.y"}}
        for name, other, spec in zip("cd", "dc", direct.pair(0.5, 1.0).values(), strict=True)
    }
    links = [{"from": "a.z", "to": "c.u1", "delay": {"law": "constant", "delay": 2.0}}]
    one, two = (found(components, threads, links=links)[1] for threads in (1, 2))
    assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize("model", ["Squaring", "Overflowing"])
def test_a_loop_without_a_solution_is_named_with_the_way_out(model):
    """y = x + y² has none beyond x = 1/4, which is at 2.5 s."""
    components = {
        "a": direct.plant(-1.0, 0.5, model=model, u0="b.y"),
        "b": direct.plant(0.0, 0.0, (1.0, 0.0, 0.0), u0="a.y"),
    }
    message = (
        r"^a: outputs of a, b depend on each other at once, by b\.y -> a\.u0, a\.y -> b\.u0; "
        r"100 passes .* shorter steps do not help: .* at tick 5 \(t = 2\.5 s\)"
    )
    with pytest.raises(RunError, match=message):
        found(components)
