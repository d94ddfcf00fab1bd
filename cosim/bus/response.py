"""Worst-case response times on a CAN bus with fixed priorities and without preemption.

Source: R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN)
schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35 (2007) 239-272. For
message m, with C transmission time, T period, J queueing jitter, B = max C of lower priorities and
τ_bit the bit time:

    busy period   t  = B + E(t) + Σ_{hep(m)} ceil((t + J_k) / T_k) C_k        (15), (14)
    instances     Q  = ceil((t + J_m) / T_m)                                  (16)
    queueing      w  = B + E(w + C_m) + q C_m + Σ_{hp(m)} ceil((w + J_k + τ_bit) / T_k) C_k
    response      R  = max_{q < Q} J_m + w(q) - q T_m + C_m                   (20), (21)

E(t) is the time lost to errors: each costs an error frame of at most 31 bits and a repetition of
the frame (section 5). Instances of a message are queued in their order. The analysis does not use
offsets: any two messages may be queued at the same instant. All numbers are integers in ns.

A stream without `queue` is of a node that sends its most urgent frame first. Streams with the same
`queue` share one that sends in the order of requests (many USB adapters, the default of Linux). For
these, after R. I. Davis, S. Kollmann, V. Pollex, F. Slomka, "Controller Area Network (CAN)
schedulability analysis with FIFO queues", ECRTS 2011: while a frame of queue M waits, each other
message of M is sent before it at most once, and all above the lowest of M, L, can be in between:

    waiting    w = B_L + E(w + C_m) + Σ_{M without m} C_j
                   + Σ_{hp(L), not M} ceil((w + J_k + f_k + τ_bit) / T_k) C_k
    response   R = J_m + w + C_m

This holds if each frame of M is sent before the next of its message is queued (R <= T for all of
M); otherwise there is no bound. For others, a frame in a FIFO queue has the additional jitter f, as
it competes for the bus only at the head of its queue; f <= w. It is repeated until no f grows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from cosim.bus.timing import TimingError

#: Bits of an error frame with everything that may come before the next frame.
ERROR_BITS = 31


@dataclass(frozen=True, slots=True)
class FrameStream:
    """Frames of one identifier: ns each; `rank` as in :func:`cosim.bus.arbitration.rank`.

    `queue`: the name of the FIFO queue in which they wait; "": a queue by priority.
    """

    name: str
    rank: int
    period: int
    duration: int
    jitter: int = 0
    deadline: int | None = None
    queue: str = ""

    def __post_init__(self) -> None:
        if self.period <= 0 or self.duration <= 0 or self.jitter < 0:
            raise TimingError(
                f"{self.name}: found period {self.period}, duration {self.duration} and jitter"
                f" {self.jitter} ns, expected more than 0, more than 0 and at least 0"
            )


@dataclass(frozen=True, slots=True)
class Errors:
    """At most `burst` errors at the same time, and one more in every `interval` ns (0: no more)."""

    burst: int = 0
    interval: int = 0

    def within(self, t: int) -> int:
        """The greatest number of errors in `t` ns."""
        return self.burst + (-(-t // self.interval) if self.interval else 0)


NO_ERRORS = Errors()


@dataclass(frozen=True, slots=True)
class Response:
    """The worst response of a stream: `worst` ns from its event to its end, None: no bound.

    `waiting`: how long a frame in a FIFO queue can wait for the bus, ns; 0 in other queues.
    """

    stream: FrameStream
    worst: int | None
    instances: int
    waiting: int = 0

    @property
    def deadline(self) -> int:
        """The limit of the response time, ns: the period if no deadline is given."""
        return self.stream.period if self.stream.deadline is None else self.stream.deadline

    @property
    def meets_deadline(self) -> bool:
        """True if it is always there in time."""
        return self.worst is not None and self.worst <= self.deadline


def responses(
    streams: Sequence[FrameStream], bit_ns: int, errors: Errors = NO_ERRORS
) -> tuple[Response, ...]:
    """The worst-case response time of every stream, in order of priority.

    Raises TimingError if two streams have the same rank, because their order is then undefined.
    """
    ordered = sorted(streams, key=lambda s: s.rank)
    for a, b in pairwise(ordered):
        if a.rank == b.rank:
            raise TimingError(f"found the priority of {a.name} at {b.name}, expected different")
    hidden: dict[FrameStream, int | None] = {s: 0 for s in ordered}
    while True:
        found = tuple(
            (_fifo_response if s.queue else _response)(ordered, i, bit_ns, errors, hidden)
            for i, s in enumerate(ordered)
        )
        late = {r.stream.queue for r in found if r.worst is None or r.worst > r.stream.period}
        found = tuple(
            Response(r.stream, None, 0) if r.stream.queue and r.stream.queue in late else r
            for r in found
        )
        grown = {r.stream: None if r.stream.queue and r.worst is None else r.waiting for r in found}
        if grown == hidden:
            return found
        hidden = grown


#: How long a frame is hidden in its FIFO queue at most, ns; None: no bound.
_Hidden = Mapping[FrameStream, int | None]


def _fifo_response(
    ordered: Sequence[FrameStream], i: int, bit_ns: int, errors: Errors, hidden: _Hidden
) -> Response:
    own = ordered[i]
    mates = [s for s in ordered if s.queue == own.queue]
    lowest = ordered.index(mates[-1])
    above = [s for s in ordered[:lowest] if s.queue != own.queue]
    blocking = max((s.duration for s in ordered[lowest + 1 :]), default=0)
    cost = ERROR_BITS * bit_ns + max(s.duration for s in ordered[: lowest + 1])
    before = sum(s.duration for s in mates) - own.duration
    if any(hidden[s] is None for s in above):
        return Response(own, None, 0)
    w, last = blocking + before, -1
    while w != last and w <= own.period:
        last = w
        w = blocking + before + errors.within(w + own.duration) * cost
        w += _queued(above, last + bit_ns, hidden)
    return Response(own, own.jitter + w + own.duration, 1, w)


def _response(
    ordered: Sequence[FrameStream], i: int, bit_ns: int, errors: Errors, hidden: _Hidden
) -> Response:
    own, above = ordered[i], ordered[:i]
    blocking = max((s.duration for s in ordered[i + 1 :]), default=0)
    cost = ERROR_BITS * bit_ns + max(s.duration for s in ordered[: i + 1])
    if _diverges(ordered[: i + 1], cost, errors) or any(hidden[s] is None for s in above):
        return Response(own, None, 0)

    def lost(t: int) -> int:
        return errors.within(t) * cost

    busy, before = own.duration, -1
    while busy != before:
        before = busy
        busy = blocking + lost(busy) + _queued(ordered[: i + 1], busy, hidden)
    instances = -(-(busy + own.jitter) // own.period)
    worst, w = 0, blocking
    for q in range(instances):
        before = -1
        while w != before:
            before = w
            w = blocking + lost(w + own.duration) + q * own.duration
            w += _queued(above, before + bit_ns, hidden)
        worst = max(worst, own.jitter + w - q * own.period + own.duration)
        w += own.duration
    return Response(own, worst, instances)


def _queued(streams: Sequence[FrameStream], t: int, hidden: _Hidden) -> int:
    """The greatest bus time that streams can request in `t` ns."""
    return sum(-(-(t + s.jitter + (hidden[s] or 0)) // s.period) * s.duration for s in streams)


def _diverges(streams: Sequence[FrameStream], cost: int, errors: Errors) -> bool:
    """True if they, and errors, ask for all of the bus or more; in integers."""
    shares = [(s.duration, s.period) for s in streams]
    if errors.interval:
        shares.append((cost, errors.interval))
    whole, asked = 1, 0
    for part, period in shares:
        asked, whole = asked * period + part * whole, whole * period
    return asked >= whole
