"""Links on simulated CAN buses: simulated and analyzed response times, and losses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cosim.checks.finding import Finding
from cosim.links.table import DrawnTable
from cosim.links.traces import BusDelays
from cosim.predict.system import AnalyzedSystem


def lost_frames(system: AnalyzedSystem) -> Iterator[Finding]:
    """Frames that did not arrive within the run."""
    for name, law in _on_buses(system):
        lost = int(law.known["lost"])
        if lost:
            yield Finding(
                rule="bus-loss",
                severity="warning",
                where=f"links.{name}",
                number=float(lost),
                unit="1",
                reason=f"{lost} of {law.known['frames']} frames {law.known['identifier']} on bus"
                f" {law.known['bus']} do not arrive before the run ends",
                advice="lower the load, raise the bit rate, or lengthen the transmit queue",
            )


def simulated_response(system: AnalyzedSystem) -> Iterator[Finding]:
    """The worst response time that was simulated, and the worst case of the analysis."""
    for name, law in _on_buses(system):
        known, bound = law.known, law.known["analysed_worst"]
        said = (
            f"at most {bound * 1e3:.4g} ms by analysis"
            if bound is not None
            else "without a bound by analysis (other traffic, errors, other queues, or overload)"
        )
        yield Finding(
            rule="bus-response",
            severity="note",
            where=f"links.{name}",
            number=law.maximum,
            unit="s",
            reason=f"frame {known['identifier']} on bus {known['bus']}, simulated ahead of the run"
            f" with {_data(known)} data: at most {law.maximum * 1e3:.4g} ms, {said}",
        )


def _data(known: Mapping[str, Any]) -> str:
    """The data of the frames: random also where the run has the values of signals instead."""
    return "zero" if known["data"] == "zeros" else "random"


def _on_buses(system: AnalyzedSystem) -> Iterator[tuple[str, BusDelays]]:
    for link in system.plan.links:
        if isinstance(link.table, DrawnTable) and isinstance(link.table.law, BusDelays):
            yield link.name, link.table.law
