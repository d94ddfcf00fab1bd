"""A rehearsal in one figure: positions, torques, ages and lateness over time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bridge.monitor.journal_signals import JournalSignals, ages, lateness_names
from bridge.recording.live_run import LiveRun
from cosim.base.errors import ScenarioError
from cosim.reporting import figures
from cosim.reporting.figures import Figure, Panel
from cosim.schedule.parts import Slot


def draw(watched: LiveRun, path: Path, span: float | None = None) -> Path:
    """Draw what has been recorded so far into the PNG `path`; `span`: the last so many s.

    Raises ScenarioError where no node has a slot yet, RunError where it cannot be written.
    """
    rows = {node: r for node, r in watched.everything().items() if len(r)}
    if not rows:
        raise ScenarioError("no node has completed a slot", str(watched.folder))
    title = watched.system.scenario.title
    held = JournalSignals(watched.system, rows, span, gaps=True)
    return figures.draw(Figure(tuple(panels(watched)), title), held, path)


def panels(watched: LiveRun) -> Iterator[Panel]:
    """Positions, torques, ages of inputs and lateness of nodes: a panel of each that there is."""
    system = watched.system
    angles = [s for s in _outputs(watched, "continuous") if s.unit in ("rad", "m")]
    torques = [s for s in _outputs(watched, "discrete") if s.unit in ("N.m", "N")]
    for what, slots in (("positions", angles), ("commanded torques", torques)):
        if slots:
            yield Panel(tuple(s.name for s in slots), title=what)
    inlets = [i for node in system.nodes.values() for i in node.inlets]
    linked = [i.target.name for i in inlets if i.link is not None]
    if linked:
        yield _ages("age of what came over links", linked, "age", network=False)
    if inlets:
        first = {(i.message, i.component): i.target.name for i in reversed(inlets)}
        yield _ages("the network's part of it", [*first.values()], "age", network=True)
    nodes = tuple(system.nodes)
    yield Panel(lateness_names(nodes), title="lateness of slots", labels=nodes, ylabel="late")


def _ages(title: str, targets: list[str], ylabel: str, *, network: bool) -> Panel:
    names = ages(targets, network=network)
    return Panel(names, title=title, labels=tuple(targets), ylabel=ylabel)


def _outputs(watched: LiveRun, kind: str) -> list[Slot]:
    """Outputs of the continuous components, or of all others."""
    return [
        slot
        for step in watched.system.plan.components
        if (step.kind == "continuous") == (kind == "continuous")
        for slot in step.outputs
    ]
