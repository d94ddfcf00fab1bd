"""Paths over Zenoh: questions and answers under own keys (:mod:`bridge.zenoh.exchange`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import final

from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import names_of
from bridge.ping.exchanges import PingPath
from bridge.ping.queued import QueuedPath
from bridge.zenoh.exchange import (
    KEYS,
    OpenSession,
    PingKeys,
    answering,
    asking,
    node_session,
    plain_session,
)
from cosim.base.clock import monotonic_ns
from cosim.base.errors import ScenarioError


@final
@dataclass(frozen=True, slots=True)
class PingedNodes:
    """Two nodes on a Zenoh bus of a deployment: `here` asks and `there` answers."""

    system: System
    bus: str
    here: str
    there: str

    @property
    def keys(self) -> PingKeys:
        """The keys of their questions and answers, which the nodes' certificates allow."""
        names = names_of(self.system.deployment, self.bus)
        command = f"cosim pong {self.system.scenario.path} {self.there}"
        return PingKeys(
            names.of("*", f"ping/{self.there}"), names.of(self.there, "pong/*"), command
        )

    def ways(self) -> Mapping[int, bool]:
        """The links between nodes by number, True for those of which the sender is not `here`.

        Raises ScenarioError where no link is between nodes.
        """
        nodes = self.system.deployment.nodes.items()
        homes = {c: name for name, node in nodes for c in node.components}
        ends = [
            (homes[link.source.partition(".")[0]], homes[link.target.partition(".")[0]])
            for link in self.system.scenario.links
        ]
        found = {i: a != self.here for i, (a, b) in enumerate(ends) if a != b}
        if not found:
            path = str(self.system.deployment.path)
            raise ScenarioError("no links between nodes, whose delays are replaced", path)
        return found


def pinged_nodes(system: System, here: str = "", there: str = "") -> PingedNodes:
    """Two nodes on the first Zenoh bus of a deployment; the first ones where no name is given.

    Raises ScenarioError where there is no such bus, or no such node on it.
    """
    buses = system.deployment.buses.items()
    bus = next((name for name, spec in buses if spec.kind == "zenoh"), None)
    if bus is None:
        raise ScenarioError(
            "no Zenoh bus to measure; CAN buses are analysed by cosim check",
            system.deployment.place("buses"),
        )
    nodes = [n for n in system.deployment.nodes if bus in system.buses_of(n)]
    for name in (here, there):
        if name and name not in nodes:
            raise ScenarioError(f"no node {name!r} on {bus}; there are: {', '.join(nodes)}")
    first = here or next(n for n in nodes if n != there)
    return PingedNodes(system, bus, first, there or next(n for n in nodes if n != first))


@contextmanager
def zenoh_path(endpoint: str, config: Path | None = None) -> Iterator[PingPath]:
    """The asking end. Raises BusError, RunError, ScenarioError where there is no other end."""
    name = f"{monotonic_ns():x}"
    with plain_session(endpoint, config) as session, _asking(session, name) as path:
        yield path


@contextmanager
def zenoh_responder(
    endpoint: str, config: Path | None = None, *, listen: bool = True
) -> Iterator[PingPath]:
    """The answering end, at `endpoint` or connected to a router there."""
    with plain_session(endpoint, config, listen=listen) as session, _answering(session) as path:
        yield path


@contextmanager
def node_path(nodes: PingedNodes) -> Iterator[PingPath]:
    """The asking end, in place of a node. Raises BusError, RunError, ScenarioError."""
    here, keys = nodes.here, nodes.keys
    with (
        node_session(nodes.system, nodes.bus, here) as (session, how),
        _asking(session, here, keys, how) as path,
    ):
        yield path


@contextmanager
def node_responder(nodes: PingedNodes) -> Iterator[PingPath]:
    """The answering end, in place of a node. Raises BusError, ScenarioError."""
    with (
        node_session(nodes.system, nodes.bus, nodes.there) as (session, reliability),
        _answering(session, nodes.keys, reliability) as path,
    ):
        yield path


@contextmanager
def _asking(
    session: OpenSession, name: str, keys: PingKeys = KEYS, reliability: str = "best-effort"
) -> Iterator[PingPath]:
    path = QueuedPath()
    with asking(session, name, path.put, keys, reliability) as ask:
        path.sender = lambda data, to: ask(data)
        yield path


@contextmanager
def _answering(
    session: OpenSession, keys: PingKeys = KEYS, reliability: str = "best-effort"
) -> Iterator[PingPath]:
    path = QueuedPath()
    with answering(session, path.put, keys, reliability) as answer:
        path.sender = lambda data, to: answer(data, str(to))
        yield path
