"""The account of a CAN bus as text: load, response times, lost frames, nodes that are bus-off."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.bus.accounting import BusHistory, accounts, losses, waits
from cosim.bus.frames import BusEvent, ControllerState
from cosim.bus.transmissions import busy_share, transmissions
from cosim.reporting.bus_timeline import draw_timeline

#: The load is also that of the busiest window of this length, ps.
WINDOW_PS = 10**11
_MOST = 10


def account_lines(bus: BusHistory, begin_ps: int, end_ps: int) -> Iterator[str]:
    """The account of a bus from `begin_ps` to `end_ps` (ps), line by line: of the requests then.

    `bus` has all its events up to the end.
    """
    if end_ps <= begin_ps:
        yield "no time has passed"
        return
    busy = transmissions(bus.events, bus.timing, end_ps)
    share = busy_share(busy, begin_ps, end_ps, end_ps - begin_ps)[0]
    windows = busy_share(busy, begin_ps, end_ps, min(WINDOW_PS, end_ps - begin_ps))[:, 0]
    yield (
        f"{(end_ps - begin_ps) / 1e12:.3f} s: load {share[0]:.1%}, of that {share[1]:.1%} by "
        f"failed attempts; highest in 0.1 s {windows.max():.1%}"
    )
    requests, events = _since(bus.requests, bus.events, begin_ps)
    if len(requests):
        yield from _identifiers(requests, events)
    for loss in losses(requests, events, busy)[:_MOST] if len(requests) else ():
        by = max(loss.blocked_by, key=lambda n: loss.blocked_by[n], default=-1)
        who = f"; the bus had mostly {bus.names[by]}" if by >= 0 else ""
        where = f"{loss.cause.name} at {bus.names[loss.node]}"
        yield f"lost at {loss.time_ps / 1e12:.6f} s: {where}{who}"
    off = events[(events["kind"] == BusEvent.STATE) & (events["code"] == ControllerState.OFF)]
    for row in off[:_MOST]:
        yield f"bus-off at {row['time'] / 1e12:.6f} s: {bus.names[row['node']]}"


def _since(
    requests: NDArray[np.void], events: NDArray[np.void], begin_ps: int
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """The requests from a time (ps) on and what became of them, numbered from 0."""
    kept = requests["at"] >= begin_ps
    number = np.append(np.cumsum(kept) - 1, -1)  # the last entry is for events of no request
    mine = events[np.append(kept, True)[events["request"]]].copy()
    mine["request"] = number[mine["request"]]
    return requests[kept], mine


def _identifiers(requests: NDArray[np.void], events: NDArray[np.void]) -> Iterator[str]:
    yield "identifier    sent  failed  lost   mean     99 %    worst   response time, ms"
    for a in accounts(requests, events):
        name = f"{a.identifier:08X}" if a.extended else f"{a.identifier:03X}"
        ms = [t / 1e9 for t in (a.mean, a.quantile(0.99), a.worst)]
        lost = sum(a.lost.values())
        yield (
            f"{name:<10} {a.sent:>7} {a.errors:>7} {lost:>5} "
            f"{ms[0]:>8.3f} {ms[1]:>8.3f} {ms[2]:>8.3f}"
        )


def draw_account(path: Path, bus: BusHistory, begin_ps: int, end_ps: int) -> Path:
    """Draw a bus from `begin_ps` to `end_ps` (ps). Raises RunError."""
    busy = transmissions(bus.events, bus.timing, end_ps)
    labels = {i: f"{row['frame']['id']:X}" for i, row in enumerate(bus.requests)}
    waiting = [w for w in waits(bus.requests, bus.events) if w[2] > begin_ps and w[1] < end_ps]
    return draw_timeline(path, busy, bus.names, begin_ps, end_ps, labels=labels, waiting=waiting)
