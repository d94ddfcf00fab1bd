"""Algebraic loops among plants at the start: solved where iteration diverges, and named if not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cosim.base.component import Parameter, Port
from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.schedule.order import strongly_connected
from tests.cosim.scenarios import plan

HERE = "tests.cosim.engine.test_algebraic_loops"


class Affine:
    """Continuous: y = gain u + offset, at once; z is its offset alone."""

    kind = "continuous"
    inputs = (Port("u"),)
    outputs = (Port("y"), Port("z"))
    parameters = (Parameter("gain", (1.0,)), Parameter("offset", (0.0,)))

    def initialize(self, values):
        self.gain = float(values.get("gain", 1.0))
        self.offset = float(values.get("offset", 0.0))
        self.calls = 0

    def initial(self, u):
        self.calls += 1
        return {"y": self.value(float(u["u"])), "z": self.offset}

    def value(self, u):
        return self.gain * u + self.offset

    def step(self, t, h, u):
        return self.initial(u)

    def get_state(self):
        return None

    def set_state(self, state):
        del state


class Cubic(Affine):
    """y = gain u^3 + offset."""

    def value(self, u):
        return self.gain * u**3 + self.offset


class Square(Affine):
    """y = u^2 + offset."""

    def value(self, u):
        return u * u + self.offset


class SquareFromBelow(Square):
    """Begins to the left of both solutions."""

    inputs = (Port("u", default=(-3.0,)),)


class SquareFromAbove(Square):
    """Begins to the right of them."""

    inputs = (Port("u", default=(5.0,)),)


class Narrow(Affine):
    """Refuses inputs beyond 10, as an FMU with limits does."""

    def value(self, u):
        if abs(u) > 10.0:
            raise ScenarioError("u is beyond 10")
        return super().value(u)


class Pair(Affine):
    """Two channels: y = matrix u + offset."""

    inputs = (Port("u", (2,)),)
    outputs = (Port("y", (2,)), Port("z"))

    def value(self, u):
        raise NotImplementedError

    def initial(self, u):
        return {"y": self.gain * np.array([[0.0, 1.0], [-1.0, 2.0]]) @ u["u"] + self.offset,
                "z": self.offset}  # fmt: skip


def ring(*specs, start=None, **more):
    """Components a, b, ... of which each feeds the next one, and the last the first."""
    names = "abcdef"[: len(specs)]
    return {
        name: {
            "model": f"{HERE}:{model}", "parameters": parameters,
            "inputs": {"u": f"{names[i - 1]}.y"},
        }
        for i, (name, (model, parameters)) in enumerate(zip(names, specs, strict=True))
    } | more  # fmt: skip


def started(components, links=(), **run):
    """The signals by name of components at the start, which a run with macro steps goes on from."""
    p = plan(components, links, **{"algorithm": "adaptive", **run})
    with Engine(p) as engine:
        engine.initialize()
        return {name: engine.signals[s.start : s.start + s.size].tolist()
                for name, s in p.slots().items()}  # fmt: skip


@pytest.mark.parametrize("gain", [-3.0, 5.0, 1e3, -0.99, 0.99999])
def test_a_linear_loop_is_solved_whether_iteration_converges_or_not(gain):
    found = started(ring(("Affine", {"gain": gain, "offset": 1.0}), ("Affine", {"offset": 2.0})))
    expected = (gain * 2.0 + 1.0) / (1.0 - gain)
    assert found["a.y"] == pytest.approx([expected], rel=1e-9)
    assert found["b.y"] == pytest.approx([expected + 2.0], rel=1e-9)
    assert found["a.u"] == pytest.approx(found["b.y"], rel=1e-9)


def test_a_loop_that_iteration_solves_exactly_is_not_touched():
    found = started(ring(("Affine", {"gain": 0.0, "offset": 1.0}), ("Affine", {"offset": 2.0})))
    assert found["a.y"] == [1.0]
    assert found["b.y"] == [3.0]


def test_a_nonlinear_loop_is_solved_from_its_start_values():
    # u = -2 u^3 + 30, which has one real solution; iteration diverges
    components = ring(("Cubic", {"gain": -2.0, "offset": 30.0}), ("Affine", {}))
    (u,) = started(components)["a.u"]
    assert u == pytest.approx(-2.0 * u**3 + 30.0, abs=1e-9)


def test_the_default_of_an_input_selects_the_solution():
    # u = u^2 - 2: the solutions are -1 and 2
    for model, expected in (("SquareFromBelow", -1.0), ("SquareFromAbove", 2.0)):
        found = started(ring((model, {"offset": -2.0}), ("Affine", {})))
        assert found["a.u"] == pytest.approx([expected])


def test_inputs_beyond_the_limits_of_a_component_are_not_taken_on_the_way():
    components = ring(("Narrow", {"gain": -9.0, "offset": 8.0}), ("Narrow", {}))
    assert started(components)["a.y"] == pytest.approx([0.8])


def test_arrays_and_several_loops_one_after_the_other():
    components = ring(("Pair", {"gain": 3.0, "offset": 1.0}), ("Pair", {}))
    components |= {
        "c": {"model": f"{HERE}:Affine", "parameters": {"gain": 4.0}, "inputs": {"u": "d.y"}},
        "d": {"model": f"{HERE}:Sum", "inputs": {"u": "c.y", "v": "a.y[1]"}},
    }
    found = started(components)
    m = np.array([[0.0, 1.0], [-1.0, 2.0]])
    b = np.linalg.solve(np.eye(2) - 3.0 * m @ m, m @ np.ones(2))
    assert found["b.y"] == pytest.approx(b)
    assert found["a.y"] == pytest.approx(3.0 * m @ b + 1.0)
    d = found["a.y"][1] / (1.0 - 4.0)
    assert found["d.y"] == pytest.approx([d])
    assert found["c.y"] == pytest.approx([4.0 * d])


class Sum(Affine):
    """y = u + v."""

    inputs = (Port("u"), Port("v"))

    def initial(self, u):
        return {"y": float(u["u"] + u["v"]), "z": 0.0}


def test_what_follows_a_loop_sees_its_solution():
    components = ring(("Affine", {"gain": 5.0, "offset": 1.0}), ("Affine", {}))
    components["c"] = {"model": f"{HERE}:Affine", "parameters": {"gain": 2.0},
                       "inputs": {"u": "b.y"}}  # fmt: skip
    components["before"] = {"model": f"{HERE}:Affine", "inputs": {"u": "a.z"}}
    found = started(components)
    assert found["b.y"] == pytest.approx([-0.25])
    assert found["c.y"] == pytest.approx([-0.5])
    assert found["before.y"] == [1.0]


def test_a_link_without_a_value_before_the_start_is_part_of_a_loop():
    components = ring(("Affine", {"gain": 5.0, "offset": 1.0}), ("Affine", {}))
    del components["a"]["inputs"]
    link = {"from": "b.y", "to": "a.u"}
    assert started(components, [link])["a.y"] == pytest.approx([-0.25])
    assert started(components, [{**link, "initial": 2.0}])["a.y"] == [11.0]


@pytest.mark.parametrize(
    ("specs", "wires"),
    [
        ([("Affine", {"offset": 1.0}), ("Affine", {})], "b.y -> a.u"),  # u = u + 1
        ([("Square", {"offset": 1.0}), ("Affine", {})], "a.y -> b.u"),  # u = u^2 + 1
    ],
)
def test_a_loop_without_a_solution_is_named(specs, wires):
    with pytest.raises(ScenarioError, match=r"the algebraic loop .* has no solution") as caught:
        started(ring(*specs))
    assert wires in str(caught.value)
    assert "differs by" in str(caught.value)


def test_an_error_without_a_loop_is_the_one_of_the_component():
    components = {"a": {"model": f"{HERE}:Narrow", "start": {"u": 11.0}}}
    with pytest.raises(ScenarioError, match="a does not start: u is beyond 10"):
        started(components)


@given(st.lists(st.floats(-4.0, 4.0), min_size=2, max_size=5), st.floats(-2.0, 2.0))
def test_rings_of_any_gains_have_their_solution(gains, offset):
    product = float(np.prod(gains))
    assume(abs(1.0 - product) > 1e-3)
    specs = [("Affine", {"gain": round(g, 6), "offset": round(offset, 6)}) for g in gains]
    gains, offset = [s["gain"] for _, s in specs], specs[0][1]["offset"]
    found = started(ring(*specs))
    n = len(gains)
    matrix = np.eye(n) - np.diag(gains) @ np.roll(np.eye(n), 1, axis=0)
    expected = np.linalg.solve(matrix, np.full(n, offset))
    assert [found[f"{c}.y"][0] for c in "abcde"[:n]] == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(st.integers(1, 8), st.data())
def test_strongly_connected_sets_are_those_of_mutual_reach_in_order(n, data):
    names = [f"n{i}" for i in range(n)]
    edges = data.draw(st.lists(st.tuples(*(st.sampled_from(names),) * 2), max_size=20))
    found = strongly_connected(names, edges)
    reach = {a: {a} for a in names}
    for _ in names:
        for a, b in edges:
            for sources in reach.values():
                if a in sources:
                    sources.add(b)
    assert sorted(name for block in found for name in block) == sorted(names)
    place = {name: i for i, block in enumerate(found) for name in block}
    for a in names:
        for b in reach[a]:
            assert place[a] <= place[b]
            assert (place[a] == place[b]) == (a in reach[b])
