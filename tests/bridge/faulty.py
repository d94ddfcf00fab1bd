"""A run with faults, made up: its script, its journals, its reports."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bridge.faults import build
from bridge.signs import Shown
from bridge.wiring import row_dtype
from tests.bridge.rehearsing import ROOT

SCENARIO = ROOT / "configs" / "teleoperation.toml"
BOTH = ("master>slave", "slave>master")
COUNTS = dict.fromkeys(("ok", "lost", "crc", "length", "invalid", "range"), 0)
COUNTS |= {"repeated": 0, "reordered": 0}


def script(*tables):
    return build({"fault": list(tables)}, Path("script.toml"))


def shown(system, folder, counts=None, end="finished", notes=()):
    """A run of 10 s in which the master heard every sample."""
    rows = {name: np.zeros(plan.slots, row_dtype(plan)) for name, plan in system.nodes.items()}
    for r in rows.values():
        r["slot"] = np.arange(len(r))
        r["inlets"]["newest"][:, 0] = r["slot"]
    said = {"end": end, "messages": {"xi_slave": {**COUNTS, **(counts or {})}}, "syncs": {}}
    reports = [
        SimpleNamespace(life=life, said=said if life == "master" else {"end": "finished"})
        for life in system.nodes
    ]
    return Shown(system, rows, reports, folder, list(notes))
