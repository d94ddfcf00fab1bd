"""Documents that trip one rule each, and documents that do not."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from cosim.checks import Finding
from cosim.checks.preflight import check
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from fmus.paper.experiments import STARTS, arm
from tests.fmus.bilateral import PAIRS, controls, links

Document = dict[str, Any]

CONSTANT: Document = {"law": "constant", "delay": 0.5}
VARYING: Document = {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}


def found(document: Mapping[str, Any], *, notes: bool = True) -> tuple[Finding, ...]:
    """The findings of a document; each is assembled once."""
    return _found(json.dumps(document, sort_keys=True), notes)


@cache
def _found(text: str, notes: bool) -> tuple[Finding, ...]:
    scenario = build(json.loads(text), Path("test.toml"))
    return check(scenario, assemble(scenario), notes=notes)


def tripped(document: Mapping[str, Any], rule: str) -> list[Finding]:
    """Findings of one rule."""
    return [f for f in found(document) if f.rule == rule]


def changed(document: Document, *changes: tuple[str, Any]) -> Document:
    """A copy with values set at dotted places; None takes them away."""
    copied: Document = copy.deepcopy(document)
    for place, value in changes:
        *parents, last = place.split(".")
        node: Any = copied
        for part in parents:
            node = node[int(part)] if isinstance(node, list) else node.setdefault(part, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return copied


def rivals(pair: str, delay: Document, **options: Any) -> Document:
    """Two arms under a pair of rival controllers; `options` of the links."""
    arms = ("master", "slave")
    components = {
        name: arm(f"{name}_control.tau", q) for name, q in zip(arms, STARTS, strict=False)
    }
    exchanged = links(PAIRS[pair], arms, delay, **options)
    return {
        "run": {"step": 0.005, "stop": 10.0},
        "components": components | controls(PAIRS[pair], arms),
        "links": exchanged,
    }


def push_by_component(period: float, **values: float) -> Document:
    """One arm held by an operator that is a component of its own."""
    return {
        "run": {"step": 0.001, "stop": 10.0},
        "components": {
            "robot": arm("control.tau", period=0.001)
            | {"inputs": {"tau": "control.tau", "tau_ext": "operator.tau_h"}},
            "control": {
                "model": "fmus.models.adaptive",
                "period": 0.005,
                "parameters": {"K": 16.0, "alpha": 2.0, "lambda_M": 6.0},
                "inputs": {"q": "robot.q", "dq": "robot.dq"},
            },
            "operator": {
                "model": "fmus.models.operator",
                "period": period,
                "parameters": values,
                "inputs": {"q": "robot.q", "dq": "robot.dq"},
            },
        },
    }


def heavy_arm(theta_g: tuple[float, float], **control: Any) -> Document:
    """One arm in a vertical plane under the controller with gravity."""
    values = {"theta_g": list(theta_g), "Gamma": 1.0, **control}
    return {
        "run": {"step": 0.005, "stop": 10.0},
        "components": {
            "robot": {
                "model": "fmus.models.planar2r",
                "preset": "SL91-upright",
                "parameters": {"k_p": 10.0, "k_d": 5.0, "q_h": [3.5, 3.0]},
                "inputs": {"tau": "control.tau"},
            },
            "control": {
                "model": "fmus.models.adaptive",
                "sizes": {"gravity": 1},
                "parameters": values,
                "inputs": {"q": "robot.q", "dq": "robot.dq"},
            },
        },
    }
