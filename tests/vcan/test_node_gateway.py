"""Two robots on two buses with the kernel's gateway between them, and its faults.

One run of two single nodes, each on its own bus; only xi is sent over the gateway. In phases the
gateway corrupts frames, a queue delays them, an interface is down, and a node floods the bus. The
journals show the effects afterwards.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.native.journal import Journal
from bridge.native.node import BURST
from tests.vcan.peers import PATIENCE, call, gateway, queueing
from tests.vcan.rehearsals import (
    ROOT,
    SCENARIO,
    bring_up,
    cosim,
    ended,
    interrupt,
    running,
    said,
    settings,
    slots,
    until,
)

DEPLOYMENT = f"""
[buses.link]
channel = "vcan0"
fd = false
bitrate = 500_000
dbc = "{ROOT}/configs/can/link2.dbc"

[nodes.left]
components = ["master", "master_control"]
number = 2
overrun = "20 s"
priority = 0
[nodes.left.stale]
"master_control.xi_in" = {{ age = "age[0]" }}

[nodes.right]
components = ["slave", "slave_control"]
number = 4
overrun = "20 s"
priority = 0
[nodes.right.stale]
"slave_control.xi_in" = {{ age = "age[0]" }}

[messages.XI_2]
bus = "link"
carries = ["master_control.xi"]

[messages.XI_4]
bus = "link"
carries = ["slave_control.xi"]
"""
CHANGES = ('run.step="5 ms"', 'run.stop="60 s"')
SLOWED = 0.04  # s
PHASE = 0.6  # s; a node with 200 Hz has 120 slots meanwhile, if it is let


@dataclass
class Phases:
    """When things were done to the buses, s of the monotonic clock."""

    began: dict[str, tuple[float, float]] = field(default_factory=dict)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """A phase: what is done, has acted for `PHASE`."""
        start = time.monotonic()
        yield
        time.sleep(PHASE)
        self.began[name] = start, time.monotonic()


@dataclass(frozen=True)
class Crossing:
    """What is left of the run."""

    folders: dict[str, Path]
    phases: Phases
    said: dict[str, str]

    def facts(self, node: str) -> dict[str, Any]:
        """What a node reported of itself."""
        path = self.folders[node] / "nodes" / f"{node}.json"
        assert path.is_file(), self.said[node]
        found: dict[str, Any] = json.loads(path.read_text())
        return found

    def rows(self, node: str, phase: str = "") -> np.ndarray:
        """A node's journal, or the rows whose slots were executed in a phase."""
        rows = Journal.open(self.folders[node] / "nodes" / f"{node}.journal")
        if not phase:
            return rows
        at = rows["woke_ns"] * 1e-9 + self.facts(node)["start_ns"] * 1e-9
        start, end = self.phases.began[phase]
        found: np.ndarray = rows[(at >= start) & (at < end)]
        return found


def _disturb(phases: Phases, left: tuple[str, str], right: tuple[str, str]) -> None:
    """All phases, one after the other; a quiet one in between."""
    with gateway(*left), gateway(*right):
        with phases.phase("quiet"):
            pass
        with queueing("vcan1", "netem", "delay", f"{SLOWED * 1e3:g}ms"), phases.phase("slow"):
            pass
        with phases.phase("flood"):
            call("cangen", "vcan0", "-g", "0", "-I", "010", "-L", "8", "-n", "600", "-i")
    corrupting = ("-f", "2A4:7FF", "-m", "XOR:D:0.0.0000000000000001")  # XI_4 and nothing else
    with gateway(*left), gateway(*right, *corrupting), phases.phase("corrupt"):
        pass
    with gateway(*left), gateway(*right):
        with phases.phase("healed"):
            pass
        call("ip", "link", "set", "vcan0", "down")
        with phases.phase("down"):
            pass
        call("ip", "link", "set", "vcan0", "up")
        with phases.phase("up"):
            pass


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Crossing:
    """Some seconds of two nodes on two buses."""
    bring_up()
    tmp = tmp_path_factory.mktemp("gateway")
    (tmp / "two.toml").write_text(DEPLOYMENT)
    folders = {"left": tmp / "left", "right": tmp / "right"}
    phases = Phases()

    def words(node: str, channel: str) -> list[str]:
        given = ("--deploy", str(tmp / "two.toml"), "--node", node, "-c", channel)
        return ["node", str(SCENARIO), *given, "--out", str(folders[node]), *settings(*CHANGES)]

    with running(tmp / "lib", *words("left", "vcan0")) as left:
        said(left, "waiting for NMT start")
        with running(tmp / "lib", *words("right", "vcan1")) as right:
            said(right, "waiting for NMT start")
            with gateway("vcan0", "vcan1"):
                call("cansend", "vcan0", "000#0100")
                for node, process in (("left", left), ("right", right)):
                    journal = folders[node] / "nodes" / f"{node}.journal"
                    until(lambda j=journal: slots(j) > 50, f"{node} runs", process)  # type: ignore[misc]
            _disturb(phases, ("vcan0", "vcan1"), ("vcan1", "vcan0"))
            with gateway("vcan0", "vcan1"):
                call("cansend", "vcan0", "000#0200")
            right_said = ended(right)
            with contextlib.suppress(AssertionError):  # one in FAULT may wait for a reset
                until(lambda: left.poll() is not None, "left ends", seconds=PATIENCE / 2)
            return Crossing(folders, phases, {"left": interrupt(left), "right": right_said})


def newest(rows: np.ndarray) -> np.ndarray:
    """Sequence numbers accepted last, a row each."""
    found: np.ndarray = rows["inlets"]["newest"][:, 0]
    return found


def test_xi_of_both_arms_crosses_the_gateway(run: Crossing) -> None:
    """And one NMT start on one bus began both runs within a slot."""
    for node in ("left", "right"):
        assert newest(run.rows(node, "quiet"))[-1] > 50
    starts = [run.facts(node)["start_ns"] for node in ("left", "right")]
    assert abs(starts[0] - starts[1]) < 5e6


def test_a_delay_is_seen_in_the_measured_age(run: Crossing) -> None:
    for node in ("left", "right"):
        transit = run.rows(node, "slow")["inlets"]["transit_ns"][:, 0] * 1e-9
        before = run.rows(node, "quiet")["inlets"]["transit_ns"][:, 0] * 1e-9
        assert before.min() < 0.9 * SLOWED < np.median(transit)


def test_a_node_whose_bus_was_down_has_stopped_and_the_other_goes_on(run: Crossing) -> None:
    """What is received comes in again by itself; a stop stays until somebody resets it."""
    assert run.facts("left")["reasons"] == ["bus"]
    assert run.facts("right")["state"] == "inactive", run.said["right"]
    assert run.facts("left")["buses"]["link"]["restarts"] >= 1
    for node in ("left", "right"):
        down, up = newest(run.rows(node, "down")), newest(run.rows(node, "up"))
        assert down[-1] == down[len(down) // 2]
        assert up[-1] > down[-1]


def test_a_flood_leaves_the_loop_alive(run: Crossing) -> None:
    rows = run.rows("left", "flood")
    assert run.facts("left")["unknown_frames"] >= 600
    assert len(rows) > 20 and newest(rows)[-1] > newest(rows)[0]


def test_what_the_gateway_corrupted_is_counted_and_not_accepted(run: Crossing) -> None:
    assert run.facts("left")["messages"]["XI_4"]["crc"] > 20
    assert run.facts("right")["messages"]["XI_2"]["crc"] == 0
    rows = run.rows("left", "corrupt")
    assert newest(rows)[-1] == newest(rows)[len(rows) // 2]
    healed = run.rows("left", "healed")
    assert newest(healed)[-1] > newest(rows)[-1]


def test_the_age_of_the_silent_neighbour_grows_for_the_controller(run: Crossing) -> None:
    """What fades its edge: the time since the last sample that was good."""
    system = load_system(SCENARIO, str(run.folders["left"].with_name("two.toml")), CHANGES)
    place = system.nodes["left"].plan.slots()["master_control.age"].start
    assert run.rows("left", "quiet")["signals"][-1, place] < 0.1
    assert run.rows("left", "corrupt")["signals"][-1, place] > 0.4
    assert run.rows("left", "healed")["signals"][-1, place] < 0.1


def test_nothing_comes_from_the_future(run: Crossing) -> None:
    """However late it is: a stamp of 16 bits is 65 ms, a counter of 4 bits is 80 ms."""
    for node in ("left", "right"):
        rows = run.rows(node)
        at = rows["woke_ns"] // 5_000_000  # slot of the wall clock: a late slot hears as much
        assert (newest(rows) <= at + 1).all()


def test_no_slot_is_left_out(run: Crossing) -> None:
    for node in ("left", "right"):
        rows = run.rows(node)
        assert (np.diff(rows["slot"]) == 1).all()
        late = rows[rows["flags"] & BURST == 0]
        assert ((late["woke_ns"] - late["deadline_ns"]) < 5e6).all()


@pytest.mark.parametrize("node", ["left", "right"])
def test_each_replays_alone(run: Crossing, node: str, tmp_path: Path) -> None:
    """Nobody recorded the other in this folder: what it sent is taken from the recording."""
    done = cosim(tmp_path / "lib", "replay", str(run.folders[node]))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "exactly 0" in done.stdout
