"""The teleoperation on links of 0.3 to 1.2 s: what breaks it, and a law that nothing breaks."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cosim.base import toml
from cosim.base.processes import processes
from cosim.falsify.execute import Falsification, falsify
from cosim.falsify.scenario_text import text
from cosim.falsify.search import Budget

pytestmark = pytest.mark.slow
CONFIG = Path(__file__).parents[3] / "configs" / "teleoperation.toml"
WAVES = {
    "wave": ("impedance", "admittance", "wave(b=10)", {"master": "v", "slave": "u"}, ""),
    "wave-integral": (
        "integral_impedance", "integral_admittance", "wave integrals(b=10)",
        {"master": "UE", "slave": "UE"}, "_j",
    ),
}  # fmt: skip


def searched(document: dict[str, Any], folder: Path, runs: int) -> Falsification:
    document["run"]["stop"] = "30 s"
    (folder / "case.toml").write_text(text(document))
    budget = Budget(runs)
    return falsify(folder / "case.toml", (), folder / "out", partial(processes, 2), budget)


def test_the_readmes_hand_does_not_settle_in_time_on_a_few_segments(tmp_path: Path) -> None:
    """All constant delays settle by 13 s."""
    document = toml.read(CONFIG)
    document["require"] = {
        "settled": {"always": "abs(master.q - slave.q) < 0.05 rad", "after": "14 s"}
    }
    state = searched(document, tmp_path, 4000)
    assert state.found is not None and state.found.family != "constant"
    assert state.account.runs["constant"] == 400
    assert state.shrinking is not None and len(state.shrinking.now.pieces) <= 5


@pytest.mark.parametrize(("name", "breaks"), [("wave", True), ("wave-integral", False)])
def test_waves_drift_apart_and_their_integrals_do_not(
    name: str, breaks: bool, tmp_path: Path
) -> None:
    """Position is the integral of what arrives: lost and repeated waves stay in it."""
    master, slave, preset, sent, suffix = WAVES[name]
    document = toml.read(CONFIG)
    document["run"] = {"step": "5 ms", "seed": 0}
    parts = document["components"]
    for role, kind, inputs in (("master", master, ("dq",)), ("slave", slave, ("q", "dq"))):
        parts[role].setdefault("parameters", {})["substeps"] = 5
        parts[f"{role}_control"] = {
            "model": f"fmus.models.wave_{kind}", "preset": preset, "period": "5 ms",
            "inputs": {x: f"{role}.{x}" for x in inputs},
        }  # fmt: skip
    law, links = document["links"][0]["delay"], []
    for a, b in (("slave", "master"), ("master", "slave")):
        for x in sent[b]:
            ends = {"from": f"{a}_control.{x}", "to": f"{b}_control.{x}{suffix}"}
            links.append({**ends, "delay": law, "channel": f"{a} to {b}"})
    document["links"] = links
    document["metrics"] = {}
    document["require"] = {
        "offset": {"always": "abs(master.q - slave.q) <= 3.2 rad", "after": "29 s"}
    }
    state = searched(document, tmp_path, 4000 if breaks else 1200)
    assert (state.found is not None) == breaks
    if state.shrinking is not None:
        assert len(state.shrinking.now.pieces) <= 3 and state.shrinking.failing >= 20
