"""Nodes in lock-step run ahead by the delays of their links, and remain the twin to the bit."""

from __future__ import annotations

import ctypes as c
import json
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from random import Random
from threading import Event, Thread
from types import SimpleNamespace

import numpy as np
import pytest

from bridge.deployment.system import System
from bridge.native import lockstep as native
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.node import FINISHED, STOPPED, NodeStruct, functions
from bridge.native.safety import Command, LifeState, Status
from bridge.node.lockstep import Lockstep
from bridge.records.node_lives import Life
from bridge.replay import replay
from cosim.base.clock import sleep
from tests.bridge.deployments import named, run_twin

LOCKSTEP = "deploy.buses.net.options.lockstep=true"
STOP = 0.6
ARMS = ("master", "slave")


def system_with(*changes: str, stop: float = STOP, wait: str = "20 s") -> System:
    patience = f'deploy.buses.net.options.wait="{wait}"'
    return named("zenoh", LOCKSTEP, f"run.stop={stop}", patience, *changes)


class Network:
    """Carries what nodes send to the others: in order per pair, each frame after a drawn time."""

    def __init__(self, names: Sequence[str], seed: int, slowest: float) -> None:
        self._random, self._slowest = Random(seed), slowest
        self.rings = {name: (Ring(4096), Ring(4096)) for name in names}
        self._waiting = {(a, b): deque[Frame]() for a in names for b in names if a != b}
        self._stop = Event()
        self._thread = Thread(target=self._carry)
        self.greatest = 0  # frames that were on their way between two nodes

    def __enter__(self) -> Network:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _carry(self) -> None:
        while not self._stop.is_set():
            for name, (_, sent) in self.rings.items():
                while sent.get(frame := Frame()):
                    for (a, _), waiting in self._waiting.items():
                        if a == name:
                            waiting.append(frame)
            for (_, b), waiting in self._waiting.items():
                self.greatest = max(self.greatest, len(waiting))
                for _ in range(min(len(waiting), self._random.randrange(20))):
                    self.rings[b][0].put(waiting.popleft())
            sleep(self._random.uniform(0.0, self._slowest))


def run_apart(system: System, folder: Path, seed: int = 0, slowest: float = 0.0) -> dict[str, str]:
    """The nodes in threads, over a network of their own; how each ended, "" for well."""
    folder.mkdir()
    ended: dict[str, str] = {}

    def go(name: str, node: Lockstep) -> None:
        result = node.run()
        ended[name] = "" if result == FINISHED else node.error(result) or str(result)

    with Network(list(system.nodes), seed, slowest) as network, ExitStack() as stack:
        nodes = {
            name: stack.enter_context(one(system, name, network.rings[name], folder))
            for name in system.nodes
        }
        threads = [Thread(target=go, args=node) for node in nodes.items()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return ended


def one(system: System, name: str, rings: tuple[Ring, Ring], folder: Path) -> Lockstep:
    ends = {"net": SimpleNamespace(bus=Bus.from_rings(*rings))}
    node = Lockstep(system, name, ends, folder / Life(name).file("journal"))  # type: ignore[arg-type]
    start(node.wired.struct)
    return node


def start(struct: NodeStruct) -> None:
    functions().node_tell(c.byref(struct), Command.START)


DELAYS: Sequence[Mapping[str, object]] = (
    {"law": "uniform", "low": "20 ms", "high": "90 ms", "hold": "30 ms"},
    {"law": "constant", "delay": "35 ms"},
    {"law": "uniform", "low": "0 ms", "high": "40 ms", "hold": "10 ms"},
    {"law": "constant", "delay": "0.3 s"},
)
SEMANTICS: Mapping[str, Sequence[str]] = {
    "signal": (),
    "last-arrival": (),
    "newest-stamp": (),
    "fifo": (),
    "playout": ('playout="310 ms"',),
    "queue": ("depth=12", 'drop="newest"'),
}


def drawn_link(i: int, random: Random) -> list[str]:
    """Settings of a link with any law and any semantics; one of two may take no time."""
    laws = [law for law in DELAYS if i == 0 or law.get("low") != "0 ms"]
    law, rule = random.choice(laws), random.choice(list(SEMANTICS))
    text = ", ".join(f"{key}={json.dumps(value)}" for key, value in law.items())
    found = [f"links.{i}.delay={{{text}}}", f'links.{i}.semantics="{rule}"']
    return [*found, *(f"links.{i}.{key}" for key in SEMANTICS[rule])]


@pytest.mark.parametrize("seed", range(8))
def test_any_links_over_any_network_are_the_twin(seed: int, tmp_path: Path):
    random = Random(seed)
    phase = random.choice(["0 ms", "0.3 ms", "2 ms"])
    changes = [*drawn_link(0, random), *drawn_link(1, random)]
    system = system_with(*changes, f'deploy.nodes.slave.phase="{phase}"')
    expected = run_twin(system, tmp_path / "twin")
    heard = []
    for slowest in (0.0, 0.004):
        folder = tmp_path / f"{slowest}"
        assert run_apart(system, folder, seed, slowest) == dict.fromkeys(ARMS, ""), changes
        rows = replay.load(folder)
        for life in ARMS:
            assert rows[life].tobytes() == expected[life].tobytes(), (life, changes)
        heard.append(replay.received_by_life(folder))
    twin = replay.received_by_life(tmp_path / "twin")
    for life in ARMS:
        assert heard[0][life].tobytes() == heard[1][life].tobytes(), (life, changes)
        assert np.sort(heard[0][life]).tobytes() == np.sort(twin[life]).tobytes(), (life, changes)


@pytest.mark.parametrize(("ahead", "slots"), [("true", 298), ("false", 1)])
def test_a_node_alone_runs_ahead_by_the_least_delay(ahead: str, slots: int, tmp_path: Path):
    changes = [f'links.{i}.delay={{law="constant", delay="0.3 s"}}' for i in (0, 1)]
    system = system_with(*changes, f"deploy.buses.net.options.lookahead={ahead}", wait="50 ms")
    incoming, sent = Ring(8), Ring(4096)
    with one(system, "master", (incoming, sent), tmp_path) as node:
        result = node.run()
        assert result == native.STALLED
        assert node.wired.struct.slot == slots
        assert f"slot {slots} " in node.error(result) and "sample 0 of xi_slave" in node.error(
            result
        )
        assert len(sent) == -(-slots // 5)


@pytest.mark.parametrize("ahead", ["true", "false"])
def test_a_refused_sample_ends_a_run_that_was_ahead_of_it(ahead: str, tmp_path: Path):
    system = system_with(f"deploy.buses.net.options.lookahead={ahead}")
    carried, incoming = system.messages["xi_slave"], Ring(256)
    for k in range(120):
        header = Header(counter=k, status=LifeState.ACTIVE | Status.SIMULATED, t_us=5000 * k)
        value = 31.0 if k == 3 else 0.0  # rad/s; the range ends at 30
        incoming.put(carried.encoding.frame([value, 0.0], header))
    with one(system, "master", (incoming, Ring(4096)), tmp_path) as node:
        result = node.run()
        if ahead == "false":
            assert result == FINISHED and node.wired.receivers["xi_slave"].range == 1
            return
        assert result == native.REFUSED
        assert "sample 3 of xi_slave from node slave" in node.error(result)
        assert "options.lookahead = false" in node.error(result)


def test_an_emergency_stop_ends_a_node_that_does_not_wait(tmp_path: Path):
    system, incoming = system_with(), Ring(8)
    incoming.put(system.services["net"].estop.frame([1, 0], Header()))
    with one(system, "master", (incoming, Ring(4096)), tmp_path) as node:
        assert node.run() == STOPPED
        assert node.wired.struct.slot == 0
