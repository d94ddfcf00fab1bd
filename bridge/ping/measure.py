"""The loops of both ends: questions at their times, answers as they come; and a responder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bridge.ping.exchanges import Arrival, Exchanges, PingCodec, PingPath, ReceivedAnswer
from bridge.ping.packet import PingPacket, decode
from bridge.realtime.host_clock import HostClock, host_clock
from cosim.base.clock import monotonic_ns, realtime_offset_ns
from cosim.base.errors import RunError
from cosim.base.interrupts import act_on_signal, until_signal

#: How long to wait for the last answers, ns.
LINGER_NS = 1_000_000_000
#: Time between two calls of the live line, ns.
SHOWN_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class PingPlan:
    """`period_ns` between questions, `count` of them (None: until interrupted)."""

    period_ns: int
    count: int | None


def measure(
    path: PingPath, codec: PingCodec, plan: PingPlan, record: Exchanges,
    show: Callable[[Exchanges], None] = lambda _: None,
) -> None:  # fmt: skip
    """Ask until all questions are sent, or Ctrl-C, and listen for the last answers; `record` has
    the result.

    A question that is late is sent at once; if more than one is due, the later ones are put off, so
    that a pause of this process does not become a burst.
    """
    with until_signal():
        _ask(path, codec, plan, record, show)
    with until_signal():  # the last answers are on their way after Ctrl-C, too
        linger = max(LINGER_NS, 3 * record.last_rtt_ns)
        end = monotonic_ns() + linger
        while record.received < record.sent and monotonic_ns() < end:
            act_on_signal()
            _listen(path, codec, record, end)


def _ask(
    path: PingPath, codec: PingCodec, plan: PingPlan, record: Exchanges,
    show: Callable[[Exchanges], None],
) -> None:  # fmt: skip
    due = monotonic_ns() + 1_000_000
    shown = due
    while plan.count is None or record.sent < plan.count:
        act_on_signal()
        now = monotonic_ns()
        if now < due:
            _listen(path, codec, record, due)
            continue
        data = codec.question(record.sent, now)
        t1 = monotonic_ns()
        _send(path, data, record)
        record.asked(due, t1, monotonic_ns() - t1)
        due = max(due + plan.period_ns, t1)
        if now - shown > SHOWN_NS:
            shown = now
            show(record)


def _send(path: PingPath, data: bytes, record: Exchanges) -> None:
    try:
        path.send(data)
    except RunError:
        record.refused += 1
        if record.refused > 100 and not record.received:
            raise


def _listen(path: PingPath, codec: PingCodec, record: Exchanges, until_ns: int) -> None:
    for arrival in path.receive(until_ns):
        answer = codec.answer(arrival.data, record.sent)
        if answer is None:
            record.strange += 1
        else:
            record.answered(answer, arrival)


class PacketCodec:
    """Questions and answers as :mod:`bridge.ping.packet` has them, `size` bytes long."""

    def __init__(self, size: int) -> None:
        self._size, self._host = size, clock_number(host_clock())

    def question(self, k: int, t1_ns: int) -> bytes:
        """The data of question `k`, sent at `t1_ns`."""
        return PingPacket(False, self._host, k, t1_ns).encode(self._size)

    def answer(self, data: bytes, sent: int) -> ReceivedAnswer | None:
        """The answer in `data`, None for anything else."""
        p = decode(data)
        if p is None or not p.answer:
            return None
        return ReceivedAnswer(
            p.k, p.t2, p.t3, p.wake, p.heard, host=p.host, date=p.date, error=p.error,
            count=p.count,
        )  # fmt: skip


def clock_number(clock: HostClock) -> int:
    """64 bits that identify the clock of a host (its start), for packets."""
    from hashlib import sha256

    return int.from_bytes(sha256(clock.host.encode()).digest()[:8], "little")


#: Most senders of which a responder counts the questions; then the one is forgotten that has not
#: asked for the longest time.
SENDERS = 16_384
#: A question that is so many numbers behind the newest is not counted.
BEHIND = 4096


@dataclass(slots=True)
class HeardCount:
    """Different questions heard from a sender, `heard` of them since the count `count` began.

    `newest`: when the newest was asked, ns; `highest`: the highest number; bit i of `seen`: that
    number less i was heard.
    """

    count: int
    newest: int
    highest: int = -1
    seen: int = 0
    heard: int = 0

    def hear(self, k: int, t1: int) -> None:
        """Question `k`, asked at `t1`, was heard, perhaps once more."""
        ahead = k - self.highest
        if ahead > 0:
            self.seen = self.seen << ahead & (1 << BEHIND) - 1 if ahead < BEHIND else 0
            self.highest = k
        bit = 1 << max(0, -ahead)
        if -ahead < BEHIND and not self.seen & bit:
            self.seen |= bit
            self.heard += 1
        self.newest = max(self.newest, t1)


class PingResponder:
    """Answers questions on a path. `answered`: how many so far."""

    def __init__(self, path: PingPath) -> None:
        clock = host_clock()
        self._path, self._host = path, clock_number(clock)
        self._error = round(clock.error * 1e9) if clock.kept else -1
        self._heard: dict[object, HeardCount] = {}
        self._counts = monotonic_ns() // 1000  # differs from that of a responder before us
        self.answered = 0

    def serve(self, until_ns: int) -> None:
        """Answer what arrives before `until_ns` (monotonic)."""
        while True:
            for arrival in self._path.receive(until_ns):
                question = decode(arrival.data)
                if question is not None and not question.answer:
                    self._reply(question, arrival)
            if monotonic_ns() >= until_ns:
                return

    def _reply(self, question: PingPacket, arrival: Arrival) -> None:
        heard = self._hear((arrival.sender, question.host), question)
        date = realtime_offset_ns()
        t3 = monotonic_ns()
        answer = question.answered(
            host=self._host, heard=heard.heard, count=heard.count, t2=arrival.t_ns,
            wake=arrival.wake_ns, t3=t3, date=date, error=self._error,
        )  # fmt: skip
        try:
            self._path.send(answer.encode(len(arrival.data)), arrival.sender)
        except RunError:
            return
        self.answered += 1

    def _hear(self, who: object, question: PingPacket) -> HeardCount:
        """Questions heard from a sender since its last question 0; that one may be overtaken."""
        found = self._heard.pop(who, None)
        if found is None or (question.k == 0 and question.t1 > found.newest):  # a new measurement
            self._counts += 1
            found = HeardCount(self._counts % 65536, question.t1)
        if len(self._heard) >= SENDERS:
            self._heard.pop(next(iter(self._heard)))
        self._heard[who] = found  # the last one: dictionaries keep the order
        found.hear(question.k, question.t1)
        return found
