"""Faults of drives: no torque to a drive that is off, a stop in time, an exact replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bridge.faults.load import build
from bridge.native.safety import LifeState, Why
from bridge.native.vendor import VendorFault
from bridge.node.fault_injection import inject
from bridge.replay import replay, twin
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import named

AT = 0.2
TABLE = {"kind": "drive", "bus": "left", "drive": 1, "at": AT}
OFF = {
    "can-damiao": [
        *({"does": "trip", "code": code} for code in (0x5, 0x8, 0x9, 0xA, 0xB, 0xC, 0xD, 0xE)),
        {"does": "reboot"}, {"does": "unplug"}, {"does": "hot", "code": 2},
    ],
    "can-cia402": [
        *({"does": "trip", "code": code} for code in (0x2310, 0x3210, 0x4310, 0x7305)),
        {"does": "reboot"}, {"does": "unplug"}, {"does": "hot"},
    ],
}  # fmt: skip
CASES = [(deployment, table) for deployment, tables in OFF.items() for table in tables]


def script(*tables):
    return build({"fault": [TABLE | table for table in tables]}, Path("faults.toml"))


def run(deployment, tables, folder, *settings):
    """Rows of all nodes of a twin with faults of drives, and what its replay finds."""
    drive = {"can-cia402": 11}.get(deployment, 1)
    system = named(deployment, "run.stop=0.6", *settings)
    given = script(*({"drive": drive} | table for table in tables))
    with twin.wired_nodes(system, folder) as nodes:
        for name, node in nodes.items():
            inject(node, given, folder / f"{name}.faults")
        twin.run(system, nodes)
    rows = replay.load(folder)
    (folder / "again").mkdir()
    found = replay.replay(system, rows, replay.received_by_life(folder), folder / "again")
    return {life.node: part for life, part in rows.items()}, found


@pytest.mark.parametrize(("deployment", "table"), CASES, ids=str)
def test_a_drive_that_is_lost_stops_its_node_in_time_without_torque(deployment, table, tmp_path):
    rows, found = run(deployment, [table], tmp_path)
    acts = rows["master"]["inlets"]["requests"][:, 0] & 1
    lost = int(np.flatnonzero(acts == 0)[0])
    assert AT * 1000 <= lost <= AT * 1000 + 60  # an unplugged one by its watchdog
    assert not acts[lost:].any()
    control = rows["master_control"]
    told = int(np.flatnonzero(control["reasons"] & Why.DRIVE)[0])
    assert control["slot"][told] * 5 <= AT * 1000 + 130
    assert control["state"][-1] == LifeState.FAULT
    assert not (control["serving"][told + 1 :] & 1).any()
    assert (found.greatest, found.first) == (0.0, None)


def test_a_drive_that_answers_for_another_is_named(tmp_path):
    rows, found = run("can-damiao", [{"does": "other-id", "code": 1}], tmp_path)
    assert rows["master_control"]["reasons"][-1] & Why.DRIVE
    assert (found.greatest, found.first) == (0.0, None)


def test_a_drive_that_answers_late_for_a_while_goes_on(tmp_path):
    rows, found = run("can-damiao", [{"does": "late", "by": "8 ms", "for": "0.1 s"}], tmp_path)
    assert rows["master_control"]["state"][-1] == LifeState.ACTIVE
    assert (found.greatest, found.first) == (0.0, None)


def test_a_fault_is_that_of_its_drive_and_ends_when_it_says():
    found = script(
        {"does": "unplug", "for": "10 ms"}, {"drive": [1, 2], "does": "trip", "code": 10}
    )
    assert [(f.t, f.drive, f.fault, f.code) for f in found.drives] == [
        (AT, 1, VendorFault.UNPLUG, 1), (AT, 1, VendorFault.TRIP, 10),
        (AT, 2, VendorFault.TRIP, 10), (AT + 0.01, 1, VendorFault.PLUG, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"does": "melt"}, "melt"),
        ({"does": "trip", "for": "1 s"}, "has no end of its own"),
        ({"does": "late", "by": "3 s"}, "expected 0 to 2"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(table, sentence):
    with pytest.raises(ScenarioError, match=sentence):
        script(table)


def test_a_number_that_no_drive_has_is_refused(tmp_path):
    system = named("can-damiao", "run.stop=0.1")
    with twin.wired_nodes(system, tmp_path) as nodes, pytest.raises(ScenarioError, match="1, 2"):
        inject(nodes["master"], script({"drive": 7, "does": "reboot"}), tmp_path / "faults")


@pytest.mark.parametrize("deployment", ["can-damiao", "can-cia402", "six_axis"])
def test_a_drive_that_is_lost_before_it_has_told_anything_is_missed(deployment, tmp_path):
    rows, found = run(deployment, [{"does": "unplug", "at": 0.002}], tmp_path, "run.stop=0.7")
    control = rows["master_control"]
    assert control["reasons"][-1] & (Why.DRIVE | Why.STALE)
    assert control["state"][-1] == LifeState.FAULT
    assert (found.greatest, found.first) == (0.0, None)
