"""Nodes in lock-step as threads, over a network that takes any time; links of any law."""

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

from bridge.deployment.system import System
from bridge.native.bus import Bus
from bridge.native.frame import Frame, Ring
from bridge.native.node import FINISHED, NodeStruct, functions
from bridge.native.safety import Command
from bridge.node.lockstep import Lockstep
from bridge.records.node_lives import Life
from cosim.base.clock import sleep
from tests.bridge.deployments import named

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
