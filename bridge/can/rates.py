"""Response times of a layout of messages on a simulated bus, and the rate it can reach."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from bridge.can.messages import BusMessage
from cosim.bus.accounting import accounts
from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, QueueKind
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import Bits, BusTiming, mean, padded, worst
from cosim.bus.traffic import PeriodicSource, merged

PS = 10**12
#: How much of the bus is simulated: so many of the longest period, s, within limits.
PERIODS, LEAST, MOST = 5.0, 0.2, 5.0
_BLOCK = 4096


@dataclass(frozen=True, slots=True)
class ControlRate:
    """The rate, Hz, at which all messages of a control cycle are transmitted, with all other
    traffic.

    `frames`: number in a cycle. `mean`: with random data; `worst`: with the most stuff bits in
    every frame.
    """

    frames: int
    mean: float
    worst: float


def control_rate(messages: Sequence[BusMessage], timing: BusTiming) -> ControlRate | None:
    """The reachable control rate of one bus, Hz; None without a periodic message.

    The messages of a control cycle are those of the shortest period: commands and replies. The
    others keep their periods and take their share of the bus.
    """
    periodic = [m for m in messages if m.period]
    if not periodic:
        return None
    fastest = min(m.period for m in periodic if m.period)
    cycle = [m for m in periodic if m.period is not None and m.period < 1.001 * fastest]
    others = [m for m in periodic if m not in cycle]

    def rate(bits: Callable[[BusMessage], Bits]) -> float:
        room = 1.0 - sum(timing.time_ns(bits(m)) * 1e-9 / (m.period or inf) for m in others)
        return max(room, 0.0) / sum(timing.time_ns(bits(m)) * 1e-9 for m in cycle)

    return ControlRate(
        len(cycle),
        rate(lambda m: mean(m.length, m.kind, m.identifier)),
        rate(lambda m: worst(m.length, m.kind)),
    )


def simulated_worst(
    messages: Sequence[BusMessage], timing: BusTiming, seed: int = 0
) -> Mapping[tuple[bool, int], float]:
    """The worst simulated response time, s, by (extended, identifier), up to the intermission.

    All messages are requested at the same time first, those of a node in the order given, and then
    with their periods; data is random. Messages without a period are requested once. One more node
    acknowledges. What is not sent within five periods of the slowest message (at most 5 s) is left
    out.
    """
    names = list(dict.fromkeys(m.node for m in messages))
    longest = max((m.period or 0.0 for m in messages), default=0.0)
    until = round(min(max(PERIODS * longest, LEAST), MOST) * PS)
    sources = [
        PeriodicSource(
            names.index(m.node),
            BusFrame(m.identifier, bytes(padded(m.length, m.fd)), m.kind),
            round((m.period or 2 * MOST) * PS),
            seed=seed + i,
            random_data=True,
        )
        for i, m in enumerate(messages)
    ]
    rows, queues = merged(sources, 0, until), {m.node: m.queue for m in messages}
    bus = SimulatedBus(
        timing,
        [
            BusNodeSettings(name, queues.get(name, QueueKind.SORTED), inbox=_BLOCK)
            for name in (*names, "listener")
        ],
        seed=seed,
        record=(BusEvent.STARTED, BusEvent.SENT, BusEvent.ERROR, BusEvent.DROPPED),
    )
    events = []
    for first in range(0, len(rows), _BLOCK):
        block = rows[first : first + _BLOCK]
        bus.request_many(block)
        events.append(bus.advance(int(block["at"][-1])))
    events.append(bus.advance(until))
    gap = 3 * timing.bit_ns * 1e-9
    found = accounts(rows, np.concatenate(events))
    return {(a.extended, a.identifier): a.worst / PS + gap for a in found if a.sent}
