"""The outcome of a rehearsal: reports and journals of its nodes, replay, faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Note
from bridge.replay import replay
from bridge.results.findings import Evidence
from bridge.results.report import BusReport, NodeReport
from bridge.wiring.wiring import Rows
from cosim.measure.robustness import Robustness


@dataclass(frozen=True, slots=True)
class RehearsalOutcome:
    """The outcome of a rehearsal; `twin_rms`: of positions, by unit (rad, m); {}: not compared.

    `unanswered`: a sentence for each real drive that was off or did not answer its torques;
    `required`: the results of the scenario's requirements.
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
