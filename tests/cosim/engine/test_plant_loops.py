"""Algebraic loops among plants in a run: what iterates to the solution, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.component import Port
from cosim.base.errors import ScenarioError
from cosim.checks.plants import coupled
from cosim.engine.engine import Engine
from cosim.engine.plant_loops import possible_loops
from cosim.predict.system import system
from cosim.scenario.assemble import assemble
from tests.cosim.algorithms.networks import column, record
from tests.cosim.engine.test_algebraic_loops import Affine, ring
from tests.cosim.scenarios import plan, scenario

HERE = "tests.cosim.engine.test_plant_loops"
AFFINE = "tests.cosim.engine.test_algebraic_loops:Affine"
ALGORITHMS = ("sampled", "jacobi", "gauss-seidel")


class Circle(Affine):
    """y = sqrt(1.76 - u^2): with y = 1.8 - u of `Affine`, a solution that iteration leaves."""

    inputs = (Port("u", (), "1", "u", (1.0,)),)

    def value(self, u):
        if u * u > 1.76:
            raise ValueError(f"no root at u = {u}")
        return float(np.sqrt(1.76 - u * u))


class State:
    """Continuous: x' = u, and its outputs are x and what depends on u at once."""

    kind = "continuous"
    inputs = Affine.inputs
    outputs = Affine.outputs
    parameters = ()

    def initialize(self, values):
        self.x = 1.0

    def initial(self, u):
        return {"y": self.x, "z": 0.25 * float(u["u"])}

    def step(self, t, h, u):
        self.x += h * float(u["u"])
        return self.initial(u)

    get_state = Affine.get_state
    set_state = Affine.set_state


def circle(*gains, **more):
    """y = gain u + 1 of each of some components in a ring, with more of the component `a`."""
    found = ring(*(("Affine", {"gain": gain, "offset": 1.0}) for gain in gains))
    found["a"] |= more
    return found


def factors(p):
    with Engine(p) as engine:
        engine.initialize()
        return [loop.factor for loop in engine.loops]


def growth(p, exact):
    """How much the difference of `a.y` from its solution changes in one step, late in a run."""
    away = np.abs(column(p, record(p), "a.y") - exact)
    return (away[24:32].max() / away[8:16].max()) ** (1 / 16)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_loop_that_iteration_leaves_is_refused_by_its_wires(algorithm):
    components = ring(("Affine", {"gain": -1.0, "offset": 1.8}), ("Circle", {}))
    components["b"]["model"] = f"{HERE}:Circle"
    with pytest.raises(
        ScenarioError, match=r"b\.y -> a\.u, a\.y -> b\.u.*1\.\d+ in each base step"
    ):
        factors(plan(components, algorithm=algorithm))


def test_with_macro_steps_the_same_loop_stays_solved():
    components = ring(("Affine", {"gain": -1.0, "offset": 1.8}), ("Circle", {}))
    components["b"]["model"] = f"{HERE}:Circle"
    p = plan(components, algorithm="adaptive", stop=2.0)
    y = column(p, record(p), "a.y")
    assert y == pytest.approx(np.full(len(y), 1.164575), abs=1e-5)


@pytest.mark.parametrize(
    ("algorithm", "gains", "expected"),
    [
        ("sampled", (0.5, -0.5), 0.5),  # two steps once around: sqrt(0.25)
        ("jacobi", (-0.9, 0.9, 0.9), 0.9),
        ("gauss-seidel", (0.5, -0.5), 0.25),  # once around in one step
    ],
)
def test_the_factor_is_that_of_the_iteration(algorithm, gains, expected):
    assert factors(plan(circle(*gains), algorithm=algorithm)) == pytest.approx([expected], abs=1e-6)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("gains", [(0.6, 0.7), (-0.6, 0.7)])
@pytest.mark.parametrize(
    "more", [{}, {"period": 0.5}, {"extrapolate": "linear"}], ids=["each", "slow", "line"]
)
def test_a_difference_shrinks_in_a_run_as_it_is_said(algorithm, gains, more):
    """The loop is pushed away by a component that is not what it was at the start."""
    components = circle(*gains, **more)
    components["b"]["model"] = f"{HERE}:Pushed"
    p = plan(components, algorithm=algorithm, stop=10.0)
    (factor,) = factors(plan(components, algorithm=algorithm, stop=10.0))
    a, b = gains
    exact = (a * (b * 0 + 2.0) + 1.0) / (1 - a * b)
    assert growth(p, exact) == pytest.approx(factor, rel=0.06)


class Pushed(Affine):
    """y = gain u + 1 at the start, and 2 in place of 1 from then on."""

    def step(self, t, h, u):
        return {"y": self.gain * float(u["u"]) + 2.0, "z": self.offset}


def test_a_state_in_the_circle_is_no_loop():
    components = {
        "a": {"model": f"{HERE}:State", "inputs": {"u": "b.y"}},
        "b": {"model": AFFINE, "parameters": {"gain": -5.0}, "inputs": {"u": "a.y"}},
    }
    p = plan(components)
    assert possible_loops(p) == {"a", "b"}
    assert factors(p) == []


def said(components, **run):
    built = scenario(components, **run)
    return [*coupled(system(built, assemble(built)))]


def test_check_names_loop_and_factor_or_what_a_run_will_refuse():
    (mild,) = said(circle(0.5, -0.5))
    assert (mild.severity, mild.where) == ("warning", "a, b")
    assert mild.number == pytest.approx(0.5)
    assert "below 1 % after 7" in mild.reason
    (wild,) = said(circle(2.0, -2.0))
    assert wild.severity == "error"
    assert "a.y -> b.u" in wild.reason
    assert said(circle(2.0, -2.0), algorithm="adaptive") == []


@pytest.mark.parametrize(("output", "order"), [("y", 2), ("z", 1)])
def test_a_line_has_order_two_but_not_through_an_output_that_follows_its_input(output, order):
    """x' = -4 z with z = u/4 of another state, and check says which outputs take the order away."""
    components = {
        "a": {"model": f"{HERE}:State", "extrapolate": "linear", "inputs": {"u": "c.y"}},
        "b": {"model": f"{HERE}:State", "extrapolate": "linear",
              "inputs": {"u": {"from": f"a.{output}", "gain": 1.0 if output == "y" else 4.0}}},
        "c": {"model": f"{HERE}:State", "extrapolate": "linear",
              "inputs": {"u": {"from": "b.y", "gain": -1.0}}},
    }  # fmt: skip

    def error(step):
        p = plan(components, step=step, stop=2.0)
        return column(p, record(p), "b.y")[-1]

    best = error(1 / 2048)
    ratio = abs(error(1 / 32) - best) / abs(error(1 / 64) - best)
    assert np.log2(ratio) == pytest.approx(order, abs=0.3)
    late = [f.where for f in said(components, step=1 / 32) if f.rule == "late-output"]
    assert late == ([] if output == "y" else ["a.z"])
