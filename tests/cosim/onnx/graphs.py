"""Graphs of ONNX that tests write, by ONNX's own helpers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from onnx import ModelProto, TensorProto, checker, helper, numpy_helper, save

FLOAT, DOUBLE, TEXT = TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.STRING
Info = tuple[str, int, Sequence[int | str]]


def saved(
    path: Path,
    nodes: Sequence[object],
    inputs: Sequence[Info],
    outputs: Sequence[Info],
    **weights: object,
) -> ModelProto:
    """A graph, checked by ONNX and written to `path`; `weights`: float32."""
    graph = helper.make_graph(
        list(nodes), "graph", [helper.make_tensor_value_info(*x) for x in inputs],
        [helper.make_tensor_value_info(*x) for x in outputs],
        [numpy_helper.from_array(np.asarray(v, np.float32), k) for k, v in weights.items()],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(model)
    save(model, path)
    return model


def layers(path: Path) -> ModelProto:
    """Two inputs of one row, two layers: y = W2 tanh(W1 a - b), W of fixed random numbers."""
    rng = np.random.default_rng(5)
    nodes = [
        helper.make_node("Gemm", ["a.x", "w1"], ["wide"]),
        helper.make_node("Sub", ["wide", "b"], ["moved"]),
        helper.make_node("Tanh", ["moved"], ["bounded"]),
        helper.make_node("Gemm", ["bounded", "w2"], ["y"]),
    ]
    weights = {"w1": rng.normal(size=(3, 16)), "w2": rng.normal(size=(16, 2))}
    inputs = [("a.x", FLOAT, ["batch", 3]), ("b", FLOAT, ["batch", 16])]
    return saved(path, nodes, inputs, [("y", FLOAT, ["batch", 2])], **weights)


def counting(path: Path) -> ModelProto:
    """A recurrent graph: h_out = h + u, y = 2 h_out."""
    nodes = [
        helper.make_node("Add", ["h", "u"], ["h_out"]),
        helper.make_node("Add", ["h_out", "h_out"], ["y"]),
    ]
    shape = [1, 2]
    return saved(
        path, nodes, [("u", DOUBLE, shape), ("h", DOUBLE, shape)],
        [("y", DOUBLE, shape), ("h_out", DOUBLE, shape)],
    )  # fmt: skip
