"""Python's structs, enums and limits of the bridge's C code agree with its headers."""

from __future__ import annotations

import ctypes as c
import shutil
from pathlib import Path
from typing import Any

import pytest

import cosim.bus.frames
import cosim.bus.settings
import cosim.bus.structs
from bridge.native import (
    bus,
    delay,
    epoch,
    faults,
    frame,
    journal,
    load,
    lockstep,
    mail,
    message,
    network,
    node,
    pace,
    safety,
    vendor,
)  # fmt: skip
from bridge.wiring.wiring import heard_dtype, row_dtype
from tests.bridge.deployments import named
from tests.c_probe import (
    differences,
    enums_in,
    members,
    names_beside,
    probe,
    row_differences,
    structs_in,
)  # fmt: skip

ROOT = Path(__file__).parents[3]
MODULES = (
    bus, delay, epoch, faults, frame, journal, load, lockstep, mail, message, network, node,
    pace, safety, vendor,
)  # fmt: skip
HEADERS = sorted((ROOT / "bridge/c").glob("*.h"))
BUS = [ROOT / "cosim/c/bus" / name for name in ("bus.h", "length.h", "tick.h")]
BUS_MODULES = (cosim.bus.frames, cosim.bus.settings, cosim.bus.structs)
#: What modules have of C besides structs and enums, by its name there.
CONSTANTS = {
    "BUS_BATCH": bus.BATCH, "TRAFFIC_SLOTS": bus.SLOTS, "TRAFFIC_SLOT_NS": bus.SLOT_NS,
    "FRAME_DATA": frame.DATA, "FRAME_FORMAT": bus.FORMAT, "PACE_BINS": pace.BINS,
    "MESSAGE_FIELDS": message.FIELDS, "RECEIVE_TURNS": message.STAMP_TURNS,
    "RECEIVE_EARLY_NS": message.EARLY_NS, "SAFETY_JOINTS": safety.JOINTS,
    "EPOCH_VALUES": len(epoch.SIGNALS) + len(epoch.IDENTITY), "MAIL_ASLEEP": mail._ASLEEP,
    "CLOCK_WALL": node.WALL, "CLOCK_SIMULATED": node.SIMULATED, "CLOCK_REPLAY": node.REPLAY,
    "ROW_BURST": node.BURST, "ROW_FAILED": node.FAILED, "ROW_DISABLED": node.DISABLED,
    "ROW_ENABLED": node.ENABLED, "ALARM_RAISED": node.RAISED, "SAMPLE_UNKNOWN": node.UNKNOWN,
    "SAMPLE_THERE": node.THERE, "LIVE_FINISHED": node.FINISHED, "LIVE_STOPPED": node.STOPPED,
    "LIVE_NEVER_STARTED": node.NEVER_STARTED, "LIVE_FAULT": node.FAULT,
    "LIVE_NOT_JOINED": node.NOT_JOINED, "LOCKSTEP_STALLED": lockstep.STALLED,
    "LOCKSTEP_LOST": lockstep.LOST, "LOCKSTEP_REFUSED": lockstep.REFUSED,
    "VENDOR_QUEUE": vendor.QUEUE, "VENDOR_PARTS": vendor.PARTS,
    **{f"EPOCH_{name.upper()}": i for i, name in enumerate(epoch.SIGNALS)},
    **{f"FAULT_{name}": getattr(faults, name) for name in (
        "DROP", "BURST", "DELAY", "JITTER", "DUPLICATE", "REORDER", "CORRUPT", "FORGE", "REPLAY",
        "ABSURD", "FLOOD")},
    **{f"DELAY_{name}": getattr(delay, name) for name in (
        "NONE", "SIGNAL", "LAST", "STAMP", "FIFO", "PLAYOUT")},
}  # fmt: skip
#: NumPy rows that C reads and writes in memory.
BUS_ROWS = {
    "can_frame_t": cosim.bus.frames.FRAME, "bus_request_t": cosim.bus.frames.REQUEST,
    "bus_event_t": cosim.bus.frames.EVENT, "bus_received_t": cosim.bus.frames.RECEIVED,
}  # fmt: skip
#: Rows of files that C writes and NumPy reads: the fields that are in a struct.
ROWS: dict[str, list[str]] = {
    "row_t": ["slot", "deadline_ns", "woke_ns", "received_ns", "send_ns", "done_ns", "state",
              "commands", "now", "reasons", "guard", "flags", "scale"],
    "inlet_row_t": ["held", "newest", "age_ns", "transit_ns", "requests"],
    "heard_t": ["sequence", "arrival_ns", "message", "status"],
    "injected_t": list(faults.INJECTED.names or ()),
}  # fmt: skip


def said_by_c(headers: list[Path], modules: Any, constants: Any, rows: Any, scratch: Path) -> Any:
    enums = enums_in(*modules)
    names = [*constants, *(p + name for e, p in enums.items() for name in e.__members__)]
    structs = {name: members(struct) for name, struct in structs_in(*modules).items()}
    return probe(headers, structs | rows, names, scratch)


@pytest.fixture(scope="module")
def bridge(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return said_by_c(HEADERS, MODULES, CONSTANTS, ROWS, tmp_path_factory.mktemp("bridge"))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    rows = {name: list(row.names or ()) for name, row in BUS_ROWS.items()}
    scratch = tmp_path_factory.mktemp("simulated")
    return said_by_c(BUS, BUS_MODULES, {"BUS_ABI": cosim.bus.structs.ABI}, rows, scratch)


@pytest.mark.parametrize("name", structs_in(*BUS_MODULES))
def test_a_struct_of_the_simulated_bus_is_that_of_c(simulated: Any, name: str) -> None:
    assert differences(structs_in(*BUS_MODULES)[name], simulated["structs"][name]) == []


@pytest.mark.parametrize("kind", enums_in(*BUS_MODULES), ids=lambda kind: kind.__name__)
def test_an_enum_of_the_simulated_bus_is_that_of_c(simulated: Any, kind: Any) -> None:
    prefix = enums_in(*BUS_MODULES)[kind]
    here = {prefix + name: member.value for name, member in kind.__members__.items()}
    assert here == {name: simulated["names"][name] for name in here}
    assert set(here) == names_beside(next(iter(here)), BUS)


def test_rows_of_the_simulated_bus_are_those_of_c(simulated: Any) -> None:
    assert simulated["names"]["BUS_ABI"] == cosim.bus.structs.ABI
    for name, row in BUS_ROWS.items():
        assert row_differences(row, simulated["structs"][name]) == []
        assert row.itemsize == simulated["structs"][name][""]


@pytest.mark.parametrize("name", structs_in(*MODULES))
def test_a_struct_of_the_bridge_is_that_of_c(bridge: Any, name: str) -> None:
    assert differences(structs_in(*MODULES)[name], bridge["structs"][name]) == []


@pytest.mark.parametrize("kind", enums_in(*MODULES), ids=lambda kind: kind.__name__)
def test_an_enum_of_the_bridge_is_that_of_c(bridge: Any, kind: Any) -> None:
    prefix = enums_in(*MODULES)[kind]
    here = {prefix + name: member.value for name, member in kind.__members__.items()}
    assert here == {name: bridge["names"][name] for name in here}
    assert set(here) == names_beside(next(iter(here)), HEADERS)


def test_constants_are_those_of_c(bridge: Any) -> None:
    assert {name: bridge["names"][name] for name in CONSTANTS} == CONSTANTS


def test_rows_of_files_are_those_of_c(bridge: Any) -> None:
    structs, system = bridge["structs"], named("can")
    for name, plan in system.nodes.items():
        row, heard = row_dtype(plan), heard_dtype(system, name)
        assert row_differences(row, structs["row_t"]) == []
        assert row_differences(heard, structs["heard_t"]) == []
        assert row_differences(row["inlets"].base, structs["inlet_row_t"]) == []
        assert row["inlets"].base.itemsize == structs["inlet_row_t"][""]
        assert row.fields["inlets"][1] == structs["row_t"][""]  # type: ignore[index]
        assert heard.fields["values"][1] == structs["heard_t"][""]  # type: ignore[index]
    assert row_differences(faults.INJECTED, structs["injected_t"]) == []
    assert faults.INJECTED.itemsize == structs["injected_t"][""]


def test_a_frame_as_a_row_is_the_frame() -> None:
    whole = frame.frame_dtype(frame.DATA)
    places = {n: whole.fields[n][1] for n in whole.names or ()}  # type: ignore[index]
    assert whole.itemsize == c.sizeof(frame.Frame)
    assert places == {n: getattr(frame.Frame, n).offset for n, *_ in frame.Frame._fields_}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("int64_t sent, saturated;", "int64_t saturated, sent;"),
        ("double gain, offset;", "double offset, gain;"),
        ("int64_t q, dq;          /* signals for", "double q, dq;          /* signals for"),
        ("int32_t guarded, joints;", "int32_t joints, guarded;"),
        ("    int64_t node_extra;\n", ""),
    ],
)  # fmt: skip
def test_a_field_that_is_moved_is_noticed(tmp_path: Path, before: str, after: str) -> None:
    changed = tmp_path / "c"
    shutil.copytree(ROOT / "bridge/c", changed)
    for header in changed.glob("*.h"):
        text = header.read_text(encoding="utf-8")
        if not after:
            text = text.replace("typedef struct {", "typedef struct {\n" + before)
        header.write_text(text.replace(before, after) if after else text, encoding="utf-8")
    headers = sorted(changed.glob("*.h"))
    structs = {n: s for n, s in structs_in(node).items() if n in ("outlet_t", "inlet_t")}
    said = probe(headers, {n: members(s) for n, s in structs.items()}, [], tmp_path)
    assert any(differences(s, said["structs"][n]) for n, s in structs.items())
