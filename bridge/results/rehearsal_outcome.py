"""The outcome of a rehearsal: reports and journals of its nodes, replay, faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bridge.deployment.system import System
from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Note
from bridge.replay import replay
from bridge.results.findings import Evidence
from bridge.results.report import BusReport, NodeReport
from bridge.wiring.wiring import Rows
from cosim.measure.robustness import Robustness


@dataclass(frozen=True, slots=True)
class ComponentFailure:
    """A component that failed at `t` (s), and the reason in a sentence."""

    t: float
    why: str


def failure_of(
    system: System, rows: Mapping[Life, Rows], reports: Sequence[NodeReport]
) -> ComponentFailure | None:
    """The first failure of a component, as of a plant that diverges; None: there is none.

    `rows` (slots,): the journal of each life. A node that was started again after it has none.
    """
    found = []
    for report in {r.life.node: r for r in reports}.values():
        why = report.statement.error if report.statement else ""
        component = why.partition(":")[0] in system.deployment.nodes[report.life.node].components
        if report.end is LifeEnd.FAILED and component and len(rows[report.life]):
            found.append(ComponentFailure(float(rows[report.life]["deadline_ns"][-1]) * 1e-9, why))
    return min(found, key=lambda failure: failure.t, default=None)


@dataclass(frozen=True, slots=True)
class RehearsalOutcome:
    """The outcome of a rehearsal; `twin_rms`: of positions, by unit (rad, m); {}: not compared.

    `unanswered`: a sentence for each real drive that was off or did not answer its torques;
    `required`: the results of the scenario's requirements; `twin_error`: why the twin failed.
    """

    folder: Path
    ticks: int
    rows: Mapping[Life, Rows]
    reports: Sequence[NodeReport]
    replayed: replay.ReplayReport | None
    replay_error: str
    twin_rms: Mapping[str, float]
    buses: Mapping[str, BusReport]
    notes: Sequence[Note]
    faults: Sequence[Evidence] = ()
    unanswered: Sequence[str] = ()
    required: Sequence[Robustness] = ()
    twin_error: str = ""

    @property
    def finished(self) -> bool:
        """True if every node came to the end of the run without a stop.

        Where an FMU ended the simulation, that is the end, and all others stop for it.
        """
        ends = {r.end for r in self.reports}
        whole = (
            {LifeEnd.ENDED, LifeEnd.FINISHED, LifeEnd.STOPPED}
            if LifeEnd.ENDED in ends
            else {LifeEnd.FINISHED}
        )
        return bool(ends) and ends <= whole
