"""The lanes of the nodes, and the load of the buses, where they have to be."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bridge.deployment.services import Service
from bridge.native.frame import frame_dtype
from bridge.native.safety import LifeState
from bridge.records.node_lives import Life
from bridge.results.findings import Evidence, Place
from bridge.results.report import bus_reports
from bridge.results.timeline import frame_lanes, lanes, marks

PERIOD = 5_000_000  # ns
FIELDS = [("slot", "<i8"), ("deadline_ns", "<i8"), ("woke_ns", "<i8"), ("state", "<i4")]
ROW = np.dtype([*FIELDS, ("serving", "<u8")])
#: Of the drawing: lanes are between these, in its units.
LEFT, RIGHT = 150, 1090


def outcome(faults: tuple[Evidence, ...] = ()) -> Any:
    """A node of 10 s that stops at 6 s, and was late in two slots at 2.5 s."""
    rows = np.zeros(2000, ROW)
    rows["slot"] = np.arange(2000)
    rows["deadline_ns"] = rows["woke_ns"] = rows["slot"] * PERIOD
    rows["woke_ns"][500] += PERIOD
    rows["woke_ns"][501] += 3 * PERIOD
    rows["woke_ns"][502] += PERIOD - 1  # late, but in its period
    rows["state"] = LifeState.ACTIVE
    rows["state"][1200:] = LifeState.FAULT
    life = Life("slave", 1)
    report = SimpleNamespace(life=life, lateness=SimpleNamespace(period_ns=PERIOD), statement=None)
    return SimpleNamespace(reports=[report], rows={life: rows}, faults=faults)


def encoding(identifier: int) -> Any:
    return SimpleNamespace(message=SimpleNamespace(id=identifier))


def at(t: float) -> float:
    return LEFT + (RIGHT - LEFT) * t / 10


def test_states_and_missed_slots_are_where_they_were() -> None:
    text = lanes(outcome(), 10.0)
    bars = re.findall(r'<rect x="([\d.]+)" y="6" width="([\d.]+)".*?<title>(.*?)</title>', text)
    assert [title for *_, title in bars] == [
        "slave: active from 0.00 s to 6.00 s", "slave: fault from 6.00 s to 10.00 s",
    ]  # fmt: skip
    assert [float(x) for x, *_ in bars] == pytest.approx([at(0), at(6)], abs=0.1)
    assert sum(float(width) for _, width, _ in bars) == pytest.approx(RIGHT - LEFT, abs=0.2)
    (missed,) = re.findall(r'<rect x="([\d.]+)" y="2".*?<title>(.*?)</title>', text)
    assert float(missed[0]) == pytest.approx(at(2.5), abs=0.1)
    assert missed[1].startswith("slave: 2 slots missed from 2.50 s")


def test_a_fault_that_nothing_shows_is_marked() -> None:
    seen = Evidence(index=3, kind="drop", targets=("slave",), t0=1.0, t1=2.0, places=())
    unseen = Evidence(
        index=4, kind="drop", targets=("slave",), t0=5.0, t1=5.0,
        places=(Place(target="slave", done=2),),
    )  # fmt: skip
    text = lanes(outcome((seen, unseen)), 10.0)
    found = re.findall(r'<text class="faint" x="([\d.]+)" y="31">(.*?)</text>', text)
    assert [label for _, label in found] == ["3", "4 unseen"]
    assert [float(x) for x, _ in found] == pytest.approx([at(1), at(5)], abs=0.1)


def test_a_drive_that_is_off_is_drawn_and_marked() -> None:
    found = outcome()
    [report], [rows] = found.reports, found.rows.values()
    rows["serving"] = 3
    rows["serving"][1000:] = 1
    event = {"t": 5.0, "drive": "drive 2 on bus left", "phase": "failed", "told": "OVERLOAD"}
    report.statement = SimpleNamespace(drives=(event,))
    text = lanes(found, 10.0)
    assert "all drives enabled from 0.00 s to 5.00 s" in text
    assert "1 of 2 drives off from 5.00 s to 10.00 s" in text
    assert marks(found)[-1] == {"t": 5.0, "label": "drive 2 on bus left: OVERLOAD", "to": None}


def test_frames_of_a_message_are_where_there_were_any() -> None:
    t = np.concatenate([np.arange(0.001, 4.0, 0.0125), np.arange(8.001, 10.0, 0.00625)])
    found: Any = SimpleNamespace(buses={"left": SimpleNamespace(frames={"xi <1>": t})})
    text = frame_lanes(found, 10.0)
    bars = re.findall(r'<rect x="([\d.]+)".*?opacity="([\d.]+)"><title>(.*?)</title>', text)
    assert [float(x) for x, *_ in bars] == pytest.approx([at(0), at(8)], abs=0.1)
    assert [shade for _, shade, _ in bars] == ["0.50", "1.00"]
    assert bars[0][2] == "xi &lt;1&gt;: 320 frames from 0.00 s to 4.00 s"
    assert frame_lanes(SimpleNamespace(buses={}), 10.0) == ""  # type: ignore[arg-type]


def test_marks_are_faults_and_the_time_in_which_a_node_was_in_fault() -> None:
    fault = Evidence(index=3, kind="drop", targets=("slave",), t0=1.0, t1=2.0, places=())
    first, second = marks(outcome((fault,)))
    assert (first["t"], first["to"], first["label"]) == (1.0, 2.0, fault.text())
    assert second == {"t": 6.0, "label": "slave: FAULT", "to": 10.0}


def test_a_run_without_slots_has_no_lanes() -> None:
    empty: Any = SimpleNamespace(reports=[], rows={}, faults=())
    assert lanes(empty, 10.0) == ""


def test_the_load_of_a_bus_over_time_begins_with_its_first_frame() -> None:
    """Frames of 111 bits and one stuff bit, 1 ms apart, from 0.5 s before the run on."""
    rows = np.zeros(1000, frame_dtype())
    rows["t_ns"] = 7_500_000_000 + 1_000_000 * np.arange(1000)
    rows["id"], rows["length"], rows["data"][:, :8] = 0x555, 8, 0x55
    bus = SimpleNamespace(bitrate=1_000_000, data_bitrate=None, fd=False)
    rows["id"][::10] = 0x701
    xi = SimpleNamespace(name="xi", bus="left", encoding=encoding(0x555))
    services = {name: Service(heartbeats={1: encoding(0x701)}) for name in ("left", "idle")}
    system = SimpleNamespace(
        deployment=SimpleNamespace(buses={"left": bus, "idle": bus}),
        messages={"xi": xi},
        services=services,
    )
    logs = {"left": SimpleNamespace(rows=rows), "idle": SimpleNamespace(rows=rows[:0])}
    found = bus_reports(system, logs, 8_000_000_000)  # type: ignore[arg-type]
    assert list(found) == ["left"]
    report = found["left"]
    assert report.text.startswith("bus left") and "1000 frames, load 11.2%" in report.text
    assert report.start == pytest.approx(-0.5 - 112e-6, abs=1e-9)
    assert {name: len(t) for name, t in report.frames.items()} == {"xi": 900, "HEARTBEAT_1": 100}
    assert report.frames["HEARTBEAT_1"][:2] == pytest.approx([-0.5, -0.49], abs=1e-9)
    assert len(report.load) == 10 and report.load == pytest.approx(0.112, abs=0.002)
