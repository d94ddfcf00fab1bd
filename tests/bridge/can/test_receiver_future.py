"""No number ahead of its time, and no true sender shut out, whatever stalls or is forged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native.message import E2EProfile, Rejection, accept, counter_bits, receiver

PERIOD = 5_000_000  # ns
OFFSET = 500_000
PROFILES = st.sampled_from([E2EProfile.P02, E2EProfile.P05, E2EProfile.P04])
STAMPS = st.sampled_from([0, 16, 32])
SEEDS = st.integers(0, 2**32 - 1)


def stamp(k, bits, period=PERIOD):
    """The time stamp of sample k, us."""
    return ((k * period + OFFSET) // 1000) & ((1 << bits) - 1)


def stalled(random, n, period):
    """When samples 0 ... n - 1 arrive, (n,): sender and network stand still, then burst."""
    due = np.arange(n) * period + OFFSET
    times = due.astype(float)
    for _ in range(int(random.integers(0, 4))):  # the sender stands still, and catches up
        start, length = random.uniform(0, n * period), random.uniform(0, 2e9)
        inside = (times >= start) & (times < start + length)
        times[inside] = start + length + np.arange(inside.sum()) * 30_000
    times = np.maximum.accumulate(times)
    for _ in range(int(random.integers(0, 3))):  # so does what lies between
        start, length = random.uniform(0, n * period), random.uniform(0, 0.3e9)
        inside = (times >= start) & (times < start + length)
        times[inside] = start + length
    return (np.maximum.accumulate(times) + random.uniform(0, 3e5, n)).astype(np.int64)


@given(PROFILES, STAMPS, SEEDS, st.sampled_from([1_000_000, PERIOD, 7_000_000]), st.floats(0, 0.5))
def test_no_number_is_ahead_of_its_time(profile, bits, seed, period, loss):
    """However long sender or network stand still, and whatever is lost meanwhile."""
    random = np.random.default_rng(seed)
    r = receiver(period, profile, OFFSET, bits)
    arrivals = stalled(random, 600, period)
    for k in np.flatnonzero(random.random(600) >= loss).tolist():
        t = int(arrivals[k])
        found = accept(r, k % 2 ** counter_bits(profile), t, stamp(k, bits, period))
        if found >= 0:
            assert found * period + OFFSET <= t + max(period, 2_000_000)
        if bits and found >= 0:
            assert found == k


@given(st.integers(0, 5), SEEDS, st.booleans())
def test_forged_counters_and_stamps_lead_nowhere_ahead(bits, seed, anything):
    """A flood of anything between the frames of the true sender."""
    random = np.random.default_rng(seed)
    r = receiver(PERIOD, E2EProfile.P05, OFFSET, [0, 16, 32][bits % 3])
    clocks = 2 * PERIOD
    for k in range(300):
        true = k * PERIOD + OFFSET + 300_000
        for _ in range(int(random.integers(0, 6))):
            t = true - int(random.integers(0, PERIOD))
            counter = int(random.integers(0, 256)) if anything else (k + 60) % 256
            found = accept(r, counter, t, int(random.integers(0, 2**32)))
            assert found < 0 or found * PERIOD + OFFSET <= t + clocks + t // 2048
        accept(r, k & 255, true, stamp(k, r.time_bits))


@pytest.mark.parametrize("profile", [E2EProfile.P02, E2EProfile.P05, E2EProfile.P04])
@pytest.mark.parametrize("bits", [0, 16, 32])
@pytest.mark.parametrize("ahead", [1, 2, 3, 7, 15, 60, 127, 200, 255])
def test_one_forged_frame_shuts_nobody_out(profile, bits, ahead):
    """Counter (and stamp) of a sample to come: at most one true sample is missed for it."""
    r = receiver(PERIOD, profile, OFFSET, bits)
    missed = 0
    for k in range(300):
        t = k * PERIOD + OFFSET + 300_000
        taken = accept(r, k % 2 ** counter_bits(profile), t, stamp(k, bits))
        missed += taken != k
        if k == 100:
            later = k + ahead
            accept(r, later % 2 ** counter_bits(profile), t + PERIOD // 3, stamp(later, bits))
    assert missed <= 1


@given(PROFILES, STAMPS, SEEDS)
def test_a_few_forged_frames_leave_the_true_sender_heard(profile, bits, seed):
    """Now and then up to two between two true ones, with any counter: none is numbered wrongly."""
    random = np.random.default_rng(seed)
    r = receiver(PERIOD, profile, OFFSET, bits)
    longest = silent = 0
    for k in range(400):
        t = k * PERIOD + OFFSET + 300_000
        found = accept(r, k % 2 ** counter_bits(profile), t, stamp(k, bits))
        assert found < 0 or found == k
        silent = 0 if found == k else silent + 1
        longest = max(longest, silent)
        forged = int(random.integers(1, 3)) if k % 10 == 5 else 0
        for share in sorted(random.uniform(0.05, 0.95, forged)):
            later = k + int(random.integers(-300, 300))
            counter = later % 2 ** counter_bits(profile)
            accept(r, counter, t + int(share * PERIOD), stamp(max(0, later), bits))
    assert longest <= 2


@pytest.mark.parametrize("profile", [E2EProfile.P02, E2EProfile.P05, E2EProfile.P04])
@pytest.mark.parametrize("bits", [0, 16, 32])
@pytest.mark.parametrize("anew", [0, 5, 77])
def test_a_sender_that_counts_anew_is_heard_with_its_third_frame(profile, bits, anew):
    r = receiver(PERIOD, profile, OFFSET, bits)
    heard = []
    for k in range(1000, 1200):
        t = k * PERIOD + OFFSET + 300_000
        counter = k if k < 1100 else k - 1100 + anew
        heard.append(accept(r, counter % 2 ** counter_bits(profile), t, stamp(k, bits)))
    assert heard[:100] == list(range(1000, 1100))
    # Without a stamp a counter that fits by chance is a period ahead, within what clocks may be.
    assert set(np.array(heard[102:]) - np.arange(1102, 1200)) <= ({0} if bits else {0, 1})
    assert r.resyncs <= 1


@pytest.mark.parametrize("late", [0.1, 0.4, 1.0, 4.0])
def test_stamp_and_counter_tell_a_sample_however_late_it_is(late):
    """16 bits of microseconds and 4 of a counter: one sample in 41 s."""
    r = receiver(PERIOD, E2EProfile.P02, OFFSET, 16)
    for k in range(1000):
        t = k * PERIOD + OFFSET + (int(late * 1e9) if k >= 500 else 100_000)
        assert accept(r, k & 15, t, stamp(k, 16)) == k
        assert r.sampled_ns == k * PERIOD + OFFSET


def test_a_clock_ahead_by_more_than_a_period_is_believed_with_the_third_frame():
    """Two hosts whose runs began 80 ms apart."""
    r = receiver(PERIOD, E2EProfile.P04, OFFSET, 32)
    found = [accept(r, k, k * PERIOD + OFFSET - 80_000_000, stamp(k, 32)) for k in range(100, 300)]
    assert max(found[:2]) < 0 and found[2:] == list(range(102, 300)) and r.resyncs == 0


def test_without_a_counter_a_sample_a_period_and_never_a_later_one():
    """Of a flood one a period is taken, and one for jitter."""
    r = receiver(PERIOD, E2EProfile.NONE, OFFSET)
    for n in range(5000):
        t = OFFSET + n * PERIOD // 50
        found = accept(r, 0, t)
        assert found < 0 or found <= n // 50 + 1
    assert r.repeated > 4700


@pytest.mark.parametrize("profile", [E2EProfile.P02, E2EProfile.P05, E2EProfile.P04])
@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("turned", [-9, 1, 5])
def test_numbers_are_right_again_when_somebody_else_has_turned_the_counter(profile, bits, turned):
    """A flood had other counters with the true stamps; the true sender alone is heard again."""
    r, turn = receiver(PERIOD, profile, OFFSET, bits), 2 ** counter_bits(profile)
    heard = []
    for k in range(1000, 1200):
        t = k * PERIOD + OFFSET + 300_000
        counter = k + turned if 1050 <= k < 1100 else k
        heard.append(accept(r, counter % turn, t, stamp(k, bits)))
    assert heard[:50] == list(range(1000, 1050))
    # Stamps are believed, not the counter; a period ahead is within what clocks may be.
    assert set(np.array(heard[60:100]) - np.arange(1060, 1100)) <= ({0, 1} if turned == 1 else {0})
    assert heard[102:] == list(range(1102, 1200))
    assert r.shift == 0


def test_one_frame_does_not_turn_a_counter_back():
    """Of a sender that counts otherwise than its stamps, and a forged frame now and then."""
    r = receiver(PERIOD, E2EProfile.P04, OFFSET, 32)
    heard = []
    for k in range(1000, 1200):
        t = k * PERIOD + OFFSET + 300_000
        if k > 1100 and k % 10 == 5:
            accept(r, k + 1, t - PERIOD // 3, stamp(k + 1, 32))
        heard.append(accept(r, k if k < 1050 else k - 1050, t, stamp(k, 32)))
    assert heard[52:] == list(range(1052, 1200))


def test_without_a_counter_numbers_return_to_the_arrival_after_a_late_frame():
    """Frame 3 comes more than a period late, directly before frame 4: from there on one ahead."""
    r = receiver(PERIOD, E2EProfile.NONE, OFFSET)
    late = {3: OFFSET + 4 * PERIOD + PERIOD // 3}
    found = [accept(r, 0, late.get(k, OFFSET + k * PERIOD + PERIOD // 2)) for k in range(200)]
    assert found[:6] == [0, 1, 2, 4, 5, 6]
    back = found.index(Rejection.REPEATED)
    assert 60 < back < 72 and r.repeated == 1
    assert found[4:back] == [k + 1 for k in range(4, back)]
    assert found[back + 1 :] == list(range(back + 1, 200))
