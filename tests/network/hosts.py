"""Rehearsals whose nodes are on hosts of their own."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bridge.hosts import PORT, listening
from bridge.process import Process
from bridge.rehearse import Event, Rehearsal
from bridge.relay.network import Network
from tests.bridge.zenoh.rehearsed import CONFIGS, Rehearsed, collect, prepared

Q_H = np.array([3.5, 3.0])
WIDE = CONFIGS / "zenoh" / "wide.json5"


def settings(network: Network, nodes: Sequence[str], bus: str = "net") -> list[str]:
    """Declarations over TCP, samples over UDP, the network's delays only."""
    found = ["deploy.latency=false", f'deploy.buses.{bus}.zenoh="{WIDE}"']
    found.append(f"deploy.buses.{bus}.options.insecure=true")
    return found + [listening(bus, n, f"{network.addresses[n]}:{PORT}") for n in nodes]


class Hosted:
    """What a rehearsal does, with each node started on its host, its clock `ahead` (ns)."""

    def __init__(self, network: Network, ahead: Mapping[str, int] | None = None) -> None:
        self.network, self.ahead = network, ahead or {}

    def place(self, running: Rehearsal) -> None:
        running.settings = replace(running.settings, inside=self.network.inside)
        start = running.start_node

        def start_node(name: str) -> Process:
            process = start(name)
            shift, tell = self.ahead.get(name, 0), process.tell

            def told(command: str, **values: int) -> None:
                if "start_ns" in values:
                    values["start_ns"] -= shift
                tell(command, **values)

            process.tell = told  # type: ignore[method-assign]
            return process

        running.start_node = start_node  # type: ignore[method-assign]


def rehearse_on(
    hosted: Hosted,
    scenario: str,
    deployment: str,
    changes: Sequence[str],
    folder: Path,
    events: Sequence[Event] = (),
) -> Rehearsed:
    system, running = prepared(scenario, deployment, changes, folder, events)
    hosted.place(running)
    with running:
        ended = running.run()
    return collect(system, ended, folder)


def arm(found: Rehearsed, name: str, life: str = "") -> Any:
    return found.signal(f"{name}.q", life)


def settled(found: Rehearsed, arms: Sequence[str], last: float = 1.0, within: float = 0.05) -> None:
    """In the last second: all arms where the hand wants them, and the hand rests."""
    for name in arms:
        lives = [x for x in found.rows if x.partition(".")[0] == name]
        life = max(lives, key=lambda x: found.rows[x]["slot"][-1])
        n = round(last / found.system.nodes[name].h)
        assert np.abs(arm(found, name, life)[-n:] - Q_H).max() < within, name
    held = arms[0] if len(arms) == 2 else "robot3"
    tau_h = found.signal(f"{held}.tau_h")
    assert np.abs(tau_h[-round(last / found.system.nodes[held].h) :]).max() < 10.0 * within


def bounded(found: Rehearsed, controllers: Sequence[str], limit: float = 100.0) -> None:
    """Torque of the controllers, at any time (N.m)."""
    for name in controllers:
        assert np.abs(found.signal(f"{name}.tau")).max() < limit


def exact(found: Rehearsed) -> None:
    assert (found.replayed.greatest, found.replayed.first) == (0.0, None)
