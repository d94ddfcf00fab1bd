"""Faults in C: what each kind does, that the seed decides, and that the record is the truth."""

from __future__ import annotations

import ctypes as c
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.journal import Journal
from bridge.native import faults as native
from bridge.native.faults import FOREVER, INJECTED, Fault, Faults, Injector
from bridge.native.frame import Flags, Frame
from cosim.errors import PlanError

START = 10**12  # of the run, on the clock of the frames
MS = 1_000_000


def rule(kind, **more):
    said = {"count": 1, "t0_ns": 0, "t1_ns": FOREVER, "bus": -1, "probability": 1.0, "random": 7}
    return Fault(kind=kind, **{**said, **more})


def frame(n, t=None, identifier=0x100, length=8, bus=0, flags=0):
    """Frame number n; it arrives n ms after the start."""
    data = bytes((n * 31 + k) % 256 for k in range(length))
    made = Frame.of(identifier, data, flags, START + (n * MS if t is None else t))
    made.sequence, made.bus = n, bus
    return made


def through(injector, frames, until=10**11):
    """Everything that gets through, looked at every millisecond: (ms, number, payload)."""
    out, coming = [], list(frames)
    for now in range(START, START + until, MS):
        while coming and coming[0].t_ns <= now:
            injector.put(coming.pop(0), START)
        while (got := injector.get(now)) is not None:
            assert got.reserved == 0
            assert now - MS < got.t_ns <= now
            out.append(((got.t_ns - START) / MS, got.sequence, got.payload))
        if not coming and injector.struct.n_waiting == 0:
            return out
    raise AssertionError("frames still wait")


def numbers(out):
    return [n for _, n, _ in out]


def flipped(a, b):
    return sum((x ^ y).bit_count() for x, y in zip(a, b, strict=True))


def test_structs_are_as_c_has_them():
    for which, kind in enumerate((Fault, None, Faults)):
        assert native.sizes(which) == (INJECTED.itemsize if kind is None else c.sizeof(kind))
    assert native.sizes(3) == 0


def test_a_capacity_that_is_no_power_of_two_is_refused():
    with pytest.raises(PlanError, match="power of two"):
        Injector([], 100)


def test_without_rules_nothing_is_touched():
    frames = [frame(n) for n in range(50)]
    out = through(Injector([]), frames)
    assert out == [(n, n, frames[n].payload) for n in range(50)]


def test_before_the_start_nothing_is_touched():
    injector = Injector([rule(native.DROP)])
    injector.put(frame(3), 0)
    got = injector.get(2**62)
    assert got is not None and got.sequence == 3
    assert (injector.struct.injected, injector.rules[0].asked) == (0, 0)


# ---- which frames ----


def test_a_rule_holds_from_t0_until_before_t1():
    injector = Injector([rule(native.DROP, t0_ns=10 * MS, t1_ns=20 * MS)])
    assert numbers(through(injector, [frame(n) for n in range(30)])) == [
        *range(10),
        *range(20, 30),
    ]
    assert (injector.hits(), injector.struct.dropped) == ((10,), 10)


def test_a_rule_is_for_its_identifier():
    injector = Injector([rule(native.DROP, id=0x100, mask=0x7F0)])
    frames = [frame(n, identifier=0xF8 + n) for n in range(32)]
    assert numbers(through(injector, frames)) == [*range(8), *range(24, 32)]


def test_standard_and_extended_identifiers_are_told_apart():
    mask = 0x1FFFFFFF | native.EXTENDED
    frames = [frame(0), frame(1, flags=Flags.EXTENDED)]
    assert numbers(through(Injector([rule(native.DROP, id=0x100, mask=mask)]), frames)) == [1]
    extended = rule(native.DROP, id=0x100 | native.EXTENDED, mask=mask)
    assert numbers(through(Injector([extended]), frames)) == [0]


def test_a_rule_is_for_its_bus():
    injector = Injector([rule(native.DROP, bus=1)])
    assert numbers(through(injector, [frame(n, bus=n % 3) for n in range(6)])) == [0, 2, 3, 5]


@pytest.mark.parametrize("p", [0.0, 0.2, 0.9, 1.0])
def test_a_probability_is_one(p):
    injector = Injector([rule(native.DROP, probability=p)], 4096)
    for _ in range(4000):
        injector.put(frame(0), START)
    assert abs(injector.hits()[0] - 4000 * p) <= 4 * (4000 * p * (1 - p)) ** 0.5
    assert injector.rules[0].asked == 4000


# ---- what each kind does ----


def test_a_burst_is_so_many_in_a_row():
    injector = Injector([rule(native.BURST, count=4, probability=0.05)])
    lost = sorted(set(range(400)) - set(numbers(through(injector, [frame(n) for n in range(400)]))))
    runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    assert len(runs) > 3
    assert all(len(run) % 4 == 0 for run in runs[:-1])


def test_delay_keeps_the_order():
    injector = Injector([rule(native.DELAY, a=0.005, b=0.05, probability=0.5)])
    out = through(injector, [frame(n) for n in range(200)])
    assert numbers(out) == list(range(200))
    late = [t - n for t, n, _ in out]
    assert min(late) >= 0 and max(late) <= 50
    assert len({round(x, 3) for x in late}) > 50
    assert 60 < injector.hits()[0] < 140


def test_a_delay_that_has_ended_is_not_overtaken():
    injector = Injector([rule(native.DELAY, a=0.02, b=0.02, t1_ns=10 * MS)])
    out = through(injector, [frame(n) for n in range(60)])
    assert numbers(out) == list(range(60))
    assert [t for t, _, _ in out[:10]] == [n + 20 for n in range(10)]
    assert [t for t, n, _ in out if n >= 29] == list(range(29, 60))


def test_jitter_overtakes():
    injector = Injector([rule(native.JITTER, a=0.0, b=0.01)])
    out = through(injector, [frame(n) for n in range(200)])
    assert sorted(numbers(out)) == list(range(200)) != numbers(out)
    assert all(0 <= t - n <= 10 for t, n, _ in out)
    assert [t for t, _, _ in out] == sorted(t for t, _, _ in out)


def test_duplicates_are_the_same_frame_later():
    injector = Injector([rule(native.DUPLICATE, count=2, a=0.003, b=0.003)])
    out = through(injector, [frame(n * 10) for n in range(5)])
    assert [(t - n, n) for t, n, _ in out] == [(x, 10 * n) for n in range(5) for x in (0, 3, 3)]
    assert len({payload for _, _, payload in out}) == 5


def test_reordered_comes_right_behind_the_next():
    """Every other waits for its successor, which is never held back itself."""
    injector = Injector([rule(native.REORDER, b=1.0)])
    out = through(injector, [frame(n) for n in range(8)])
    assert numbers(out) == [1, 0, 3, 2, 5, 4, 7, 6]
    assert [t for t, _, _ in out] == [1, 1, 3, 3, 5, 5, 7, 7]
    assert injector.hits() == (4,)


def test_reordered_waits_no_longer_than_b():
    injector = Injector([rule(native.REORDER, b=0.005)])
    assert [(t, n) for t, n, _ in through(injector, [frame(0), frame(20)])] == [(5, 0), (25, 20)]


@settings(max_examples=40, deadline=None)
@given(count=st.integers(1, 600), length=st.integers(0, 64), seed=st.integers(0, 2**64 - 1))
def test_so_many_different_bits_are_flipped(count, length, seed):
    injector = Injector([rule(native.CORRUPT, count=count, random=seed)])
    sent = frame(5, length=length)
    ((_, _, payload),) = through(injector, [sent])
    assert flipped(payload, sent.payload) == min(count, 8 * length)
    assert injector.struct.corrupted == (length > 0)


def test_every_bit_can_be_flipped():
    injector = Injector([rule(native.CORRUPT)], 4096)
    hit = set()
    for _ in range(600):
        injector.put(sent := frame(0, length=4), START)
        got = injector.get(2**62)
        assert got is not None
        a, b = (int.from_bytes(x.payload, "little") for x in (sent, got))
        hit.add((a ^ b).bit_length() - 1)
    assert hit == set(range(32))


# ---- several rules, seeds, bounds ----

kinds = st.integers(0, 6)
rules = st.lists(
    st.builds(
        rule,
        kinds,
        count=st.integers(1, 5),
        t0_ns=st.integers(0, 30 * MS),
        t1_ns=st.integers(20 * MS, 90 * MS),
        probability=st.floats(0, 1),
        a=st.floats(0, 0.003),
        b=st.floats(0.003, 0.02),
        random=st.integers(0, 2**64 - 1),
    ),
    max_size=5,
)


def copy(r):
    return Fault.from_buffer_copy(bytes(r))


@settings(max_examples=40, deadline=None)
@given(rules=rules)
def test_the_same_seed_does_the_same(rules):
    frames = [frame(n) for n in range(80)]
    a, b = (through(Injector([copy(r) for r in rules]), frames) for _ in range(2))
    assert a == b


@settings(max_examples=60, deadline=None)
@given(rules=rules)
def test_frames_are_accounted_for(tmp_path_factory, rules):
    """What went in, less what was dropped, and copies, comes out; the record says the same."""
    folder = tmp_path_factory.mktemp("journal")
    with Journal.create(folder / "injected", INJECTED, 100) as journal:
        injector = Injector(rules, journal=journal.address)
        frames = [frame(n) for n in range(80)]
        out = through(injector, frames)
        rows = journal.rows.copy()
    s = injector.struct
    assert (s.frames, s.overflow, s.n_waiting) == (80, 0, 0)
    assert len(rows) == s.injected
    copies = {n: 1 for n in range(80)} | {int(r["sequence"]): int(r["copies"]) for r in rows}
    assert {n: numbers(out).count(n) for n in range(80)} == copies
    assert sum(n == 0 for n in copies.values()) == s.dropped
    assert [t for t, _, _ in out] == sorted(t for t, _, _ in out)
    changed = {int(r["sequence"]) for r in rows if r["copies"] and r["crc"] != r["crc_after"]}
    assert len(changed) == s.corrupted
    for r in rows:
        was = frames[r["sequence"]].payload
        assert (r["crc"], bytes(r["data"][:8]), r["length"]) == (crc32(was), was, 8)
        assert r["t_ns"] == r["sequence"] * MS and r["id"] == 0x100
        assert r["kinds"] >> rules[r["rule"]].kind & 1
    for _, n, payload in out:
        assert (payload != frames[n].payload) == (n in changed)


def test_a_rule_draws_the_same_whatever_others_do():
    """The frames hit by a rule do not depend on the rules before it."""
    second = rule(native.CORRUPT, probability=0.3, random=99)
    frames = [frame(n) for n in range(100)]
    alone = through(Injector([copy(second)]), frames)
    changed = {n for _, n, payload in alone if payload != frames[n].payload}
    both = through(Injector([rule(native.DROP, probability=0.5), copy(second)]), frames)
    assert {n for _, n, payload in both if payload != frames[n].payload} == changed & set(
        numbers(both)
    )


def test_bits_flipped_back_are_no_corruption():
    """Two rules that flip the same bits leave the frame as it was: not counted as corrupted."""
    rules = [rule(native.CORRUPT, count=64), rule(native.CORRUPT, count=64)]
    injector = Injector(rules)
    sent = frame(1)
    ((_, _, payload),) = through(injector, [sent])
    assert payload == sent.payload
    assert (injector.struct.corrupted, injector.hits()) == (0, (1, 1))


def test_too_many_that_wait_are_counted():
    injector = Injector([rule(native.DELAY, a=1.0, b=1.0)], 16)
    for n in range(40):
        injector.put(frame(n), START)
    assert (injector.struct.overflow, injector.struct.n_waiting) == (24, 16)
    assert numbers(through(injector, [])) == list(range(16))


def test_a_full_record_counts_and_goes_on(tmp_path):
    with Journal.create(tmp_path / "injected", INJECTED, 5) as journal:
        injector = Injector([rule(native.DROP)], journal=journal.address)
        for n in range(9):
            injector.put(frame(n), START)
        assert (len(journal), journal.dropped, injector.struct.dropped) == (5, 4, 9)


def test_the_generator_is_splitmix64():
    """The state after n questions: seed + n times the golden gamma (Steele et al., 2014)."""
    injector = Injector([rule(native.DROP, random=1234567, probability=0.5)])
    for n in range(5):
        injector.put(frame(n), START)
    assert injector.rules[0].random == (1234567 + 5 * 0x9E3779B97F4A7C15) % 2**64
    first = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    expected = [n for n, z in enumerate(first) if z >> 63]  # at 0.5 the upper half stays
    assert [n for n in numbers(through(injector, [])) if n < 3] == expected
