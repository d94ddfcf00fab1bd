"""A rehearsal, a twin or a node that was cut short: its recording, made of the journals."""

from __future__ import annotations

from pathlib import Path

from bridge.deployment.system import load_system
from bridge.recording import run_folder as collecting
from bridge.recording.live_run import read_facts
from bridge.replay import replay
from cosim.base.clock import realtime_offset_ns
from cosim.base.errors import ScenarioError
from cosim.record.folder import NODES


def collect(folder: Path, into: Path) -> None:
    """Write trajectories, link tables and bus logs of the journals in `folder` into `into`.

    Raises ScenarioError if scenario and deployment are not at the paths recorded in the folder, or
    no node reached its first slot; RunError if a file cannot be written.
    """
    facts = read_facts(folder)
    system = load_system(facts.scenario, facts.deployment, facts.settings)
    rows = replay.load(folder / NODES)
    if not rows:
        raise ScenarioError("no node reached its first slot; nothing was recorded", str(folder))
    wall_ns = facts.wall_ns - facts.start_ns if facts.wall_ns else realtime_offset_ns()
    collecting.collect(system, rows, folder / NODES, into, wall_ns=wall_ns)
