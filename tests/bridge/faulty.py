"""A run with faults, made up: its script, its journals, its reports."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bridge.faults.load import build
from bridge.records.node_lives import ByLife, Life
from bridge.records.records import LifeEnd, Statement
from bridge.results.report import NodeReport
from bridge.results.symptoms import FinishedRun
from bridge.wiring.wiring import row_dtype
from tests.bridge.rehearsing import ROOT

SCENARIO = ROOT / "configs" / "teleoperation.toml"
BOTH = ("master>slave", "slave>master")
SLOTS = SimpleNamespace(late=SimpleNamespace(p99=0.0), missed=0)
COUNTS = dict.fromkeys(("ok", "lost", "crc", "length", "invalid", "range"), 0)
COUNTS |= {"repeated": 0, "reordered": 0}


def report(life, end="finished", reasons=(), **said):
    """The report of a life at its end; `end` killed: none."""
    statement = Statement(life=life, end=LifeEnd(end), **said) if end != "killed" else None
    return NodeReport(life, 0, SLOTS, "", reasons, statement)


def script(*tables):
    return build({"fault": list(tables)}, Path("script.toml"))


def shown(system, folder, counts=None, end="finished", notes=()):
    """A run of 10 s in which the master heard every sample."""
    rows = ByLife(
        {Life(name): np.zeros(plan.slots, row_dtype(plan)) for name, plan in system.nodes.items()}
    )
    for r in rows.values():
        r["slot"] = np.arange(len(r))
        r["inlets"]["newest"][:, 0] = r["slot"]
    heard = {"xi_slave": {**COUNTS, **(counts or {})}}
    reports = [report(life, messages=heard if life.node == "master" else {}) for life in rows]
    if end != "finished":
        reports[0] = report(reports[0].life, end, messages=heard)
    return FinishedRun(system, rows, reports, folder, list(notes))
