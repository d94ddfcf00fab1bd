"""A rehearsal as plain data: verdict, nodes, faults, replay; what ``--json`` writes."""

from __future__ import annotations

from math import nan
from typing import Any

from bridge.deployment.system import System
from bridge.results.outcome import metrics
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport
from bridge.results.timeline import happenings
from bridge.results.verdict import judge
from cosim.base.copies import asdict
from cosim.measure import requirements
from cosim.record import Run


def as_data(system: System, outcome: RehearsalOutcome) -> dict[str, Any]:
    """Everything that the summary says, with lateness in us."""
    verdict, run = judge(system, outcome), Run.open(outcome.folder)
    replayed = outcome.replayed
    first = replayed.first if replayed is not None else None
    return {
        "folder": str(outcome.folder),
        "verdict": verdict.word.value,
        "exit_code": verdict.exit_code,
        "reasons": list(verdict.reasons),
        "happenings": [asdict(x) for x in happenings(system, outcome)],
        "metrics": {
            r.name: {"label": r.label, "value": r.value, "unit": r.unit, "parts": dict(r.parts)}
            for _, r in metrics(system, outcome, run)
            if r is not None
        },
        **({"requirements": found} if (found := requirements.as_data(outcome.required)) else {}),
        "nodes": {str(report.life): _node(report) for report in outcome.reports},
        "buses": {name: {"load": bus.load.mean()} for name, bus in outcome.buses.items()},
        "faults": [
            {"index": f.index, "kind": f.kind, "verdict": f.verdict, "text": f.text()}
            for f in outcome.faults
        ],
        **{f"twin_rms_{unit}": outcome.twin_rms.get(unit, nan) for unit in ("rad", "m")},
        "replay": {
            "exact": replayed is not None and first is None,
            "greatest": replayed.greatest if replayed is not None else None,
            "first": str(first) if first is not None else outcome.replay_error or None,
        },
    }


def _node(report: NodeReport) -> dict[str, Any]:
    late = report.lateness.late
    return {
        "slots": report.slots,
        "missed": report.lateness.missed,
        "end": str(report.end),
        "state": report.state,
        "reasons": list(report.reasons),
        "late_us": {
            "p50": late.p50 * 1e-3,
            "p99": late.p99 * 1e-3,
            "p99.9": late.p999 * 1e-3,
            "max": late.maximum * 1e-3,
        },
    }
