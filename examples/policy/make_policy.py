"""Writes policy.onnx: a network of two layers that moves the target of an arm towards a goal.

    python make_policy.py          # needs: pip install onnx

Its weights are set by hand, so the file can be read: target = q + 1.5 tanh(goal - q) - 0.1 dq.
A policy that was learned and exported by PyTorch is used in the same way.
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

GOAL = (0.8, -0.6)  # rad


def constant(name: str, values: object) -> object:
    """A tensor of weights."""
    return numpy_helper.from_array(np.asarray(values, np.float32), name)


def vector(name: str) -> object:
    """A tensor of one row and two columns, one a joint."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", 2])


graph = helper.make_graph(
    [
        helper.make_node("Sub", ["goal", "observation.q"], ["away"]),
        helper.make_node("Tanh", ["away"], ["bounded"]),
        helper.make_node("Mul", ["bounded", "reach"], ["step"]),
        helper.make_node("Mul", ["observation.dq", "damping"], ["slower"]),
        helper.make_node("Add", ["observation.q", "step"], ["moved"]),
        helper.make_node("Sub", ["moved", "slower"], ["action"]),
    ],
    "policy",
    [vector("observation.q"), vector("observation.dq")],
    [vector("action")],
    [constant("goal", [GOAL]), constant("reach", 1.5), constant("damping", 0.1)],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, Path(__file__).parent / "policy.onnx")
