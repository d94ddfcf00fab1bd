"""A node that is killed and started again by hand, with `cosim node`: it goes on in the run."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli.node import waiting_for_a_restart
from bridge.deployment.spec import find
from bridge.deployment.system import load_system
from bridge.records.node_lives import ByLife, Life
from bridge.relay.network import RelayNetwork
from bridge.replay import replay
from bridge.wiring.wiring import Rows
from cosim.base.clock import sleep
from tests.network.hosts import ARMS, Case, Site, settings

SCENARIO = Path(__file__).parents[2] / "configs" / "teleoperation.toml"
COSIM = "from cosim.cli import main; main()"
BOOT_ID = "/proc/sys/kernel/random/boot_id"
#: Two arms on one CAN bus, each with its controller in one node, that send xi to each other.
CAN = """
[buses.net]
interface = "udp_multicast"
dbc = "{dbc}"
channel = "239.74.163.9"

[nodes.master]
number = 1
components = ["master", "master_control"]
overrun = "20 s"

[nodes.slave]
number = 2
components = ["slave", "slave_control"]
overrun = "20 s"

[messages.LINK_1]
bus = "net"
carries = ["master_control.xi"]

[messages.LINK_2]
bus = "net"
carries = ["slave_control.xi"]
"""
#: What another host says of itself; the nodes measure how far its clock is ahead.
ANOTHER = "11111111-2222-3333-4444-555555555555"
LONG = 600.0  # s; whoever has seen enough stops the nodes
pytestmark = pytest.mark.slow


class ByHand:
    """Nodes in namespaces, each started by ``cosim node`` in a folder of its own."""

    def __init__(self, network: RelayNetwork, words: Sequence[str], folder: Path) -> None:
        self.network, self.describe, self.folder = network, words, folder
        self.nodes: list[subprocess.Popen[str]] = []

    def node(self, host: str, name: str, folder: str, boot_id: str = "") -> subprocess.Popen[str]:
        """Start a node; `boot_id`: what its host claims to be."""
        words = ["node", str(SCENARIO), "--node", name, "--out", str(self.folder / folder)]
        call = [sys.executable, "-c", COSIM, *words, *self.describe]
        if boot_id:
            (claimed := self.folder / "boot_id").write_text(boot_id)
            mounts = f'mount --bind "{claimed}" {BOOT_ID} && exec "$@"'
            call = ["unshare", "-m", "sh", "-c", mounts, "sh", *call]
        with self.network.on_host(host):
            node = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
        self.nodes.append(node)
        return node

    def tell(self, host: str, what: str) -> None:
        with self.network.on_host(host):
            call = [sys.executable, "-c", COSIM, "tell", str(SCENARIO), what, *self.describe]
            subprocess.run(call, check=True, timeout=60.0)

    def stop(self) -> None:
        """Ctrl-C for all that run."""
        for node in self.nodes:
            node.send_signal(signal.SIGINT)  # nothing, where it has been waited for

    def end(self) -> None:
        for node in self.nodes:
            node.kill()
            node.wait()


def line(node: subprocess.Popen[str], text: str) -> str:
    """The first line a node says with this in it."""
    assert node.stdout is not None
    found = [*lines(node, text)]
    assert found and text in found[-1], found
    return found[-1]


def lines(node: subprocess.Popen[str], text: str) -> Iterator[str]:
    for said in iter(node.stdout.readline, ""):  # type: ignore[union-attr]
        yield said
        if text in said:
            return


def report(folder: Path, name: str) -> dict[str, Any]:
    return json.loads((folder / "nodes" / f"{name}.json").read_text())


def rejoins(hand: ByHand, changes: Sequence[str], deployment: str, boot_id: str = "") -> None:
    """Both start, the slave is killed and started again, both are stopped; then all is asked."""
    master, again = two_lives(hand, deployment, boot_id)
    sleep(2.0)
    hand.stop()
    for node in (master, again):
        node.communicate(timeout=120.0)
    asked(hand, "stopped")
    replayed(hand, changes, deployment)


def two_lives(
    hand: ByHand, deployment: str, boot_id: str, away: float = 0.0
) -> tuple[subprocess.Popen[str], subprocess.Popen[str]]:
    """The master, and the second life of the slave, `away` s later, which has joined the run."""
    hosts = ARMS if deployment == "zenoh" else ("master", "master")
    master = hand.node(hosts[0], "master", "master", "")
    slave = hand.node(hosts[1], "slave", "slave", boot_id)
    for node in (master, slave):
        line(node, "ready, waiting for NMT start")
    if deployment == "zenoh":
        hand.tell("master", "start")
    else:
        start(hand.network)
    sleep(2.0)
    slave.kill()
    slave.wait()
    sleep(away)
    again = hand.node(hosts[1], "slave", "again", boot_id)
    assert "joins the run at t = " in line(again, "joins the run")
    return master, again


def asked(hand: ByHand, end: str) -> None:
    """What the reports of the master and of the slave's second life say."""
    first, second = report(hand.folder / "master", "master"), report(hand.folder / "again", "slave")
    assert (first["end"], second["end"]) == (end, end)
    assert second["first_slot"] > 2000
    assert abs(second["start_ns"] - first["start_ns"]) < 50e6  # clocks of two hosts, measured
    assert second["run"] == first["run"]
    for counts in (*first["messages"].values(), *second["messages"].values()):
        # Both were heard for 2 s at least, on a machine that stands still at times.
        assert counts["ok"] > 300
        assert counts["stale"] == 0
        # Until the heartbeat of its new life was heard, which takes longer on a busy machine.
        assert counts["wrong_sequence"] + counts["resyncs"] < counts["ok"] / 5


def replayed(hand: ByHand, changes: Sequence[str], deployment: str) -> ByLife[Rows]:
    """Three lives in three folders; the killed one's file ends where it was killed. Their rows."""
    system = load_system(SCENARIO, deployment, changes)
    of = {Life("master"): "master", Life("slave"): "slave", Life("slave", 2): "again"}
    rows, heard = (
        ByLife({x: read(hand.folder / f / "nodes")[Life(x.node)] for x, f in of.items()})
        for read in (replay.load, replay.received_by_life)
    )
    slots = np.concatenate([rows[Life("slave")]["slot"], rows[Life("slave", 2)]["slot"]])
    assert (np.diff(slots) > 0).all()
    found = replay.replay(system, rows, heard, hand.folder)
    assert (found.greatest, found.first, found.alone) == (0.0, None, ())
    return rows


def start(network: RelayNetwork) -> None:
    """A plain NMT start from a stranger."""
    said = (
        "import can\n"
        "with can.Bus('239.74.163.9', interface='udp_multicast', fd=True) as bus:\n"
        "    bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))\n"
    )
    with network.on_host("master"):
        subprocess.run([sys.executable, "-c", said], check=True, timeout=30.0)


@contextmanager
def on_two_hosts(folder: Path, stop: float, *waits: str) -> Iterator[tuple[ByHand, list[str]]]:
    """Nodes over Zenoh that end at `stop` s at the latest, and their settings."""
    with ExitStack() as stack:
        network = stack.enter_context(RelayNetwork(ARMS, folder / "packets"))
        site = settings(Case(stop), Site(network, None))
        changes = [f'run.stop="{stop} s"', *waits, *site]
        changes += [f'deploy.nodes.{arm}.overrun="20 s"' for arm in ARMS]
        said = ["--deploy", "zenoh", *(w for change in changes for w in ("--set", change))]
        hand = ByHand(network, said, folder)
        stack.callback(hand.end)
        yield hand, changes


def test_over_zenoh_on_two_hosts(tmp_path: Path) -> None:
    """Its clock is not the master's but is measured: nobody keeps the date of either."""
    with on_two_hosts(tmp_path, LONG, "deploy.silence=0") as (hand, changes):
        rejoins(hand, changes, "zenoh", ANOTHER)


def test_over_zenoh_a_node_may_be_away_for_longer_than_a_rehearsal_allows(tmp_path: Path) -> None:
    """The defaults of the deployment, and a person who takes a while."""
    with on_two_hosts(tmp_path, LONG) as (hand, changes):
        nodes = two_lives(hand, "zenoh", "", away=13.0)
        sleep(2.0)
        hand.stop()
        for node in nodes:
            node.communicate(timeout=120.0)
        asked(hand, "stopped")
        replayed(
            hand, [*changes, *waiting_for_a_restart(find(SCENARIO, "zenoh"), changes)], "zenoh"
        )


def test_over_zenoh_on_two_hosts_that_share_a_clock_to_the_end(tmp_path: Path) -> None:
    with on_two_hosts(tmp_path, 40.0, "deploy.silence=0") as (hand, changes):
        nodes = two_lives(hand, "zenoh", "")
        for node in nodes:
            node.communicate(timeout=120.0)
            assert node.returncode == 0
        asked(hand, "finished")
        rows = replayed(hand, changes, "zenoh")
        assert rows[Life("slave", 2)]["slot"][-1] == rows[Life("master")]["slot"][-1]


def test_over_can(tmp_path: Path) -> None:
    """Both on one host; START is a frame without EPOCH before it."""
    from bridge.relay import namespaces

    deployment = tmp_path / "pair.toml"
    deployment.write_text(CAN.format(dbc=SCENARIO.parent / "can" / "link_fd2.dbc"))
    with ExitStack() as stack:
        network = stack.enter_context(RelayNetwork(ARMS, tmp_path / "packets"))
        namespaces.multicast(network.namespaces["master"])
        changes = [f'run.stop="{LONG} s"', "deploy.silence=0"]
        said = ["--deploy", str(deployment), *(w for x in changes for w in ("--set", x))]
        hand = ByHand(network, said, tmp_path)
        stack.callback(hand.end)
        rejoins(hand, changes, str(deployment))
