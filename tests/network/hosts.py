"""Rehearsals whose nodes are on hosts of their own, several networks at the same time.

Nodes sleep most of the time: networks side by side cost little more than the longest of them.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from bridge.deployment.system import System
from bridge.node.handle import NodeHandle
from bridge.records.node_lives import lives_of
from bridge.rehearsal.hosts import BOTH, PORT, listen_setting
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal, RehearsalRecord
from bridge.relay.network import RelayNetwork
from bridge.replay.diff import RunDifference, compare_runs
from bridge.results.offline import run_offline
from cosim.base.copies import replace
from tests.bridge.zenoh.rehearsed import CONFIGS, Rehearsed, collect, prepared, together

ARMS = ("master", "slave")
CONTROLLERS = ("master_control", "slave_control")
Q_H = np.array([3.5, 3.0])
WIDE = CONFIGS / "zenoh" / "wide.json5"
#: What a network takes at least: more than a slot, so that no late node hears of its own tick.
SHORT = {"law": "constant", "delay": "2 ms"}
#: All over TCP, in place of declarations over TCP and samples over UDP.
TCP = ("tcp/{}",)
#: Edges that hold for as long as this network may be silent, and are not faded before.
PATIENT = tuple(f'components.{c}.parameters.age_max="1.5 s"' for c in CONTROLLERS)
ROUTER = "router"


class Router:
    """Zenoh's router as a process on the host `router` of a network; a context manager."""

    def __init__(self, network: RelayNetwork) -> None:
        self._network = network
        self.endpoint = f"tcp/{network.addresses[ROUTER]}:7447"
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> None:
        """Start it, and wait until it listens."""
        command = [sys.executable, "-m", "bridge.zenoh.router", str(CONFIGS / "zenoh/router.json5")]
        with self._network.on_host(ROUTER):
            self._process = subprocess.Popen(
                [*command, self.endpoint, "--insecure"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        """SIGKILL."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@dataclass(frozen=True)
class Site:
    """The place of a case."""

    network: RelayNetwork
    router: Router | None


Events = Callable[[Site], Sequence[ScheduledEvent]]


@dataclass(frozen=True)
class Case:
    """A rehearsal of `stop` s on a network of its own.

    `ahead`: of a host's clock, ns; `links`: from the start, also while the nodes connect; `router`:
    nodes are clients of one, else each listens on `endpoints`.
    """

    stop: float
    events: Events = lambda site: ()
    changes: tuple[str, ...] = ()
    ahead: Mapping[str, int] = field(default_factory=dict)
    links: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: {"*": {"delay": SHORT}})
    nodes: tuple[str, ...] = ARMS
    router: bool = False
    scenario: str = "teleoperation"
    deployment: str = "zenoh"
    endpoints: tuple[str, ...] = BOTH


@dataclass
class Found(Rehearsed):
    """Results of a case: a run folder, and the packets of its network."""

    folder: Path
    network: RelayNetwork

    def packets(self, link: str) -> np.ndarray:
        """The packets of a link and their fate, see :data:`bridge.relay.router.PACKET`."""
        return np.array(self.network.of(link))

    def counts(self, node: str) -> Mapping[str, int]:
        """The counts of an arm's receiver for the other's messages."""
        return self.reports[node]["messages"][f"xi_{'slave' if node == 'master' else 'master'}"]

    def last_life(self, node: str) -> str:
        """The life of a node that began last."""
        return str(lives_of(self.rows, node)[-1])

    def silence(self, node: str, life: str = "") -> np.ndarray:
        """The silence that its controller is told, (slots,), s."""
        return self.signal(f"{node}_control.age", life)[:, 0]

    def taken_at(self, node: str) -> np.ndarray:
        """The age of each sample when it was first held, by its slot and this one's, s."""
        rows, plan = self.rows[node], self.system.nodes[node]
        held = rows["inlets"]["held"][:, 0]
        fresh = 1 + np.flatnonzero(np.diff(held) > 0)
        return (
            rows["slot"][fresh] * plan.h - held[fresh] * plan.inlets[0].ticks * self.system.plan.h
        )

    def transit(self, node: str) -> np.ndarray:
        """The time in the network of the newest sample at each slot once there is one, s."""
        rows = self.rows[node]["inlets"]
        return rows["transit_ns"][rows["newest"][:, 0] >= 0, 0] * 1e-9

    def offline(self) -> RunDifference:
        """Beside one offline run over its link tables."""
        return compare_runs(self.folder, run_offline(self.system, self.folder, self.rows))


def rehearse(cases: Mapping[str, Case], folder: Path) -> dict[str, Found]:
    """Run the cases side by side. Raises what the first that failed has raised."""
    with ExitStack() as stack:
        sites = {
            name: _site(stack, case, folder / f"{name}.packets") for name, case in cases.items()
        }
        waiting = {
            name: _prepared(case, sites[name], folder / name) for name, case in cases.items()
        }
        ended = together({name: running for name, (_, running) in waiting.items()})
        return {
            name: _found(system, ended[name], folder / name, sites[name].network)
            for name, (system, _) in waiting.items()
        }


def _site(stack: ExitStack, case: Case, record: Path) -> Site:
    hosts = [*case.nodes, ROUTER] if case.router else case.nodes
    network = stack.enter_context(RelayNetwork(hosts, record, case.links, seed=1))
    return Site(network, stack.enter_context(Router(network)) if case.router else None)


def settings(case: Case, site: Site) -> list[str]:
    """The network's delays only, and who listens where."""
    said = "deploy.buses.net"
    found = ["deploy.latency=false", f"{said}.options.insecure=true"]
    # machines of tests stand still at times
    found += [f'deploy.nodes.{node}.overrun="5 s"' for node in case.nodes]
    if site.router is not None:
        found.append(f'{said}.zenoh="{CONFIGS / "zenoh" / "client.json5"}"')
        return [
            *found,
            f"{said}.options.listen={{}}",
            f'{said}.options.connect="{site.router.endpoint}"',
        ]
    found.append(f'{said}.zenoh="{WIDE}"')
    for node in case.nodes:
        to = f"{site.network.addresses[node]}:{PORT}"
        found.append(listen_setting("net", node, to, case.endpoints))
    return found


def _prepared(case: Case, site: Site, folder: Path) -> tuple[System, Rehearsal]:
    changes = [f'run.stop="{case.stop} s"', *settings(case, site), *case.changes]
    system, running = prepared(case.scenario, case.deployment, changes, folder, case.events(site))
    _place(running, site.network, case.ahead)
    return system, running


def _place(running: Rehearsal, network: RelayNetwork, ahead: Mapping[str, int]) -> None:
    """Each node starts on its host, its clock `ahead` (ns)."""
    running.settings = replace(running.settings, on_host=network.on_host)
    start = running.start_node

    def start_node(name: str) -> NodeHandle:
        process = start(name)
        shift, tell = ahead.get(name, 0), process.send_command

        def told(command: str, **values: int) -> None:
            if "start_ns" in values:
                values["start_ns"] -= shift
            tell(command, **values)

        process.send_command = told  # type: ignore[method-assign]
        return process

    running.start_node = start_node  # type: ignore[method-assign]


def _found(system: System, ended: RehearsalRecord, folder: Path, network: RelayNetwork) -> Found:
    seen = collect(system, ended, folder)
    return Found(**vars(seen), folder=folder, network=network)


# ---- what every case shows --------------------------------------------------------------------


def settled(
    found: Found, arms: Sequence[str] = ARMS, last: float = 1.0, within: float = 0.05
) -> None:
    """In the last second: all arms where the hand wants them, with each other, the hand at rest."""
    ends = []
    for name in arms:
        life = found.last_life(name)
        n = round(last / found.system.nodes[name].h)
        ends.append(found.signal(f"{name}.q", life)[-n:])
        assert np.abs(ends[-1] - Q_H).max() < within, name
    assert np.ptp(ends, axis=0).max() < within
    held = arms[0] if len(arms) == 2 else "robot3"
    tau_h = found.signal(f"{held}.tau_h")
    assert np.abs(tau_h[-round(last / found.system.nodes[held].h) :]).max() < 10.0 * within


def bounded(found: Found, controllers: Sequence[str] = CONTROLLERS, limit: float = 100.0) -> None:
    """Torque of the controllers, at any time and in any life (N.m)."""
    for name in controllers:
        node = next(n for n, s in found.system.deployment.nodes.items() if name in s.components)
        for life in lives_of(found.rows, node):
            assert np.abs(found.signal(f"{name}.tau", life)).max() < limit, life


def in_order(found: Found) -> None:
    """Nobody goes back to a sample older than one it has held."""
    for life, rows in found.rows.items():
        assert (np.diff(rows["inlets"]["held"], axis=0) >= 0).all(), life


def exact(found: Found) -> None:
    """Every signal of every node again, to the last bit."""
    assert (found.replayed.greatest, found.replayed.first) == (0.0, None)
    assert found.replayed.alone == ()
