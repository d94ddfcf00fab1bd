"""A CAN bus as every bit of every node: slow, and only for comparing.

A node is one generator. In each bit it is resumed twice: it gives the level that it drives, then it
gets the level that it samples. Nothing is computed as a whole but the jump over idle time.
"""

from __future__ import annotations

from collections.abc import Generator
from functools import cache
from typing import NamedTuple

from cosim.bus.frames import BusFrame
from cosim.bus.settings import (
    BusNodeSettings,
    Disturbance,
    ErrorRate,
    Interruption,
    LineLevel,
    ScriptedError,
)
from tests.bridge.can import naive

STARTED, SENT, RECEIVED, LOST, ERROR, STATE, DROPPED, RECOVERED, OVERLOAD, FREE = range(10)
BIT_ERROR, STUFF_ERROR, FORM_ERROR, CRC_ERROR, ACK_ERROR = range(1, 6)
ACTIVE, WARNING, PASSIVE, OFF = range(4)
ONE_SHOT = 3

MASK = (1 << 64) - 1

Bits = Generator[int | None, int, object]


class Happened(NamedTuple):
    time: int
    kind: int
    node: int
    request: int
    code: int
    tec: int
    rec: int
    bit: int
    role: int


class Fault(Exception):
    """An error was seen; the error flag comes next."""


class Wrong(Exception):
    """An error that a reader of a frame finds."""


class GoneOff(Exception):
    """Bus-off."""


@cache
def priority(frame: BusFrame) -> str:
    """The bits that arbitrate, in the order of sending."""
    f = frame.format
    sent = naive.header(frame.identifier, extended=f.extended, rtr="01"[f.remote])
    return sent.ljust(33, "0")


class Pending(NamedTuple):
    at: int
    number: int
    frame: BusFrame

    @property
    def priority(self) -> str:
        """The bits that arbitrate, in the order of sending."""
        return priority(self.frame)


class SentBit(NamedTuple):
    level: int
    arbitrates: bool = False
    stuff: bool = False
    fast: bool = False
    ack: bool = False


@cache
def remainder(bits: str, polynomial: int, width: int, first: str = "0") -> str:
    """All who read a frame, and its sender, compute the same CRC: once is enough."""
    return naive.remainder(bits, polynomial, width, first=first)


@cache
def bits_to_send(frame: BusFrame, passive: bool) -> list[SentBit]:
    """Start of frame to end of frame."""
    f = frame.format
    names = {"extended": f.extended}
    if f.fd:
        esi = f.esi or passive
        parts = naive.flexible(frame.identifier, frame.data, brs=f.brs, esi=esi, **names)
    else:
        whole = naive.classic(frame.identifier, frame.data, remote=f.remote, dlc=frame.dlc, **names)
        parts = (whole[:-12], "", whole[-12:])
    header = naive.header(frame.identifier, extended=f.extended, rtr="01"[f.remote])
    to_rtr = header if f.extended else header[:-1]
    last = len(naive.stuffed(to_rtr, at_end=False))
    levels = parts[0] + parts[1]
    sent = [
        SentBit(
            int(level),
            arbitrates=0 < i < last,
            stuff=i >= 5 and len(set(levels[i - 5 : i])) == 1,
            fast=f.brs and i >= len(parts[0]),
        )
        for i, level in enumerate(levels)
    ]
    return [*sent, SentBit(1, ack=True), *[SentBit(1)] * 8]


class Reader:
    """A receiver that reads the bits after the start of frame."""

    def __init__(self) -> None:
        self.raw = self.plain = "0"
        self.stuffed = 0
        self.got = (0, 0)

    def take(self, count: int) -> Generator[int, int, str]:
        """Bits of the stuffed area, without the stuff bits."""
        got = ""
        for _ in range(count):
            yield from self.unstuff()
            got += str((yield 1))
            self.raw += got[-1]
            self.plain += got[-1]
        return got

    def unstuff(self) -> Generator[int, int, None]:
        if len(self.raw) >= 5 and self.raw[-5:] in ("00000", "11111"):
            self.raw += str((yield 1))
            self.stuffed += 1
            if self.raw[-1] == self.raw[-2]:
                raise Wrong(STUFF_ERROR)

    def whole(self) -> Generator[int, int, bool]:
        """Read a frame; returns whether its last bit was dominant. `self.done` is what was read."""
        name = yield from self.take(11)
        remote = yield from self.take(1)
        extended = (yield from self.take(1)) == "1"
        if extended:
            name += yield from self.take(18)
            remote = yield from self.take(1)
        fd = (yield from self.take(1)) == "1"
        if fd:
            if (yield from self.take(1)) == "1":
                raise Wrong(FORM_ERROR)
            yield from self.take(2)
            remote = "0"
        elif extended:
            yield from self.take(1)
        length = naive.DLC[int((yield from self.take(4)), 2)]
        length = length if fd else min(length, 8)
        data = yield from self.take(0 if remote == "1" else 8 * length)
        self.got = int(name, 2), int("1" + data, 2)
        good = yield from (self.fd_crc(length) if fd else self.crc())
        if (yield 1) == 0:
            raise Wrong(FORM_ERROR)
        if (yield 0 if good else 1) == 1 and good:
            raise Wrong(BIT_ERROR)
        if (yield -1 if good else 1) == 0:
            raise Wrong(FORM_ERROR)
        if not good:
            raise Wrong(CRC_ERROR)
        for _ in range(6):
            if (yield 1) == 0:
                raise Wrong(FORM_ERROR)
        return (yield 1) == 0

    def crc(self) -> Generator[int, int, bool]:
        expected = remainder(self.plain, 0x4599, 15)
        found = yield from self.take(15)
        yield from self.unstuff()
        return found == expected

    def fd_crc(self, length: int) -> Generator[int, int, bool]:
        width, polynomial = (17, 0x1685B) if length <= 16 else (21, 0x102899)
        got, last = "", self.raw[-1]
        for i in range(4 + width):
            if i % 4 == 0:
                fixed = str((yield 1))
                if fixed == last:
                    raise Wrong(FORM_ERROR)
            last = str((yield 1))
            got += last
        tally = naive.GRAY[self.stuffed % 8]
        tally += str(tally.count("1") % 2)
        crc = remainder(self.raw + got[:4], polynomial, width, "1")
        return got == tally + crc


class Noise:
    """Random errors of a rate: the number of bits before each is drawn, binary digit by digit."""

    def __init__(self, rate: ErrorRate, number: int, seed: int) -> None:
        self.rate, self.state = rate, seed + (number + 1) * 0xD1B54A32D192ED03
        chance = 1 - rate.rate
        self.chances = []
        for _ in range(48):
            self.chances.append(chance / (1 + chance))
            chance *= chance
        self.left, self.before = 0, self.draw()

    def random(self) -> int:
        """The next 53 bits of splitmix64."""
        self.state = self.state + 0x9E3779B97F4A7C15 & MASK
        z = (self.state ^ self.state >> 30) * 0xBF58476D1CE4E5B9 & MASK
        z = (z ^ z >> 27) * 0x94D049BB133111EB & MASK
        return (z ^ z >> 31) >> 11

    def draw(self) -> int:
        return sum((self.random() < int(c * 2**53)) << j for j, c in enumerate(self.chances))

    def strikes(self) -> bool:
        """True if it inverts this bit."""
        if self.left == 0 and self.before > 0:
            self.before -= 1
            return False
        if self.left == 0:
            self.left, self.before = self.rate.length, self.draw()
        self.left -= 1
        return True


def clocked(bit: int, settings: BusNodeSettings) -> int:
    """A bit of the node's own clock, ps."""
    return int(bit / (1 + round(settings.clock_ppm * 1000) * 1e-9) + 0.5)


class Node:
    def __init__(self, bus: Wires, number: int, settings: BusNodeSettings) -> None:
        self.bus, self.number, self.one_shot = bus, number, settings.one_shot
        self.bits = clocked(bus.nominal, settings), clocked(bus.data, settings)
        self.jump, self.point = round(settings.sjw * 1000), round(settings.sample_point * 1000)
        self.late = self.before = self.driven = 0  # late: its sample, behind that of the bus
        self.missed = self.again = False
        self.coming: list[Pending] = []  # by time
        self.waiting: list[Pending] = []
        self.tec = self.rec = self.earliest = 0
        self.state = ACTIVE
        self.sender = self.idling = self.off = False
        self.flag = self.shown = ""
        self.sends: Pending | None = None
        self.sent_bit = SentBit(1)
        self.life = self.live()
        next(self.life)

    def says(
        self, kind: int, request: int = -1, code: int = 0, bit: int = -1, role: int = 0
    ) -> None:
        it = Happened(
            self.bus.clock, kind, self.number, request, code, self.tec, self.rec, bit, role
        )
        self.bus.happened.append(it)

    def passive(self) -> bool:
        return max(self.tec, self.rec) > 127

    def first(self) -> Pending | None:
        """The frame that it would send now."""
        while self.coming and self.coming[0].at <= self.bus.t:
            self.waiting.append(self.coming.pop(0))
        return min(self.waiting, key=lambda p: (p.priority, p.number), default=None)

    def count(self, tec: int = 0, rec: int = 0) -> None:
        self.tec, self.rec = self.tec + tec, min(self.rec + rec, 255)

    def confine(self) -> None:
        most = max(self.tec, self.rec)
        state = (
            OFF if self.tec > 255 else PASSIVE if most > 127 else WARNING if most > 95 else ACTIVE
        )
        if state != self.state:
            self.state = state
            self.says(STATE, code=state)
        if state == OFF:
            raise GoneOff

    def gives_up(self) -> None:
        failed, self.sends = self.sends, None
        if failed and self.one_shot:
            self.waiting.remove(failed)
            self.says(DROPPED, failed.number, ONE_SHOT)

    def error(self, code: int, count: int) -> None:
        was_passive = self.passive()
        self.count(**{"tec" if self.sender else "rec": count})
        self.bus.troubled = True
        alone = not any(n.shown == "active" for n in self.bus.nodes if n is not self)
        request = self.sends.number if self.sends else self.bus.on_air
        self.says(ERROR, request, code, self.bus.bit, alone | self.sender << 1)
        self.gives_up()
        self.confine()
        raise Fault(was_passive, code)

    def more(self) -> None:
        self.count(**{"tec" if self.sender else "rec": 8})
        self.confine()

    # One bit, and what is made of bits.

    def one(self, level: int = 1) -> Generator[int | None, int, int]:
        yield None
        return (yield level)

    def live(self) -> Bits:
        following: Bits = self.idle()
        while True:
            self.flag = ""
            self.sent_bit = SentBit(1)
            try:
                starts = yield from following
                following = self.pause((yield from self.frame(starts)))
            except Fault as fault:
                following = self.error_frame(*fault.args)
            except GoneOff:
                following = self.recover()

    def idle(self) -> Bits:
        self.idling = True
        while True:
            yield None
            may = self.earliest <= self.bus.t and not self.again
            starts = self.first() if may else None
            if starts:
                self.begin(starts)
            level = yield 0 if starts else 1
            if starts or level == 0:
                self.idling = False
                if starts and level:
                    self.error(BIT_ERROR, 8)
                if not starts:
                    self.hear()
                return starts

    def begin(self, pending: Pending) -> None:
        self.idling = False
        self.sends, self.sender = pending, True
        self.says(STARTED, pending.number, bit=0)
        self.bus.starters.append((pending, self))
        self.late = self.before = 0

    def hear(self) -> None:
        self.sender, self.earliest = False, 0
        self.late = self.before = 0

    def drive(self) -> int:
        """The level that it drives; the same once more if it missed to sample the last bit."""
        if not self.missed:
            self.driven = self.life.send(None) or 0
        return self.driven

    def sample(self, level: int) -> None:
        """Sample a bit: once, or by a clock that is too slow not at all, or too fast twice."""
        if not self.bus.drifting:
            self.life.send(level)
            return
        times = self.samples(level)
        self.missed = not times
        for i, seen in enumerate(times):
            self.again = i > 0
            if self.again:
                self.life.send(None)
            self.life.send(seen)
        self.again = False

    def samples(self, level: int) -> list[int]:
        bit = self.bits[self.bus.fast]
        before, self.before = self.before, level
        if self.idling or self.off or self.sends:
            self.late = 0
            return [level]
        self.late += bit - (self.bus.clock - self.bus.t)
        if before == 1 and level == 0:
            most = bit * self.jump // 1000
            self.late -= max(-most, min(most, self.late))
        if self.late > bit * (1000 - self.point) // 1000:
            self.late -= bit
            return []
        if self.late < -(bit * self.point // 1000):
            self.late += bit
            return [before, level]
        return [level]

    def frame(self, starts: Pending | None) -> Bits:
        self.reader = Reader()
        reading = self.reader.whole()
        level = next(reading)
        if starts:
            for sent in bits_to_send(starts.frame, self.passive())[1:]:
                self.sent_bit = sent
                sampled = yield from self.one(self.sent_bit.level)
                if self.lost(sampled):
                    level = reading.send(sampled)
                    break
                if self.sent_bit.arbitrates:
                    reading.send(sampled)
            else:
                self.count(tec=-(self.tec > 0))
                self.sends = None
                self.waiting.remove(starts)
                self.says(SENT, starts.number)
                self.confine()
                return False
        return (yield from self.listen(reading, level))

    def lost(self, sampled: int) -> bool:
        """Check a bit that was sent; whether arbitration is lost."""
        sent = self.sent_bit
        if sent.ack:
            if sampled:
                self.error(ACK_ERROR, 0 if self.passive() else 8)
        elif sampled != sent.level:
            if not sent.arbitrates or sampled:
                self.error(BIT_ERROR, 8)
            if sent.stuff:
                self.error(STUFF_ERROR, 0)
            assert self.sends
            self.says(LOST, self.sends.number, bit=self.bus.bit)
            self.sender = False
            self.gives_up()
            return True
        return False

    def listen(self, reading: Generator[int, int, bool], level: int) -> Bits:
        while True:
            sampled = yield from self.one(abs(level))
            try:
                level = reading.send(sampled)
            except Wrong as wrong:
                self.error(wrong.args[0], 1)
            except StopIteration as ended:
                self.says(RECEIVED, self.bus.on_air)
                self.bus.read.append(self.reader.got)
                return ended.value
            if level == -1:  # it has acknowledged
                self.rec = 127 if self.rec > 127 else max(self.rec - 1, 0)
                self.confine()

    def pause(self, overload: object) -> Bits:
        while True:
            if overload:
                self.says(OVERLOAD, bit=self.bus.bit)
                self.bus.troubled = True
                self.flag = "overload"
                for _ in range(6):
                    if (yield from self.one(0)):
                        self.error(BIT_ERROR, 8)
                self.flag = ""
                if (yield from self.delimiter(after_error=False)):
                    continue
            recessive = 0
            while recessive < 3 and (yield from self.one()):
                recessive += 1
            overload = recessive < 3
            if not overload:
                suspended = self.sender and self.passive()
                self.earliest = self.bus.clock + 8 * self.bus.nominal if suspended else 0
                return (yield from self.idle())
            if recessive == 2:
                first = self.first() if self.earliest <= self.bus.t else None
                joins = None if self.sender and self.passive() else first
                self.hear()
                if joins:
                    self.begin(joins)
                return joins

    def delimiter(self, after_error: bool) -> Generator[int | None, int, bool]:
        """Until a recessive bit, and seven more; whether the last was dominant."""
        dominant = 0
        while (yield from self.one()) == 0:
            dominant += 1
            if dominant == 1 and after_error and not self.sender:
                self.more()
            if dominant % 8 == 0:
                self.more()
        for _ in range(6):
            if (yield from self.one()) == 0:
                self.error(FORM_ERROR, 8 if self.sender else 1)
        return (yield from self.one()) == 0

    def error_frame(self, passive: bool, code: int) -> Bits:
        if passive:
            free = self.sender and code == ACK_ERROR
            seen = ""
            while seen[-6:] not in ("000000", "111111"):
                seen += str((yield from self.one()))
                if free and seen[-1] == "0":
                    free = False
                    self.more()
        else:
            self.flag = "active"
            for _ in range(6):
                if (yield from self.one(0)):
                    self.error(BIT_ERROR, 8)
            self.flag = ""
        return (yield from self.pause((yield from self.delimiter(after_error=True))))

    def recover(self) -> Bits:
        self.off, self.sender, self.sends = True, False, None
        seen = ""
        for _ in range(128):
            while not seen.endswith("1" * 11):
                seen = seen[-10:] + str((yield from self.one()))
            seen = ""
        self.off = False
        self.tec = self.rec = 0
        self.state = ACTIVE
        self.earliest = self.bus.clock
        self.says(RECOVERED)
        return (yield from self.idle())


class Wires:
    """The bus: `nominal` and `data` ps for a bit."""

    def __init__(
        self,
        nominal: int,
        data: int,
        nodes: list[BusNodeSettings],
        disturbances: list[Disturbance],
        seed: int = 0,
    ) -> None:
        self.nominal, self.data = nominal, data
        self.bits = nominal, data  # of the clock of the last transmitter
        self.fast = self.troubled = False
        rates = [d for d in disturbances if isinstance(d, ErrorRate)]
        self.noises = [Noise(rate, i, seed) for i, rate in enumerate(rates)]
        self.scripts = [d for d in disturbances if isinstance(d, ScriptedError)]
        self.counts = [0] * len(self.scripts)
        self.acting: list[ScriptedError] = []
        self.now: list[tuple[int | None, LineLevel]] = []
        timed = [d for d in disturbances if isinstance(d, Interruption)]
        self.coming = sorted(timed, key=lambda x: x.start_ps)[::-1]  # the next at the end
        self.timed: list[Interruption] = []  # begun and not over
        self.happened: list[Happened] = []
        self.read: list[tuple[int, int]] = []
        self.starters: list[tuple[Pending, Node]] = []
        self.t = self.clock = self.bit = 0
        self.on_air = -1
        self.nodes = [Node(self, i, settings) for i, settings in enumerate(nodes)]
        self.drifting = any(settings.clock_ppm for settings in nodes)

    def ask(self, node: int, at: int, number: int, frame: BusFrame) -> None:
        """Make a frame pending from `at` ps on."""
        self.nodes[node].coming.append(Pending(at, number, frame))

    def run(self, end: int) -> None:
        while True:
            counting = False
            if self.idle() and not self.outstanding():
                t = self.next_start()
                counting = any(n.off for n in self.nodes) and t - self.t >= self.nominal
                if not counting:
                    self.t, self.bit = t, 0
            if self.t >= end:
                return
            self.step(counting)

    def idle(self) -> bool:
        return all(n.idling or n.off for n in self.nodes)

    def outstanding(self) -> bool:
        return any(self.bit < s.bit + s.length for s in self.acting)

    def next_start(self) -> int:
        """The time at which the idle bus becomes dominant."""
        times = [
            max(self.t, n.earliest, (n.waiting or n.coming)[0].at)
            for n in self.nodes
            if (n.waiting or n.coming) and not n.off
        ]
        dominant = (LineLevel.INVERTED, LineLevel.DOMINANT)
        times += [self.t for x in self.timed if x.level in dominant and x.end_ps > self.t]
        for x in reversed(self.coming):
            if x.level in dominant and x.end_ps > max(self.t, x.start_ps):
                times.append(max(self.t, x.start_ps))
                break
        return min(times, default=1 << 62)

    def attempt(self) -> None:
        first, node = min(self.starters, key=lambda s: s[0].priority)
        self.bits = node.bits
        name = first.frame.identifier, first.frame.format.extended
        self.acting = []
        for i, s in enumerate(self.scripts):
            if (s.identifier, s.extended) == name:
                self.counts[i] += 1
                if s.attempt in (0, self.counts[i]):
                    self.acting.append(s)
        self.starters = []

    def disturbed(self, node: int | None, level: int) -> int:
        for where, change in self.now:
            if where == node:
                level = (1 - level, 0, 1, 1)[change]
        return level

    def connected(self, node: int) -> bool:
        return (node, LineLevel.DISCONNECTED) not in self.now

    def step(self, counting: bool) -> None:
        """One bit; `counting`: an idle one, of which only nodes that are off take notice."""
        while self.coming and self.coming[-1].start_ps <= self.t:
            self.timed.append(self.coming.pop())
        if self.timed:
            self.timed = [x for x in self.timed if x.end_ps > self.t]
        self.clock = self.t
        shown = False
        for n in self.nodes:
            n.shown = n.flag
            shown = shown or n.flag != ""
        levels = [n.drive() for n in self.nodes]
        if self.starters:
            self.bit = 0
            self.attempt()
        sending = [n for n in self.nodes if n.sends]
        scripts = [s for s in self.acting if s.bit <= self.bit < s.bit + s.length]
        struck = [] if counting else [n.rate for n in self.noises if n.strikes()]
        self.now = [(s.node, s.level) for s in scripts]
        self.now += [(r.node, LineLevel.INVERTED) for r in struck]
        self.now += [(x.node, x.level) for x in self.timed]
        self.on_air = sending[0].sends.number if sending and sending[0].sends else -1
        fast = not shown and any(n.sent_bit.fast for n in sending)
        self.fast = fast
        self.clock = self.t + (self.nominal if counting else self.bits[fast])
        if self.now:
            level = min((x for i, x in enumerate(levels) if self.connected(i)), default=1)
            level = self.disturbed(None, level)
            for n in self.nodes:
                n.sample(self.disturbed(n.number, level))
        else:
            level = min(levels)
            for n in self.nodes:
                n.sample(level)
        if self.starters:
            self.attempt()
            self.bit = 0
        if self.idle() and self.troubled:
            self.troubled = False
            self.happened.append(Happened(self.clock, FREE, -1, -1, 0, 0, 0, -1, 0))
        self.t = self.clock
        self.bit += 1
