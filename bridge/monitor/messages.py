"""Data that a passive listener has received: last heartbeats of nodes, and messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.carried import Carried
from bridge.native import message as native
from bridge.native.frame import Frame
from bridge.native.message import (
    Decoded,
    E2EProfile,
    Header,
    Message,
    Receiver,
    accept,
    carries_state,
    is_preview,
)
from bridge.native.safety import LifeState, Status, Why
from bridge.safety.limits import REASONS, names

#: What is counted is that of the last second, ns.
SPAN_NS = 10**9
#: Of samples that were sent before t = 0.
NO_STAMP = -1


@dataclass(slots=True)
class Beat:
    """The last heartbeat of a node; `t_ns`: its arrival, monotonic, -1: none yet."""

    message: Message
    t_ns: int = -1
    state: str = ""
    reasons: tuple[str, ...] = ()
    boots: int = 0
    armed: bool = False

    def decode(self, frame: Frame) -> bool:
        """Decode a heartbeat; return whether the node has restarted since the previous one."""
        values, header = np.zeros(4), Header()
        if native.decode(self.message, frame, values.ctypes.data, header) is not Decoded.OK:
            return False
        state, reasons, boots, armed = (int(v) for v in values)
        again = self.t_ns >= 0 and boots != self.boots
        self.t_ns, self.boots, self.armed = int(frame.t_ns), boots, bool(armed)
        self.state = _state(state)
        self.reasons = tuple(REASONS.get(bit, bit.name or "") for bit in Why(reasons))
        return again


@dataclass(frozen=True, slots=True)
class HeardSample:
    """`t_ns`: of arrival; `values` (n,).

    `stamp_us`: the sender's, modulo what its bits hold, or NO_STAMP.
    """

    t_ns: int
    stamp_us: int
    values: NDArray[np.float64]


@dataclass(slots=True)
class ReceivedMessage:
    """A message: samples of the last second, and what has not been one; `t_ns`: of the last."""

    carried: Carried
    values: NDArray[np.float64]
    receiver: Receiver
    recent: deque[HeardSample] = field(default_factory=deque)
    status: int = 0
    t_ns: int = -1

    @classmethod
    def of(cls, carried: Carried) -> ReceivedMessage:
        """Nothing of it has come: NaN."""
        receiver = native.receiver(carried.period_ns, E2EProfile(carried.encoding.message.e2e))
        return cls(carried, np.full(carried.outlet.width, np.nan), receiver)

    @property
    def message(self) -> Message:
        """The message as C sees it."""
        return self.carried.encoding.message

    @property
    def lost(self) -> int:
        """By its counter, since the listener came; without one: 0."""
        return int(self.receiver.lost)

    @property
    def refused(self) -> Mapping[str, int]:
        """Frames that were no sample, by why."""
        r = self.receiver
        counts = {"CRC": r.crc, "length": r.length, "range": r.range, "not finite": r.invalid}
        counts |= {"repeated": r.repeated, "older": r.reordered}
        return {why: int(n) for why, n in counts.items() if n}

    def decode(self, frame: Frame) -> None:
        """Decode a frame of the message: values, status and counter."""
        header, values = Header(), np.full_like(self.values, np.nan)
        found = native.decode(self.message, frame, values.ctypes.data, header)
        if found is not Decoded.OK:
            self._refuse(found)
        if found not in (Decoded.OK, Decoded.INVALID):
            return
        t, stamp = int(frame.t_ns), int(header.t_us)
        if is_preview(self.message, header.status):
            stamp = NO_STAMP
            self.receiver.sequence = -1  # its counter begins with the run
        elif self.message.e2e and not self._counted(header.counter, t):
            return
        self.status, self.t_ns = int(header.status), t
        if found is Decoded.OK:
            self.values = values
            self.recent.append(HeardSample(t, stamp, values))

    def _counted(self, counter: int, t: int) -> bool:
        """True if it is new. A listener does not know t = 0: the first frame is taken to be late
        by a quarter of a turn of the counter, so that faster ones may follow.
        """
        r = self.receiver
        if r.sequence < 0:
            r.lead_ns = 0
            r.offset_ns = t - (counter + (1 << r.counter_bits) // 4) * r.period_ns
        return accept(r, counter, t) >= 0

    def _refuse(self, why: Decoded) -> None:
        r = self.receiver
        match why:
            case Decoded.CRC:
                r.crc += 1
            case Decoded.LENGTH:
                r.length += 1
            case Decoded.RANGE:
                r.range += 1
            case _:
                r.invalid += 1

    def forget(self, now_ns: int) -> None:
        """Samples older than a second at `now_ns`."""
        while self.recent and self.recent[0].t_ns <= now_ns - SPAN_NS:
            self.recent.popleft()

    def renew(self) -> None:
        """Its sender has begun again, and may count and stamp anew."""
        self.receiver.sequence = -1
        self.recent.clear()

    @property
    def late(self) -> NDArray[np.float64]:
        """Transit of the samples of the last second beyond that of the fastest, (n,), s.

        By their stamps: the clocks need not agree. Without stamps: (0,).
        """
        bits = _time_bits(self.message)
        stamped = [s for s in self.recent if s.stamp_us != NO_STAMP]
        if not bits or not stamped:
            return np.zeros(0)
        arrived = np.array([s.t_ns for s in stamped]) // 1000
        stamps = np.array([s.stamp_us for s in stamped], dtype=np.int64)
        lead, turn = arrived - stamps, 1 << bits
        lead = (lead - lead[0] + turn // 2) % turn - turn // 2
        return np.asarray((lead - lead.min()) * 1e-6, dtype=np.float64)

    def sender(self) -> str:
        """State and flags of the sender; a status of 4 bits (classic CAN) contains no state."""
        if self.message.status < 0 or self.t_ns < 0:
            return ""
        state = [_state(self.status & Status.LIFE)] if carries_state(self.message) else []
        return " ".join((*state, *names(Status(self.status & ~Status.LIFE & 0xFF))))


def _time_bits(message: Message) -> int:
    return int(message.header[message.time].length) if message.time >= 0 else 0


def _state(number: int) -> str:
    known = {int(s): s for s in LifeState}
    return known[number].name.lower() if number in known else f"{number}?"
