"""Pre-flight: checks of a scenario before it runs, with advice.

``check(scenario, plan)`` gives findings, worst first. Rules are functions of a
:class:`cosim.predict.system.AnalyzedSystem`, a file a subject:

=============  ====================================================================
``reach``      is every controller reached from the operator's arm; unconnected ones
``sampling``   sampling periods against inertia and adaptation; stiff grips and walls
``laws``       passivity, degenerate gains, gravity, what can be predicted
``buses``      links on simulated CAN buses
``couplings``  springs between robots: damping for the delay, constant delays
``channels``   links: bounded delays, losses, order, buffers
``limits``     joints outside of their limits, links with doubtful numbers
``wiring``     unconnected inputs, saturation, size of what is recorded
=============  ====================================================================

Nothing is run, and nothing here stops a run.
"""

from __future__ import annotations

from cosim.checks.finding import Finding, Severity
from cosim.checks.preflight import check

__all__ = ["Finding", "Severity", "check"]
