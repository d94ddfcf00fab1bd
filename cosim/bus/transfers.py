"""Messages of several frames on a simulated bus, one after the other: when each has arrived.

The sender is node 0 and the receiver node 1; other traffic is sent by nodes of its own. A message
begins when the sender passes it on, or when the one before has arrived.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.bus.arbitration import rank
from cosim.bus.fragments import flow_controls
from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, QueueKind
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import Bits, BusTiming, FrameFormat, TimingError, best, worst
from cosim.bus.traffic import PeriodicSource, merged

#: Traffic is requested for so much time at once, ps.
_AHEAD = 10**10
#: A message that has not arrived by then is on an overloaded bus, ps.
_GIVE_UP = 10 * 10**12
#: No node answers a frame quicker, ps: a frame that is answered is looked for that often.
LOOK = 10**7


@dataclass(frozen=True, slots=True)
class OtherMessage:
    """A message of other nodes: identifier, bytes, and its period, ps."""

    identifier: int
    length: int
    period_ps: int
    extended: bool = False


@dataclass(frozen=True, slots=True)
class IsoTpSettings:
    """The flow of ISO-TP: identifier of flow controls, least gap `stmin_ps` between consecutive
    frames, frames in a block (0: no limit), and the time that a node needs to answer, ps.
    """

    identifier: int
    stmin_ps: int = 0
    block: int = 0
    answer_ps: int = 50 * 10**6


@dataclass(frozen=True, slots=True)
class Transfer:
    """A message as frames of one identifier: bytes of each, and the bus with its other traffic.

    `isotp`: with flow control; None: all frames are handed over at once.
    """

    timing: BusTiming
    identifier: int
    lengths: tuple[int, ...]
    extended: bool = False
    others: tuple[OtherMessage, ...] = ()
    isotp: IsoTpSettings | None = None

    def __post_init__(self) -> None:
        """Refuse frames that CAN does not have, two messages of one identifier, and answers that
        are quicker than the simulation looks. Raises TimingError.
        """
        BusFrame(self.identifier, bytes(max(self.lengths)), self.format)
        for o in self.others:
            BusFrame(o.identifier, bytes(o.length), replace(self.format, extended=o.extended))
        ranks = [self._rank, *(rank(o.identifier, o.extended) for o in self.others)]
        if self.isotp is not None:
            ranks.append(rank(self.isotp.identifier, self.extended))
            if self.isotp.answer_ps < LOOK:
                raise TimingError(
                    f"found an answer after {self.isotp.answer_ps / 1e6:g} us, expected at least "
                    f"{LOOK / 1e6:g} us"
                )
        if len(set(ranks)) < len(ranks):
            raise TimingError("found one identifier in two messages, expected one for each")

    @property
    def _rank(self) -> int:
        return rank(self.identifier, self.extended)

    @property
    def format(self) -> FrameFormat:
        """The format of its frames."""
        fd = self.timing.fd
        return FrameFormat(self.extended, fd=fd, brs=fd and self.timing.data_bitrate is not None)

    # ---- bounds ------------------------------------------------------------------------------

    @property
    def shortest_ps(self) -> int:
        """No message takes less, ps: frames without stuff bits on a free bus."""
        frames = sum(self.time_ps(best(n, self.format)) for n in self.lengths)
        if self.isotp is not None:
            controls, gaps = self._flow()
            answer = self.time_ps(best(8, self.format)) + 2 * self.isotp.answer_ps
            frames += controls * answer + gaps * self.isotp.stmin_ps
            frames -= 4 * self.bit_ps * (controls + len(self.lengths))
        return max(0, frames - 4 * self.bit_ps)

    @property
    def longest_ps(self) -> int | None:
        """No message takes longer, ps, as long as the one before has arrived; None: overload.

        Without flow control the last frame waits for at most one of lower priority, for the frames
        before it, and for what has a higher priority meanwhile. With it each frame waits by itself.
        """
        times = [self.time_ps(worst(n, self.format)) for n in self.lengths]
        if self.isotp is None:
            waited = self._waits(self._rank, sum(times[:-1]))
            return None if waited is None else waited + times[-1]
        controls, _ = self._flow()
        single = self._waits(self._rank, 0)
        control = self._waits(rank(self.isotp.identifier, self.extended), 0)
        if single is None or control is None:
            return None
        answer = control + self.time_ps(worst(8, self.format)) + 2 * self.isotp.answer_ps
        gaps = (len(self.lengths) - 1) * self.isotp.stmin_ps
        return sum(times) + len(times) * single + controls * answer + gaps

    def _flow(self) -> tuple[int, int]:
        """Numbers of flow controls, and of gaps between two consecutive frames of one block."""
        assert self.isotp is not None
        controls = flow_controls(len(self.lengths), self.isotp.block)
        return controls, max(0, len(self.lengths) - 1 - controls)

    def _waits(self, own: int, before: int) -> int | None:
        """The longest wait of the last frame behind `before` (ps) of its own message, ps."""
        above = [o for o in self.others if rank(o.identifier, o.extended) < own]
        below = [self._other(o) for o in self.others if rank(o.identifier, o.extended) > own]
        blocking, waits, last = max(below, default=0), 0, -1
        while waits != last:
            last = waits
            waits = blocking + before
            waits += sum(-(-(last + self.bit_ps) // o.period_ps) * self._other(o) for o in above)
            if waits > _GIVE_UP:
                return None
        return waits

    def _other(self, message: OtherMessage) -> int:
        kind = replace(self.format, extended=message.extended)
        return self.time_ps(worst(message.length, kind))

    @property
    def bit_ps(self) -> int:
        """A nominal bit, ps."""
        return round(1e12 / self.timing.bitrate)

    def time_ps(self, bits: Bits) -> int:
        """The time of so many bits, ps."""
        rate = self.timing.data_bitrate or self.timing.bitrate
        return round(bits.nominal * 1e12 / self.timing.bitrate + bits.data * 1e12 / rate)


@final
@dataclass(slots=True)
class TransferSimulation:
    """Messages of a :class:`Transfer` on a bus with its traffic, whose data `seed` draws.

    `phases_ps`: of the other messages, in their order. `sent`: every frame of the transfer, as
    (arrival in ps, identifier, bytes), if `keeps`.
    """

    transfer: Transfer
    phases_ps: Sequence[int] = ()
    seed: int = 0
    keeps: bool = False
    sent: list[tuple[int, int, int]] = field(default_factory=list)
    _bus: SimulatedBus = field(init=False)
    _sources: list[PeriodicSource] = field(init=False)
    _fed: int = 0
    _free: int = 0
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        t = self.transfer
        names = ["sender", "receiver", *(f"other {i}" for i in range(len(t.others)))]
        nodes = [BusNodeSettings(name, QueueKind.FIFO, inbox=4096) for name in names]
        self._bus = SimulatedBus(t.timing, nodes, seed=self.seed, record=(BusEvent.RECEIVED,))
        phases = list(self.phases_ps) or [0] * len(t.others)
        self._sources = [
            PeriodicSource(
                2 + i,
                BusFrame(o.identifier, bytes(o.length), replace(t.format, extended=o.extended)),
                o.period_ps,
                offset_ps=phases[i],
                seed=self.seed + i,
                random_data=True,
            )
            for i, o in enumerate(t.others)
        ]
        self._rng = np.random.default_rng(self.seed)

    def deliver(self, at_ps: int) -> int:
        """The arrival time, ps, of a message that the sender passes on at `at_ps`.

        Raises TimingError if it does not arrive within 10 s.
        """
        t = self.transfer
        at = max(at_ps, self._free)
        if t.isotp is None:
            self._free = self._send(0, at, t.identifier, t.lengths)
        else:
            self._free = self._flowing(at, t.isotp)
        return self._free

    def _flowing(self, at: int, flow: IsoTpSettings) -> int:
        """The arrival of the last frame of an ISO-TP message, ps."""
        identifier, (first, *rest) = self.transfer.identifier, self.transfer.lengths
        arrived = self._send(0, at, identifier, (first,))
        size = flow.block or len(rest)
        for start in range(0, len(rest), size or 1):
            block, before = rest[start : start + size], arrived
            control = self._send(1, arrived + flow.answer_ps, flow.identifier, (8,))
            ready = control + flow.answer_ps
            if start:
                ready = max(ready, before + flow.stmin_ps)
            # frames without a gap wait together in the queue of the node
            parts = [tuple(block)] if not flow.stmin_ps else [(n,) for n in block]
            for part in parts:
                arrived = self._send(0, ready, identifier, part)
                ready = arrived + flow.stmin_ps
        return arrived

    def _send(self, node: int, at: int, identifier: int, lengths: Sequence[int]) -> int:
        """The arrival of the last of some frames that are handed over together, ps."""
        t = self.transfer
        self._feed(at)
        for n in lengths:
            frame = BusFrame(identifier, self._rng.bytes(n), t.format)
            request = self._bus.request(node, at, frame)
        look = at + sum(t.time_ps(best(n, t.format)) for n in lengths) - 8 * t.bit_ps
        every = LOOK if t.isotp is not None else 10 * LOOK
        while look < at + _GIVE_UP:
            self._feed(look)
            if found := self._arrival(request, 1 - node, self._bus.advance(look)):
                return found
            look += every
        raise TimingError("found a message that does not arrive within 10 s: the bus is overloaded")

    def _arrival(self, request: int, node: int, events: NDArray[np.void]) -> int:
        """The time at which a frame is received at a node, ps; 0: not among these events."""
        found = 0
        mine = (self.transfer.identifier, self.transfer.isotp and self.transfer.isotp.identifier)
        for event in events[(events["node"] == node) & (events["request"] >= 0)]:
            frame = self._bus.frame(event)
            if self.keeps and frame.identifier in mine:
                self.sent.append((int(event["time"]), frame.identifier, frame.length))
            if event["request"] == request:
                found = int(event["time"])
        return found

    def _feed(self, until: int) -> None:
        """Request the other traffic up to `until` (ps) and some time ahead."""
        if until < self._fed or not self._sources:
            return
        ahead = until + _AHEAD
        self._bus.request_many(merged(self._sources, self._fed, ahead))
        self._fed = ahead
