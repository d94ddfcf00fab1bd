"""The nodes of a rehearsal on other hosts: all connections and the routers between them.

A host whose Zenoh router has lost its connection to the others is given up, also if it is connected
again: what was sent meanwhile is lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self, final

from bridge.deployment.system import System
from bridge.node.handle import LostError, NodeHandle, NodeStart
from bridge.rehearsal.host_connection import LOOK, HostConnection
from bridge.rehearsal.host_file import HostFile, Site, fixed
from bridge.rehearsal.placement import HostPlacement, place, predict, ways
from cosim.base.clock import sleep, stopwatch
from cosim.record.folder import NODES

#: s in which both ends of a lost connection between two routers, and a lost host, become known.
APART = 1.0


@final
class RemoteHosts:
    """The hosts of a rehearsal, by name; a context manager: at its end nothing runs on them.

    `nodes`: the host of each; `changes`: settings of the run; `folder`: for the journals.
    """

    def __init__(
        self,
        system: System,
        file: HostFile,
        nodes: Mapping[str, str],
        changes: Sequence[str],
        folder: Path,
    ) -> None:
        self._system, self._file, self._nodes = system, file, nodes
        self._changes, self._folder = tuple(changes), folder
        self.connections: dict[str, HostConnection] = {}
        self._apart: Callable[[], float] | None = None
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            scratch = Path(stack.enter_context(TemporaryDirectory(prefix="cosim-")))
            site = stack.enter_context(Site(self._file, scratch / "packets"))
            for name in self._file.hosts:
                task = site.task(name, self._system, self._changes, self._folder)
                found = HostConnection(name, site.call(name), task, self._folder)
                stack.callback(found.close)
                self.connections[name] = found
            self._wait()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _wait(self) -> None:
        """Until all hosts have read the scenario, and their routers are connected.

        Raises LostError that names the missing ones.
        """
        patience, elapsed = self._system.deployment.patience, stopwatch()
        while (absent := self._absent()) or self._unconnected():
            for found in self.connections.values():
                found.look()
                found.check()
            if elapsed() > patience:
                after = f"after {patience:g} s (patience)"
                if absent:
                    raise LostError(f"host {', '.join(absent)}: not there {after}", tuple(absent))
                host, others = self._cut_off()
                text = (
                    f"host {host}: its Zenoh router is not connected to that of {others} {after}; "
                    "check addresses, ports and certificates"
                )
                raise LostError(text, (host,))
            sleep(LOOK)
        for found in self.connections.values():
            found.check()
            found.watch = self._watch_routers

    def _absent(self) -> list[str]:
        return [name for name, found in self.connections.items() if not found.loaded]

    def _unconnected(self) -> list[tuple[str, str]]:
        """The pairs of hosts whose routers are not connected, without hosts that have failed."""
        there = [found for found in self.connections.values() if not found.failed]
        return [
            (a.name, b.name)
            for a, b in combinations(there, 2)
            if a.router_id not in b.routers or b.router_id not in a.routers
        ]

    def _cut_off(self) -> tuple[str, str]:
        """The host that is not connected to the most others, of two the last; and the others."""
        pairs = self._unconnected()
        order, counted = list(self.connections), Counter(name for pair in pairs for name in pair)
        host = max(counted, key=lambda name: (counted[name], order.index(name)))
        others = [a if b == host else b for a, b in pairs if host in (a, b)]
        return host, ", ".join(others)

    def _watch_routers(self) -> None:
        """Give up a host whose router has lost the others."""
        if not self._unconnected():
            self._apart = None
            return
        self._apart = self._apart or stopwatch()
        if self._apart() > APART:
            host, others = self._cut_off()
            self._apart = None
            limit = self._file.silence
            self.connections[host].fail(
                f"its Zenoh router lost its connection to that of {others}: nothing came for "
                f"{limit:g} s (silence)"
            )

    def start_node(self, start: NodeStart) -> NodeHandle:
        """Start a life of a node on its host."""
        return self.connections[self._nodes[start.life.node]].start_node(start)

    def facts(self) -> dict[str, Any]:
        """For ``run.json``: the nodes of each host, and which host it is."""
        return {
            name: {
                "identity": found.hello["host"] if found.hello else "",
                "name": found.hello["name"] if found.hello else "",
                "nodes": [node for node, host in self._nodes.items() if host == name],
            }
            for name, found in self.connections.items()
        }


def on_hosts(
    system: System, file: HostFile, changes: Sequence[str], folder: Path
) -> tuple[RemoteHosts, HostPlacement]:
    """The hosts of a file with the nodes of a deployment on them. Raises ScenarioError.

    `changes`: settings of the run; `folder`: the run folder.
    """
    d, between = system.deployment, ways(system)
    cores = {name: host.cores for name, host in file.hosts.items()}
    placed = place(tuple(system.nodes), between, cores, fixed(file, system.nodes))
    waits = [
        f"deploy.buses.{name}.options.wait={d.patience:g}"
        for name, bus in d.buses.items()
        if "wait" not in bus.options
    ]
    hosts = RemoteHosts(system, file, placed, [*changes, *waits], folder / NODES)
    return hosts, predict(system, between, placed, cores, file.latency)
