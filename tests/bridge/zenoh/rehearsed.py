"""A rehearsal of a deployment over Zenoh as processes, its run folder, and its replay."""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Barrier, BrokenBarrierError
from typing import Any

from bridge.deployment import spec
from bridge.deployment.system import System, load_system
from bridge.recording.run_folder import write_tables, write_trajectories
from bridge.records.node_lives import ByLife
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import NODES, Rehearsal, RehearsalRecord, Settings
from bridge.replay import replay
from bridge.results.outcome import deployment_facts
from bridge.wiring.wiring import Rows
from cosim.engine.simulate import metadata
from cosim.record import write_metadata

CONFIGS = Path(__file__).parents[3] / "configs"


@dataclass
class Rehearsed:
    system: System
    ended: RehearsalRecord
    rows: ByLife[Rows]
    reports: Mapping[str, Mapping[str, Any]]
    replayed: replay.ReplayReport

    def signal(self, name: str, life: str = "") -> Any:
        """One signal of a node over its slots, (slots, size)."""
        for node, plan in self.system.nodes.items():
            slot = plan.plan.slots().get(name)
            if slot is not None:
                rows = self.rows[life or node]
                return rows["signals"][:, slot.start : slot.start + slot.size]
        raise KeyError(name)


def prepared(
    scenario: str,
    deployment: str,
    changes: Sequence[str],
    folder: Path,
    events: Sequence[ScheduledEvent] = (),
) -> tuple[System, Rehearsal]:
    path = CONFIGS / f"{scenario}.toml"
    given = spec.find(path, deployment)
    system = load_system(path, str(given), changes)
    settings = Settings(path, given, tuple(changes), warm_up=0.0, events=events)
    return system, Rehearsal(system, settings, folder)


def collect(system: System, ended: RehearsalRecord, folder: Path) -> Rehearsed:
    """The journals of all lives, and the run again from them."""
    nodes = folder / NODES
    rows = replay.load(nodes)
    write_trajectories(system, rows, folder)
    write_tables(system, rows, folder)
    write_metadata(folder, metadata(system.scenario, system.plan) | deployment_facts(system, {}))
    again = folder / "again"
    again.mkdir()
    found = replay.replay(system, rows, replay.received_by_life(nodes), again)
    reports = {p.stem: json.loads(p.read_text()) for p in nodes.glob("*.json")}
    return Rehearsed(system, ended, rows, reports, found)


def together(waiting: Mapping[str, Rehearsal]) -> dict[str, RehearsalRecord]:
    """Run rehearsals side by side; none begins before all are ready: starting processes takes the
    machine. Raises what the first that failed has raised.
    """
    ready = Barrier(len(waiting))
    with ThreadPoolExecutor(len(waiting)) as pool:
        ended = {name: pool.submit(_run, running, ready) for name, running in waiting.items()}
    broken = [e.exception() for e in ended.values()]
    for error in broken:
        if error is not None and not isinstance(error, BrokenBarrierError):
            raise error
    return {name: e.result() for name, e in ended.items()}


def _run(running: Rehearsal, ready: Barrier) -> RehearsalRecord:
    all_ready = running._all_ready

    def everybody_ready() -> None:
        all_ready()
        ready.wait(running.system.deployment.patience)

    running._all_ready = everybody_ready  # type: ignore[method-assign]
    try:
        with running:
            return running.run()
    except BaseException:
        ready.abort()
        raise


def rehearse(scenario: str, deployment: str, changes: Sequence[str], folder: Path) -> Rehearsed:
    system, running = prepared(scenario, deployment, changes, folder)
    with running:
        ended = running.run()
    return collect(system, ended, folder)


def sockets(system_nodes: Sequence[str], folder: Path, bus: str = "net") -> list[str]:
    """Settings: nodes listen on sockets in a folder, so that tests do not meet."""
    return [
        f'deploy.buses.{bus}.options.listen.{n}="unixsock-stream/{folder}/{n}"'
        for n in system_nodes
    ]
