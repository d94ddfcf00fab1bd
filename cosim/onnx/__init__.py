"""A policy in an ONNX file as a sampled Component; ONNX Runtime is loaded when a policy is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.onnx.policy import OnnxPolicy

__all__ = ["Policy"]


def Policy(**options: Any) -> OnnxPolicy:
    """The component of ``model = "cosim.onnx:Policy"``; `options`: :class:`.policy.PolicyOptions`.

    Raises ScenarioError for options that do not fit the file, and without ONNX Runtime.
    """
    from cosim.onnx.policy import OnnxPolicy, PolicyOptions

    return OnnxPolicy(PolicyOptions.read(options))
