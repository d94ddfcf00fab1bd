"""Faults in C: which frames a rule is for, and what each kind does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native import faults as native
from bridge.native.bus import Accept
from bridge.native.faults import Injector
from bridge.native.frame import Flags
from cosim.base.errors import PlanError
from tests.bridge.injection import MS, START, flipped, frame, numbers, rule, through


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
    injector = Injector([rule(native.DROP, accept=Accept(0x100, 0x7F0))])
    frames = [frame(n, identifier=0xF8 + n) for n in range(32)]
    assert numbers(through(injector, frames)) == [*range(8), *range(24, 32)]


def test_standard_and_extended_identifiers_are_told_apart():
    frames = [frame(0), frame(1, flags=Flags.EXTENDED)]
    assert numbers(through(Injector([rule(native.DROP, accept=Accept(0x100))]), frames)) == [1]
    extended = rule(native.DROP, accept=Accept(0x100, flags=Flags.EXTENDED))
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


def test_reordered_comes_in_the_place_of_the_next_if_that_is_lost():
    first = rule(native.REORDER, b=1.0, t1_ns=MS)
    second = rule(native.DROP, t0_ns=MS, t1_ns=2 * MS)
    out = through(Injector([first, second]), [frame(n) for n in range(4)])
    assert [(t, n) for t, n, _ in out] == [(1, 0), (2, 2), (3, 3)]


def test_reordered_waits_no_longer_than_b():
    injector = Injector([rule(native.REORDER, b=0.005)])
    assert [(t, n) for t, n, _ in through(injector, [frame(0), frame(20)])] == [(5, 0), (25, 20)]


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
