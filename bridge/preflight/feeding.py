"""The time between two frames that feed a drive's own watchdog, in each phase of a node, and the
time until a node hears that a drive is not enabled any more.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

from bridge.deployment.drive_sequences import Foreign, commanded_drives, feed_ns
from bridge.deployment.services import BEATS
from bridge.deployment.system import System
from cosim.checks import Finding

#: s between two looks of a node at its drives before its first slot.
IDLE = 0.005
#: Share of its watchdog after which a drive has to be fed again at the latest.
SHARE = 0.5


def feeding_periods(system: System, node: str, drive: Foreign) -> dict[str, float]:
    """Phases of a node, and the time between two frames in it that feed a drive, s; none: {}.

    ``before the start``: from the first enabling frame to the first slot; ``in the run``: also
    while the torque is ramped down.
    """
    plan, h = system.nodes[node], system.nodes[node].plan.h
    if drive.profile.watchdog.fed_by == "heartbeat":
        beat = system.services[drive.bus].timeout / BEATS
        return {"before the start": _rounded(beat, IDLE), "in the run": _rounded(beat, h)}
    if drive.profile.watchdog.fed_by not in ("frame", "torque"):
        return {}
    d = system.deployment
    sent = [
        system.messages[o.message].period_ns * 1e-9
        for o in plan.outlets
        if (d.messages[o.message].bus, d.messages[o.message].drive) == (drive.bus, drive.node)
    ]
    idle = feed_ns(commanded_drives(d, plan)) * 1e-9
    return {"before the start": _rounded(idle, IDLE), "in the run": min(sent)}


def _rounded(period: float, step: float) -> float:
    """A period that is kept in whole steps, s."""
    return ceil(period / step * (1 - 1e-12)) * step


def feeding(system: System) -> Iterator[Finding]:
    """Drives that are fed later than at half of their watchdog, which is an error."""
    for node, plan in system.nodes.items():
        for drive in commanded_drives(system.deployment, plan):
            timeout = drive.profile.timeout
            for phase, period in feeding_periods(system, node, drive).items():
                if period <= SHARE * timeout * (1 + 1e-9):
                    continue
                yield Finding(
                    rule="watchdog",
                    severity="error",
                    where=f"{drive.name} of {node}",
                    number=period,
                    unit="s",
                    reason=f"is fed every {period * 1e3:g} ms {phase}, and its watchdog trips after"
                    f" {timeout * 1e3:g} ms ({drive.profile.path})",
                    advice=f"at most {SHARE * timeout * 1e3:g} ms, or watchdog = "
                    f'"{2 * period * 1e3:g} ms" of [drive]',
                )


def slow_states(system: System) -> Iterator[Finding]:
    """Drives that tell their state by themselves, later than at half of their watchdog: a warning.

    One that has tripped is sent torques until it tells so.
    """
    for node, plan in system.nodes.items():
        for drive in commanded_drives(system.deployment, plan):
            every, limit = drive.profile.status.every, SHARE * drive.profile.timeout
            if not every or not limit or every <= limit * (1 + 1e-9):
                continue
            yield Finding(
                rule="state",
                severity="warning",
                where=f"{drive.name} of {node}",
                number=every,
                unit="s",
                reason=f"tells its state every {every * 1e3:g} ms: when it has tripped, up to"
                f" {torques_until(every, plan.plan.h)} torques are sent to it",
                advice=f"set its {drive.profile.status.register or 'period'} to at most"
                f" {limit * 1e3:g} ms, and `every` in {drive.profile.path}",
            )


def torques_until(every: float, period: float) -> int:
    """Torques with this period (s) that a drive is sent until a state, `every` s, is obeyed."""
    return ceil(every / period * (1 - 1e-12)) + 1
