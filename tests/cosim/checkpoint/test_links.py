"""Every law of a link's delay and losses, every semantics, inputs over time, and graphs that
switch, resumed to the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.engine.simulate import simulate
from cosim.links import spec
from cosim.loading.files import load
from cosim.scenario.spec import build
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.checkpoint.cuts import built, same_after_cuts
from tests.tiers import first_fast

HOLD = {"hold": 0.03}
DELAYS: dict[str, list[dict[str, Any]]] = {
    "constant": [{"delay": 0.08}],
    "uniform": [{"low": 0.02, "high": 0.2, **HOLD}],
    "gamma": [{"shift": 0.02, "shape": 2, "scale": 0.01, "maximum": 0.2, **HOLD}],
    "lognormal": [{"shift": 0, "median": 0.02, "sigma": 0.5, "maximum": 0.3}],
    "markov": [
        {"levels": [0.05, 0.2], "step": 0.01, "transitions": [[0.5, 0.5], [1, 0]]},
        {"levels": [0.1, 0.2], "step": 0.01, "dwell": [0.2, 0.1]},
    ],
    "normal": [{"mean": 0.1, "sd": 0.03, "maximum": 0.2}],
    "hyperexponential": [
        {"shift": 0.01, "weights": [0.7, 0.3], "means": [0.01, 0.05], "maximum": 0.3}
    ],
    "sum": [
        {"of": [{"law": "constant", "delay": 0.02}, {"law": "uniform", "low": 0, "high": 0.1}]}
    ],
    "preset": [{"name": "lte-up"}],
    "frozen": [{"name": "lte-up"}],
    "segments": [
        {"delay": 0.03, "segments": [
            {"from": 0.5, "to": 1.2, "delay": 0.1}, {"from": 1.5, "to": 1.8, "lost": True},
        ]}
    ],
    "zenoh-can": [{"payload": 64, "bitrate": 500_000, "data_bitrate": 2_000_000}],
    "trace": [{"file": "trace.csv", "repeat": True}],
    "table": [{"file": "before/links/first.parquet"}],
}  # fmt: skip
LOSSES: dict[str, list[dict[str, Any]]] = {
    "independent": [{"p": 0.1}],
    "gilbert-elliott": [{"p": 0.05, "r": 0.3}],
    "outage": [
        {"length": 0.1, "every": 0.5},
        {"length": 0.1, "rate": 2.0},
        {"length": 0.05, "longest": 0.2, "pause": 0.3},
    ],
    "pareto-bursts": [{"stay": [0.9, 0.5], "shape": [1.5, 1.5], "scale": [0.1, 0.05]}],
}
RULES: list[dict[str, Any]] = [
    {"semantics": "last-arrival"},
    {"semantics": "newest-stamp"},
    {"semantics": "signal"},
    {"semantics": "fifo"},
    {"semantics": "playout", "playout": 0.2},
    {"semantics": "queue", "depth": 5},
    {"semantics": "queue", "depth": 50, "drop": "newest", "take": "all"},
]
UNIFORM = {"law": "uniform", "low": 0.02, "high": 0.2}


def document(**link: Any) -> dict[str, Any]:
    blocks = "tests.cosim.checkpoint.blocks"
    return {
        "run": {"step": 0.01, "stop": 4.0, "seed": 2},
        "components": {
            "noise": {"model": f"{blocks}:Noise"},
            "mean": {"model": f"{blocks}:Mean", "period": 0.02},
        },
        "links": [{"from": "noise.y", "to": "mean.u", **link}],
    }  # fmt: skip


def compared(folder: Path, **link: Any) -> None:
    (folder / "trace.csv").write_text(
        "t_send,delay\n" + "".join(f"{0.1 * k},{0.02 + 0.01 * (k % 7)}\n" for k in range(30))
    )
    before = document(delay=UNIFORM, semantics="last-arrival", name="first")
    simulate(build(before, folder / "s.toml"), folder / "before")
    same_after_cuts(folder, built(folder, document(**link)), cuts=2)


@pytest.mark.parametrize(
    ("law", "keys"), first_fast([(law, keys) for law in DELAYS for keys in DELAYS[law]], 2)
)
def test_laws_of_delays(tmp_path: Path, law: str, keys: dict[str, Any]) -> None:
    rule = {} if law == "table" else {"semantics": "last-arrival"}
    compared(tmp_path, delay={"law": law, **keys}, **rule)


@pytest.mark.parametrize(
    ("law", "keys"), first_fast([(law, keys) for law in LOSSES for keys in LOSSES[law]])
)
def test_losses(tmp_path: Path, law: str, keys: dict[str, Any]) -> None:
    compared(tmp_path, delay=UNIFORM, loss={"law": law, **keys}, semantics="newest-stamp")


@pytest.mark.parametrize("rule", first_fast(RULES))
def test_rules_of_receivers(tmp_path: Path, rule: dict[str, Any]) -> None:
    compared(tmp_path, delay={**UNIFORM, **HOLD}, **rule)


def test_these_are_all_laws() -> None:
    assert DELAYS.keys() == spec.LAWS.keys() and LOSSES.keys() == spec.LOSSES.keys()


@pytest.mark.parametrize(
    "switching",
    [
        ['topology.dwell="30 ms"'],
        ['topology={parts=3, graph="net", weights="control{i}.w[{k}]", dwell="20 ms"}'],
    ],
    ids=["graphs", "parts of one"],
)  # fmt: skip
def test_graphs_that_switch(tmp_path: Path, switching: list[str]) -> None:
    file = "many.toml" if "net" in switching[0] else "network.toml"
    settings = ["run.stop=1.5", "run.record.signals=all", *switching]
    same_after_cuts(tmp_path, lambda: load(CONFIGS / file, settings), cuts=2)


def test_events_and_tables_of_inputs(tmp_path: Path) -> None:
    (tmp_path / "push.csv").write_text("t,F\n0,0\n0.4,3\n0.4,1\n1.1,2\n2,0\n")
    planar = {"model": "fmus.models.planar2r", "fmi": "3.0"}
    found = {
        "run": {"step": 0.001, "stop": 2.0},
        "components": {
            "a": {**planar, "inputs": {
                "tau[0]": {"table": "push.csv", "column": "F", "interpolate": "linear"},
                "tau[1]": {"points": [[0, 0], ["1 s", "2 N.m"], [1.5, 0]]},
            }},
            "b": planar,
        },
        "events": [
            {"at": 0.3, "set": {"b.tau[0]": 1.0}, "over": 0.4, "for": 0.6},
            {"at": 0.5, "set": {"a.q_h[0]": 3.0}},
            {"at": 1.2, "set": {"a.q_h[0]": 1.0, "b.tau[1]": -1.0}},
        ],
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, found), cuts=4)
