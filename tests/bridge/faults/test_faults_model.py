"""Faults in C against a model of their own, written as lists, from what faults.h says of them."""

from __future__ import annotations

import binascii
import ctypes as c
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native import faults as native
from bridge.native.bus import Accept
from bridge.native.faults import Fault, Injector
from bridge.native.frame import Frame
from bridge.native.journal import Journal
from tests.bridge.faults.test_hostile import can, hostile, sent
from tests.bridge.injection import MS, START, frame, rule, through

WHOLE = (1 << 64) - 1


class SplitMix:
    """Numbers of Steele's SplitMix64."""

    def __init__(self, seed):
        self.state = seed

    def next(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & WHOLE
        z = self.state
        z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & WHOLE
        z = ((z ^ z >> 27) * 0x94D049BB133111EB) & WHOLE
        return z ^ z >> 31

    def between(self, a, b):
        """A time between a and b s, in ns."""
        return int((a + (b - a) * ((self.next() >> 11) * 2.0**-53)) * 1e9 + 0.5)


@dataclass
class Rule:
    """A rule: as it is given, and what it has done."""

    given: Fault
    draws: SplitMix = None
    left: int = 0
    last: int = 0
    asked: int = 0
    hits: int = 0

    def fits(self, sent):
        r = self.given
        return not (sent.id ^ r.accept.id) & r.accept.mask and r.bus in (-1, sent.bus)

    def struck(self):
        """Draw a number for a frame in its time; return if the fault hits it, and the number."""
        drawn = self.draws.next()
        self.asked += 1
        hit = (drawn >> 11) * 2.0**-53 < self.given.probability
        if self.given.kind != native.BURST:
            return hit, drawn
        if not self.left and hit:
            self.left = self.given.count
        self.left -= (burst := self.left > 0)
        return burst, drawn


@dataclass
class Passage:
    """A frame on its way; `waits`: the rule for which it waits for the next one."""

    data: bytearray
    t: int
    copies: int = 1
    kinds: list[int] = field(default_factory=list)
    first: int = -1
    waits: int = -1
    again: tuple = ()


class Model:
    """Rules in order, and what waits: (t, data, number, rule that holds it back)."""

    def __init__(self, rules, room):
        self.rules, self.room = [Rule(r, SplitMix(r.random)) for r in rules], room
        self.waiting, self.rows, self.overflow = [], [], 0

    def insert(self, t, data, number, held=-1):
        if len(self.waiting) == self.room:
            self.overflow += 1
            return
        place = sum(other[0] <= t for other in self.waiting)
        self.waiting.insert(place, (t, bytes(data), number, held))

    def put(self, sent):
        p = Passage(bytearray(sent.payload), sent.t_ns)
        for n, r in enumerate(self.rules):
            if r.fits(sent):
                self.apply(n, r, p, sent)
        if p.kinds:
            crc, kinds = binascii.crc32(sent.payload), sum(1 << k for k in set(p.kinds))
            went = (p.t - START, binascii.crc32(p.data)) if p.copies else (-1, 0)
            row = (sent.t_ns - START, went[0], sent.id, sent.sequence, crc, went[1])
            self.rows.append((*row, p.first, kinds, p.copies, sent.payload))
        draws = SplitMix(p.again[2]) if p.again else None
        for copy in range(p.copies):
            later = draws.between(*p.again[:2]) if copy else 0
            self.insert(p.t + later, p.data, sent.sequence, -1 if copy else p.waits)
        for n, r in enumerate(self.rules):
            if r.given.kind == native.REORDER and r.fits(sent) and p.waits != n:
                self.release(n, p.t)

    def apply(self, n, r, p, sent):
        g = r.given
        hit, drawn = False, 0
        if g.t0_ns <= sent.t_ns - START < g.t1_ns:
            hit, drawn = r.struck()
        if not p.copies:
            return
        if g.kind == native.REORDER and any(held == n for *_, held in self.waiting):
            hit = False
        if hit and self.strike(n, g, p, SplitMix(drawn)):
            r.hits += 1
            p.kinds.append(g.kind)
            p.first = n if p.first < 0 else p.first
        if g.kind == native.DELAY:
            p.t = r.last = max(p.t, r.last)

    def strike(self, n, g, p, draws):
        """Apply a fault to a frame; return if it does anything."""
        if g.kind in (native.DROP, native.BURST):
            p.copies = 0
        elif g.kind in (native.DELAY, native.JITTER):
            p.t += draws.between(g.a, g.b)
        elif g.kind == native.DUPLICATE:
            p.copies += g.count
            p.again = (g.a, g.b, draws.state)
            return g.count > 0
        elif g.kind == native.REORDER:
            p.waits, p.t = n, p.t + int(g.b * 1e9)
        else:
            return self.corrupt(p.data, g.count, draws)
        return True

    @staticmethod
    def corrupt(data, count, draws):
        """Floyd's choice of different bits."""
        bits, chosen = 8 * len(data), set()
        for i in range(bits - min(count, bits), bits):
            bit = draws.next() % (i + 1)
            chosen.add(i if bit in chosen else bit)
        for bit in chosen:
            data[bit // 8] ^= 1 << bit % 8
        return bool(chosen)

    def release(self, n, t):
        """The last one that waits for rule n comes right behind a frame of t."""
        places = [i for i, (*_, held) in enumerate(self.waiting) if held == n]
        if places:
            _, data, number, _ = self.waiting.pop(places[-1])
            self.insert(t, data, number)

    def get(self, now):
        found = []
        while self.waiting and self.waiting[0][0] <= now:
            found.append(self.waiting.pop(0)[:3])
        return found


KINDS = st.sampled_from([native.DROP, native.BURST, native.DELAY, native.JITTER,
                         native.DUPLICATE, native.REORDER, native.CORRUPT])  # fmt: skip
TIMES = st.sampled_from([0, 3 * MS, 10 * MS])
RULES = st.lists(
    st.builds(
        lambda kind, t, p, seed, count, times, bus, mask: rule(
            kind, probability=p, random=seed, count=count, a=min(times), b=max(times), bus=bus,
            t0_ns=t, t1_ns=20 * MS, accept=Accept(0x100, mask),
        ),
        KINDS, TIMES, st.sampled_from([0.0, 0.3, 1.0, 1.0]), st.integers(0, WHOLE),
        st.sampled_from([0, 1, 2, 5]), st.tuples(*[st.sampled_from([0.0, 0.001, 0.0045])] * 2),
        st.sampled_from([-1, -1, 0, 1]), st.sampled_from([0, 0x7FF, 0x7FE]),
    ),
    max_size=4,
)  # fmt: skip
#: Identifier, length, bus, ms since the one before.
FRAMES = st.lists(
    st.tuples(
        st.sampled_from([0x100, 0x100, 0x101]), st.sampled_from([0, 1, 8]),
        st.integers(0, 1), st.sampled_from([0, 1, 1, 2, 9]),
    ),
    min_size=1, max_size=25,
)  # fmt: skip


def said(got):
    return got.t_ns, got.payload, got.sequence


@given(rules=RULES, frames=FRAMES, room=st.sampled_from([1, 4, 64]))
def test_what_gets_through_when_and_what_is_recorded(tmp_path_factory, rules, frames, room):
    model, t = Model(rules, room), START
    extra = [rule(native.DROP)]  # behind the end of the table
    path = tmp_path_factory.mktemp("faults") / "injected"
    with Journal.create(path, native.INJECTED, 64) as journal:
        injector = Injector([*rules, *extra], room, journal.address)
        injector.struct.n_rules -= 1
        for number, (identifier, length, bus, wait) in enumerate(frames):
            t += wait * MS
            out = []
            while (got := injector.get(t)) is not None:
                assert got.reserved == 0
                out.append(said(got))
            assert out == model.get(t)
            one = frame(number, t, identifier, length, bus)
            injector.put(one, START)
            model.put(one)
        end = []
        while (got := injector.get(t + 10**12)) is not None:
            end.append(said(got))
        assert end == model.get(t + 10**12)
        found = [
            (*(int(row[name]) for name in ("t_ns", "through_ns", "id", "sequence", "crc",
             "crc_after", "rule", "kinds", "copies")), bytes(row["data"])[: row["length"]])
            for row in journal.rows
        ]  # fmt: skip
    assert found == model.rows
    s, changed = injector.struct, [row for row in found if row[8] and row[4] != row[5]]
    assert (s.frames, s.injected, s.overflow) == (len(frames), len(found), model.overflow)
    assert (s.dropped, s.corrupted) == (sum(not row[8] for row in found), len(changed))
    hits = [(r.asked, r.hits) for r in injector.rules]
    assert hits == [*((r.asked, r.hits) for r in model.rules), (0, 0)]


@pytest.mark.parametrize("until", [0, 1])
def test_a_frame_gets_through_at_its_time(until):
    injector = Injector([])
    injector.put(frame(5), START)
    got = injector.get(START + 5 * MS - 1 + until)
    assert (got is not None) == until


def test_bytes_that_a_frame_cannot_have_are_not_looked_at():
    """A length beyond the room for data is that of the room."""
    made = Frame.of(0x100, bytes(232), 0, START)
    made.length = 60_000
    injector = Injector([rule(native.CORRUPT, count=3)])
    injector.put(made, START)
    got = injector.get(START)
    assert got is not None and injector.struct.corrupted == 1
    assert sum(b.bit_count() for b in bytes(got.data)) == 3
    assert c.sizeof(got) == 256


def test_a_flood_without_time_between_its_frames_is_none():
    """Nothing is added, and nothing is said to have been done."""
    codec = can()
    injector = Injector([hostile(codec, native.FLOOD, a=0.01, b=0.0)], 64)
    assert len(through(injector, [sent(codec, 1), sent(codec, 2)])) == 2  # 5 ms apart
    assert injector.struct.injected == injector.hits()[0] == 0
