"""Pre-flight: checks of a scenario before it runs, with advice.

``check(scenario, plan)`` gives findings, worst first. Rules are functions of a
:class:`cosim.predict.system.AnalyzedSystem`, a file a subject:

================  =================================================================
``reachability``  robots: reached from the operator's arm, with senders, within their limits
``sampling``      sampling periods against inertia and adaptation; stiff grips and walls
``laws``          passivity, degenerate gains, gravity, what can be predicted
``channels``      links: bounded delays, losses, order, buffers, CAN buses, springs over them
``wiring``        unconnected inputs, saturation, size of what is recorded
================  =================================================================

Nothing is run, and nothing here stops a run.
"""

from __future__ import annotations

from cosim.checks.finding import Finding, Severity
from cosim.checks.preflight import check

__all__ = ["Finding", "Severity", "check"]
