"""``cosim node``: one node on a bus, started, stopped and stopped for good by what others send."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen

import can
import numpy as np

from bridge.can.codec import Codec
from bridge.can.dbc import load
from bridge.can.layout import find
from bridge.native.journal import Journal
from bridge.native.safety import LifeState, Status
from tests.vcan.peers import PATIENCE, call
from tests.vcan.rehearsals import CALM, ROOT, SCENARIO, ended, running, said, settings, slots, until

LAYOUTS = load(ROOT / "configs" / "can" / "link_fd2.dbc")
START, STOP = "000#0101", "000#0201"
ESTOP = "001#0700000000"


@dataclass(frozen=True)
class Alone:
    """A node that waits for its start."""

    process: Popen[str]
    folder: Path

    @property
    def journal(self) -> Path:
        return self.folder / "nodes" / "master.journal"

    def start(self, bus: str) -> None:
        """NMT start, and a quarter of a second of its run."""
        call("cansend", bus, START)
        until(lambda: slots(self.journal) > 50, "the node runs", self.process)

    def facts(self) -> dict[str, object]:
        """What it reported of itself."""
        found: dict[str, object] = json.loads((self.folder / "nodes" / "master.json").read_text())
        return found


@contextmanager
def drive_of_the_master(folder: Path, *changes: str) -> Iterator[Alone]:
    """The emulated drive of the master arm, ready: with silence = 0 it waits for no other node."""
    words = ("--node", "master", "--out", str(folder / "run"))
    values = settings(*CALM, 'run.stop="60 s"', "deploy.silence=0", *changes)
    with running(folder / "lib", "node", str(SCENARIO), *words, *values) as process:
        said(process, "waiting for NMT start")
        yield Alone(process, folder / "run")


def test_it_says_what_it_is_before_it_starts(vcan: tuple[str, str], tmp_path: Path) -> None:
    """Heartbeats say INACTIVE; its encoders can be read, marked as those of a rehearsal."""
    state, beat = Codec(find(LAYOUTS, "STATE_1")), Codec(find(LAYOUTS, "HEARTBEAT_1"))
    with (
        drive_of_the_master(tmp_path) as node,
        can.Bus(interface="socketcan", channel=vcan[0], fd=True) as bus,
    ):
        heard: dict[int, bytes] = {}
        while not {state.layout.identifier, beat.layout.identifier} <= heard.keys():
            message = bus.recv(PATIENCE)
            assert message, "the bus is silent"
            heard[message.arbitration_id] = bytes(message.data)
        assert node.process.poll() is None
    assert beat.decode(heard[beat.layout.identifier])[1][0] == LifeState.INACTIVE
    _, values, header = state.decode(heard[state.layout.identifier])
    assert header.status & Status.SIMULATED
    assert np.allclose(values[:2], [-np.pi / 3, -np.pi / 2], atol=1e-5)


def test_started_and_stopped_by_nmt(vcan: tuple[str, str], tmp_path: Path) -> None:
    with drive_of_the_master(tmp_path) as node:
        node.start(vcan[0])
        call("cansend", vcan[0], STOP)
        text = ended(node.process)
    assert node.process.returncode == 1
    assert node.facts()["end"] == "stopped" and node.facts()["state"] == "inactive", text


def test_an_emergency_stop_latches(vcan: tuple[str, str], tmp_path: Path) -> None:
    """Once is enough, a start does not help, and the node says on the bus that it was one."""
    with (
        drive_of_the_master(tmp_path) as node,
        can.Bus(interface="socketcan", channel=vcan[0], fd=True) as bus,
    ):
        node.start(vcan[0])
        call("cansend", vcan[0], ESTOP)
        call("cansend", vcan[0], START)
        echoed = 0
        while echoed < 3:
            message = bus.recv(PATIENCE)
            assert message, "the bus is silent"
            echoed += message.arbitration_id == 1 and message.data[0] == 1
    rows = Journal.open(node.journal)
    assert node.facts()["reasons"] and node.facts()["state"] == "fault"
    assert rows["scale"][-1] == 0.0


def test_commands_for_others_are_not_obeyed(vcan: tuple[str, str], tmp_path: Path) -> None:
    with drive_of_the_master(tmp_path) as node:
        node.start(vcan[0])
        call("cansend", vcan[0], "000#0203")
        n = slots(node.journal)
        until(lambda: slots(node.journal) > n + 50, "the node runs on", node.process)
