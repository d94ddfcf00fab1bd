"""FMUs with events, clocks, texts and solvers, macro steps, and plants of MuJoCo and ONNX, resumed
to the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.cosim.algorithms import direct
from tests.cosim.checkpoint.cuts import built, same_after_cuts
from tests.cosim.fmi.exporter import (
    VARIABLE,
    clocked3,
    events3,
    exchange2,
    exchange3,
    export,
    timed3,
)
from tests.cosim.fmi.test_exchange import BALL
from tests.cosim.fmi.test_scheduled import scheduled3
from tests.cosim.fmi.test_texts import mail3
from tests.cosim.fmi.test_within import WITHIN, within3
from tests.tiers import first_fast

SAVES = 'canGetAndSetFMUState="true" canSerializeFMUState="true"'
NOISE = {"model": "tests.cosim.checkpoint.blocks:Noise"}
#: Every kind of time that an FMU has beside its steps.
TIMED = {
    "events": (events3(), {}),
    "early return": (events3(), {"parameters": {"half": 1.0}}),
    "periodic clocks": (clocked3(), {"inputs": {"u_fast": "noise.y[0]", "u_slow": "noise.y[1]"}}),
    "changing clocks": (timed3(), {"inputs": {"u_pulse": "noise.y[0]"}}),
    "countdown": (timed3(VARIABLE, clock='supportsFraction="true"'),
                  {"parameters": {"wait": 0.013}, "inputs": {"start": "steps.y"}}),
    "call back within a step": (within3(WITHIN).replace(' unit="m"', ""),
                                {"inputs": {"u": "noise.y"}}),
    "scheduled execution": (scheduled3(), {"kind": "scheduled execution", "inputs": {
        "u_fast": "noise.y[0]", "u": "noise.y[1]", "go": "steps.y"}}),
}  # fmt: skip
STEPS = {"model": "tests.cosim.checkpoint.blocks:Steps"}


def saving(description: str) -> str:
    """The description of an FMU that saves its state."""
    return description.replace('modelIdentifier="', f'{SAVES} modelIdentifier="')


@pytest.mark.parametrize("kind", ["", "sampled"])
@pytest.mark.parametrize("name", TIMED)
def test_events_and_clocks(tmp_path: Path, name: str, kind: str) -> None:
    text, keys = TIMED[name]
    if kind and "kind" in keys:
        pytest.skip("its clocks say when it is activated")
    path = export(saving(text), tmp_path / "x.fmu")
    x = {"model": str(path), **keys, **({"kind": kind} if kind else {})}
    document = {
        "run": {"step": 0.01, "stop": 4.0, "record": {"signals": "all", "events": True}},
        "components": {"noise": NOISE, "steps": STEPS, "x": x},
    }
    same_after_cuts(tmp_path, built(tmp_path, document), cuts=2)


def test_texts_that_travel(tmp_path: Path) -> None:
    """Numbers of texts are those of the whole run; clocked texts are as at their last ticks."""
    mail = {"model": str(export(saving(mail3()), tmp_path / "mail.fmu")), "kind": "sampled"}
    document = {
        "run": {"step": 0.01, "stop": 3.0},
        "components": {
            "a": mail,
            "b": {**mail, "inputs": {"go": "a.sent", "letter": "a.message"}},
            "z": {**mail, "inputs": {"note": "b.heard"}},
        },
        "links": [{"from": "b.said", "to": "a.word", "semantics": "last-arrival",
                   "delay": {"law": "uniform", "low": 0.02, "high": 0.2}}],
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("solver", ["rk4", "heun"])
def test_model_exchange_with_events(tmp_path: Path, fmi: str, solver: str) -> None:
    """A ball that bounces, integrated here."""
    flags = SAVES if fmi == "3.0" else SAVES.replace("State", "state")
    text = (exchange2 if fmi == "2.0" else exchange3)(flags)
    path = export(text, tmp_path / "ball.fmu")
    document = {
        "run": {"step": 0.003, "stop": 3.0, "record": {"events": True}},
        "components": {"x": {"model": str(path), "parameters": {"model": BALL},
                             "solver": solver, "log": True}},
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


MASS = "tests.cosim.algorithms.masses"
GROUPS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "springs": ({"tolerance": 1e-4, "bonds": [{"effort": "a.force", "flow": "b.v1"}]}, {
        "a": {"model": f"{MASS}:Mass", "start": {"x0": 1.0}, "inputs": {"force": "b.force"}},
        "b": {"model": f"{MASS}:MassWithSpring", "inputs": {"x1": "a.x", "v1": "a.v"}},
    }),
    "loop": ({"tolerance": 1e-4, "iterations": 3}, direct.pair(0.9, 1.0)),
    "implicit": ({"tolerance": 1e-6, "iterations": 20}, {
        "a": {"model": f"{MASS}:Mass", "start": {"x0": 1.0}, "inputs": {"force": "b.force"}},
        "b": {"model": f"{MASS}:MassWithSpring", "inputs": {"x1": "a.x", "v1": "a.v"}},
    }),
}  # fmt: skip


@pytest.mark.parametrize("name", GROUPS)
def test_groups_with_macro_steps(tmp_path: Path, name: str) -> None:
    settings, components = GROUPS[name]
    document = {
        "run": {"step": 0.05, "stop": 20.0, "algorithm": "adaptive", "adaptive": settings},
        "components": components,
    }
    same_after_cuts(tmp_path, built(tmp_path, document))


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_group_of_fmus(tmp_path: Path, fmi: str) -> None:
    """Two arms that pull each other; the engine saves and restores them in each macro step."""
    arm = {"model": "fmus.models.planar2r", "fmi": fmi, "parameters": {"k_p": 40.0, "k_d": 1.0}}
    document = {
        "run": {"step": 0.02, "stop": 6.0, "algorithm": "adaptive",
                "adaptive": {"tolerance": 1e-4}},
        "components": {
            "a": {**arm, "inputs": {"q_h": "b.q"}},
            "b": {**arm, "inputs": {"q_h": "a.q"}, "start": {"q": [1.0, -0.5]}},
        },
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


def test_a_scene_of_mujoco_with_activations(tmp_path: Path) -> None:
    """Contacts, a free body, an actuator with a state of its own, and every kind of sensor."""
    from tests.cosim.mujoco.scenes import MANY

    (tmp_path / "scene.xml").write_text(MANY)
    document = {
        "run": {"step": 0.01, "stop": 4.0, "record": {"signals": "all"}},
        "components": {"noise": NOISE, "x": {"model": "mujoco:scene.xml"}},
    }
    same_after_cuts(tmp_path, built(tmp_path, document), cuts=2)


def test_a_policy_with_recurrent_tensors(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    from tests.cosim.onnx.graphs import counting

    counting(tmp_path / "policy.onnx")
    document = {
        "run": {"step": 0.01, "stop": 4.0},
        "components": {
            "noise": NOISE,
            "x": {"model": "cosim.onnx:Policy", "period": 0.05, "compute": 0.02,
                  "options": {"path": "policy.onnx", "state": {"h": "h_out"}},
                  "inputs": {"u": "noise.y"}},
        },
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


@pytest.mark.parametrize("name", first_fast(TIMED, 2))
def test_isolated_fmus(tmp_path: Path, name: str) -> None:
    """In a process of its own, whose clocks are part of the state."""
    text, keys = TIMED[name]
    path = export(saving(text), tmp_path / "x.fmu")
    document = {
        "run": {"step": 0.01, "stop": 4.0, "record": {"signals": "all"}},
        "components": {
            "noise": NOISE, "steps": STEPS, "x": {"model": str(path), "isolate": True, **keys}
        },
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document), cuts=2)


def test_an_isolated_fmu_with_a_solver(tmp_path: Path) -> None:
    path = export(exchange3(SAVES), tmp_path / "ball.fmu")
    document = {
        "run": {"step": 0.003, "stop": 3.0},
        "components": {"x": {"model": str(path), "parameters": {"model": BALL}, "log": True,
                             "isolate": True}},
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document), cuts=2)


@pytest.mark.slow
@pytest.mark.parametrize("isolate", ["wasm", True])
def test_fmus_in_webassembly(tmp_path: Path, isolate: bool | str) -> None:
    """Our arm in its sandbox, and an FMU with events that has only WebAssembly."""
    pytest.importorskip("wasmtime")
    from fmus.models import planar2r
    from tests.cosim.sandbox.test_same_bits import both, with_wasm

    arm = with_wasm(planar2r.model(), tmp_path)
    _, events = both(saving(events3()), tmp_path)
    document = {
        "run": {"step": 0.005, "stop": 2.0},
        "components": {
            "arm": {"model": str(arm), "isolate": "wasm", "start": {"q": [1.0, -0.5]}},
            "x": {"model": str(events), "isolate": isolate},
        },
    }
    same_after_cuts(tmp_path, built(tmp_path, document), cuts=2)
