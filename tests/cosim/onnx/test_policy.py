"""Policies in ONNX files: what they compute, their ports, and what is refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import helper
from onnx.reference import ReferenceEvaluator

from cosim.base.errors import RunError, ScenarioError
from cosim.onnx import Policy
from tests.cli.command import Command
from tests.cosim.onnx.graphs import FLOAT, TEXT, counting, layers, saved

EXAMPLE = Path(__file__).parents[3] / "examples/policy/policy.toml"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A place for a graph."""
    return tmp_path / "graph.onnx"


def test_the_outputs_are_those_of_the_reference_evaluator_of_onnx(file: Path) -> None:
    model = layers(file)
    policy, rng = Policy(path=str(file)), np.random.default_rng(1)
    assert [(p.name, p.shape) for p in policy.inputs] == [("a_x", (3,)), ("b", (16,))]
    reference = ReferenceEvaluator(model)
    for _ in range(20):
        u = {"a_x": rng.normal(size=3), "b": rng.normal(size=16)}
        feed = {n: u[p][None].astype(np.float32) for n, p in (("a.x", "a_x"), ("b", "b"))}
        (expected,) = reference.run(None, feed)
        found = policy.step(0.0, 0.1, u)["y"]
        np.testing.assert_allclose(found, np.asarray(expected)[0], rtol=2e-5, atol=2e-6)


def test_recurrent_tensors_are_state_that_can_be_kept_and_put_back(file: Path) -> None:
    counting(file)
    policy = Policy(path=str(file), state={"h": "h_out"})
    u = {"u": np.array([1.0, 0.25])}
    policy.initialize({})
    assert policy.initial(u)["y"] == pytest.approx([2.0, 0.5])  # the state does not change
    for k in (1, 2, 3):
        assert policy.step(0.0, 0.1, u)["y"] == pytest.approx([2.0 * k, 0.5 * k])
    kept = policy.get_state()
    assert policy.step(0.0, 0.1, u)["y"] == pytest.approx([8.0, 2.0])
    policy.set_state(kept)
    assert policy.step(0.0, 0.1, u)["y"] == pytest.approx([8.0, 2.0])
    policy.initialize({})
    assert policy.step(0.0, 0.1, u)["y"] == pytest.approx([2.0, 0.5])
    assert [p.name for p in (*policy.inputs, *policy.outputs)] == ["u", "y"]


def test_free_dimensions_get_lengths_and_ports_get_names_and_units(file: Path) -> None:
    nodes = [helper.make_node("Identity", ["history"], ["0.out"])]
    dims = ["batch", "steps", 2]
    saved(file, nodes, [("history", FLOAT, dims)], [("0.out", FLOAT, dims)])
    with pytest.raises(ScenarioError, match=r"history.*free dimension 'steps'.*steps = 10"):
        Policy(path=str(file))
    policy = Policy(path=str(file), dims={"steps": 3}, units={"history": "rad"})
    assert [(p.name, p.shape, p.unit) for p in policy.inputs] == [("history", (3, 2), "rad")]
    assert policy.outputs[0].name == "_0_out"
    given = np.arange(6.0).reshape(3, 2)
    assert np.array_equal(policy.step(0.0, 0.1, {"history": given})["_0_out"], given)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ports": {"x": "a"}}, "no tensor 'x'"),
        ({"units": {"x": "rad"}}, "no port 'x'"),
        ({"state": {"x": "y"}}, "no input 'x'"),
        ({"state": {"b": "x"}}, "no output 'x'"),
        ({"state": {"b": "y"}}, r"found b \[1, 16\] and y \[1, 2\], expected one shape"),
        ({"ports": {"b": "a_x"}}, "two tensors with the port a_x"),
        ({"stat": {}}, "no key 'stat'; did you mean 'state'"),
    ],
)
def test_options_that_do_not_fit_are_named(file: Path, options: dict[str, Any], words: str) -> None:
    layers(file)
    with pytest.raises(ScenarioError, match=words):
        Policy(path=str(file), **options)


def test_files_that_cannot_run_are_refused(file: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file"):
        Policy(path=str(file))
    file.write_bytes(b"no graph")
    with pytest.raises(ScenarioError, match="found no graph of ONNX that can run"):
        Policy(path=str(file))
    nodes = [helper.make_node("Identity", ["words"], ["same"])]
    saved(file, nodes, [("words", TEXT, [1])], [("same", TEXT, [1])])
    with pytest.raises(ScenarioError, match=r"words.*found the type tensor\(string\), expected"):
        Policy(path=str(file))


def test_an_inference_that_fails_stops_the_run_with_its_reason(file: Path) -> None:
    nodes = [helper.make_node("Gather", ["table", "at"], ["y"])]
    saved(file, nodes, [("at", 7, [1])], [("y", FLOAT, [1])], table=[1.0, 2.0])
    policy = Policy(path=str(file))
    assert policy.step(0.0, 0.1, {"at": np.array(1.0)})["y"] == 2.0
    with pytest.raises(RunError, match=r"graph\.onnx: ONNX Runtime: .*indices"):
        policy.step(0.0, 0.1, {"at": np.array(5.0)})


def test_without_onnx_runtime_the_line_that_installs_it_is_said(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layers(file)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ScenarioError, match=r"pip install 'cosim-bridge\[onnx\]'"):
        Policy(path=str(file))


def test_the_example_runs_and_records_the_sum_of_its_file(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", EXAMPLE, "--no-plot", "--out", tmp_path / "run")
    assert done.code == 0, done.err
    facts = json.loads((tmp_path / "run/run.json").read_text())
    (name,) = [path for path in facts["files"] if path.endswith("policy.onnx")]
    assert len(facts["files"][name]) == 64
