"""Paths over CAN: two frames with our responder, or a question that a drive answers by itself.

The question of ours is a classic frame of 8 bytes: k (u32), 4 bytes 0. The answer::

    k u16    turn-round u16, us    received u32, us of the responder's monotonic clock

The responder rounds its time of reception up and the time of its answer down, so that the bounds of
the clocks hold; what is rounded is below 1 us each way. Little endian.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from bridge.can.interface import CanBusSpec
from bridge.can.plain import PlainBus
from bridge.native.frame import Flags, Frame
from bridge.ping.exchanges import Arrival, ReceivedAnswer
from cosim.base.clock import monotonic_ns
from cosim.base.errors import RunError, ScenarioError
from cosim.bus.timing import BusTiming, FrameFormat, frame_bits

#: Identifier of questions; that of answers is the next one.
ASK = 0x7F0
_QUESTION, _ANSWER = struct.Struct("<II"), struct.Struct("<HHI")
_WRAP = 1 << 32


@dataclass(frozen=True, slots=True)
class CanQuestion:
    """A frame that asks: `identifier`, `data`, or a `remote` one; `answer`: what answers it."""

    identifier: int
    data: bytes
    answer: int
    remote: bool = False

    @property
    def flags(self) -> int:
        """The flags of its frame."""
        extended = Flags.EXTENDED if self.identifier > 0x7FF else 0
        return int(extended | (Flags.REMOTE if self.remote else 0))

    def frame(self, data: bytes) -> Frame:
        """The frame with `data`; a remote frame has none."""
        return Frame.of(self.identifier, b"" if self.remote else data, self.flags)


def parse_question(ask: str, answer: str) -> CanQuestion:
    """The question in ``ID#DATA`` (hexadecimal, as candump and cansend write them; ``ID#R``: a
    remote frame).

    `answer`: identifier of the answer, hexadecimal. Raises ScenarioError.
    """
    found = re.fullmatch(r"([0-9A-Fa-f]{1,8})#(R|(?:[0-9A-Fa-f]{2}){0,8})", ask)
    if found is None or not re.fullmatch(r"[0-9A-Fa-f]{1,8}", answer):
        raise ScenarioError(
            f"found --ask {ask!r} --answer {answer!r}; expected ID#DATA or ID#R and ID, in "
            "hexadecimal, as 7FF#0100CC0000000000 and 011",
            "cosim ping can",
        )
    remote = found[2] == "R"
    data = b"" if remote else bytes.fromhex(found[2])
    return CanQuestion(int(found[1], 16), data, int(answer, 16), remote)


@final
class CanPath:
    """One end on a bus: sends frames like `question`, receives those of one identifier.

    `others`: frames of other identifiers; `others_ns`: how long they took on a bus of `timing`.
    """

    def __init__(
        self, spec: CanBusSpec, question: CanQuestion, hears: int, timing: BusTiming | None = None
    ) -> None:
        self._bus, self._question, self._hears = PlainBus(spec), question, hears
        self._timing = timing
        self.others, self.others_ns = 0, 0

    def send(self, data: bytes, to: object = None) -> None:
        """Send a frame with `data`. Raises RunError (a BusError) if the driver refuses it."""
        self._bus.send(self._question.frame(data))

    def receive(self, until_ns: int) -> Sequence[Arrival]:
        """The next frame of the identifier that is heard, if it comes before `until_ns`."""
        while True:
            found = self._bus.receive(until_ns)
            if found is None:
                return []
            frame = found.frame
            if frame.id == self._hears and not frame.flags & (Flags.REMOTE | Flags.ERROR):
                return [Arrival(frame.payload, found.t_ns, found.wake_ns)]
            if not frame.flags & Flags.ERROR:
                self.others += 1
                self.others_ns += 0 if self._timing is None else frame_ns(frame, self._timing)

    def close(self) -> None:
        """Close the bus."""
        self._bus.close()


def frame_ns(frame: Frame, timing: BusTiming) -> int:
    """The time that a frame occupies a bus, ns, with the stuff bits of its data."""
    flags = frame.flags
    fd = bool(flags & Flags.FD)
    kind = FrameFormat(
        extended=bool(flags & Flags.EXTENDED),
        fd=fd,
        brs=fd and bool(flags & Flags.BRS),
        remote=bool(flags & Flags.REMOTE),
    )
    data = b"" if kind.remote else frame.payload
    return timing.time_ns(frame_bits(frame.id, data, kind, frame.length if kind.remote else 0))


@final
class CanCodec:
    """Questions and answers of our own responder."""

    def __init__(self) -> None:
        self._last = -1

    def question(self, k: int, t1_ns: int) -> bytes:
        """The data of question `k`."""
        return _QUESTION.pack(k % _WRAP, 0)

    def answer(self, data: bytes, sent: int) -> ReceivedAnswer | None:
        """The answer in `data`; `sent`: questions sent so far, from which k is completed."""
        if len(data) != _ANSWER.size:
            return None
        low, turn, received = _ANSWER.unpack(data)
        latest = sent - 1
        k = latest - ((latest - low) % 65536)
        if self._last < 0:
            self._last = received
        self._last += (received - self._last + _WRAP // 2) % _WRAP - _WRAP // 2
        t2 = self._last * 1000
        return ReceivedAnswer(k, t2, t2 + turn * 1000)


@final
class DriveCodec:
    """A question that a drive answers without a number: an answer belongs to the last question."""

    def __init__(self, question: CanQuestion) -> None:
        self._data = question.data

    def question(self, k: int, t1_ns: int) -> bytes:
        """The data, always the same."""
        return self._data

    def answer(self, data: bytes, sent: int) -> ReceivedAnswer | None:
        """An answer to the last question."""
        return ReceivedAnswer(sent - 1)


@final
class CanResponder:
    """Answers questions of ours. `answered`: how many so far."""

    def __init__(self, path: CanPath) -> None:
        self._path = path
        self.answered = 0

    def serve(self, until_ns: int) -> None:
        """Answer what arrives before `until_ns` (monotonic)."""
        while monotonic_ns() < until_ns:
            for arrival in self._path.receive(until_ns):
                if len(arrival.data) == _QUESTION.size:
                    self._reply(arrival)

    def _reply(self, arrival: Arrival) -> None:
        k, _ = _QUESTION.unpack(arrival.data)
        received = -(-arrival.t_ns // 1000)
        turn = min(max(monotonic_ns() // 1000 - received, 0), 65535)
        try:
            self._path.send(_ANSWER.pack(k % 65536, turn, received % _WRAP))
        except RunError:
            return
        self.answered += 1


def transmission(question: CanQuestion, timing: BusTiming) -> tuple[float, float]:
    """The times of a question and an answer of 8 bytes 0 on a free bus, s."""
    asked = frame_ns(question.frame(question.data or bytes(8)), timing)
    answered = frame_ns(
        Frame.of(question.answer, bytes(8), Flags.EXTENDED if question.answer > 0x7FF else 0),
        timing,
    )
    return asked * 1e-9, answered * 1e-9


def can_lines(
    path: CanPath, question: CanQuestion, timing: BusTiming | None, median: float, took: float
) -> list[str]:
    """Lines on the time on the bus. `median`: of the round trips, s; `took`: s measured."""
    if timing is None:
        return [f"{path.others} other frames; --bitrate tells transmission from queueing"]
    asked, answered = transmission(question, timing)
    rest = median - asked - answered
    return [
        f"on the bus at {timing.bitrate:g} bit/s: question {1e6 * asked:.0f} us, answer "
        f"{1e6 * answered:.0f} us; the other {1e6 * rest:.0f} us of the median are queueing behind "
        "other frames, drivers and the other end, which cannot be separated from here",
        f"{path.others} other frames, {1e-7 * path.others_ns / max(took, 1e-9):.1f} % of the time",
    ]
