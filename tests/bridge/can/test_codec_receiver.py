"""Unwrapped counters with lost, repeated, overtaken and late frames: numbers are right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native.message import E2EProfile, Rejection, accept, counter_bits, receiver

PERIOD = 5_000_000  # ns
PROFILES = st.sampled_from([E2EProfile.P02, E2EProfile.P05, E2EProfile.P04])


def counted(r) -> tuple[int, ...]:
    return r.ok, r.lost, r.repeated, r.reordered, r.wrong_sequence


def test_in_order():
    r = receiver(PERIOD, E2EProfile.P02)
    found = [accept(r, k & 15, k * PERIOD) for k in range(100)]
    assert found == list(range(100)) and counted(r) == (100, 0, 0, 0, 0)
    assert (r.sequence, r.arrival_ns, r.sampled_ns) == (99, 99 * PERIOD, 99 * PERIOD)


def test_what_is_lost_repeated_and_overtaken():
    r = receiver(PERIOD, E2EProfile.P05)
    order = [10, 11, 11, 14, 13, 12, 14, 15, 200]
    now = [10, 11, 11.2, 14, 14.1, 14.2, 14.3, 15, 200]
    found = [accept(r, k & 255, int(t * PERIOD)) for k, t in zip(order, now, strict=True)]
    assert found == [10, 11, -1, 14, -2, -2, -1, 15, 200]
    assert counted(r) == (5, 2 + 184, 2, 2, 0)
    assert r.older == 14


def test_the_number_of_an_older_one_is_told():
    r = receiver(PERIOD, E2EProfile.P02)
    for k in (30, 33):
        accept(r, k & 15, k * PERIOD)
    assert accept(r, 31 & 15, 33 * PERIOD + 1) == Rejection.OLDER
    assert r.older == 31


def test_overtaken_frames_at_their_own_pace_are_older_and_no_new_count():
    """They follow each other like those of a counter that was restarted, but nobody had them."""
    r = receiver(PERIOD, E2EProfile.P05)
    for k in (*range(10), 20):
        assert accept(r, k, k * PERIOD) == k
    late = [accept(r, k, int((k + 10.2) * PERIOD)) for k in range(10, 16)]
    assert late == [Rejection.OLDER] * 6
    assert (r.resyncs, r.reordered, r.sequence) == (0, 6, 20)
    assert accept(r, 26, 26 * PERIOD) == 26


def test_a_stamp_ahead_of_its_time_without_a_counter_is_never_believed():
    """Nothing but the stamp says which sample it is: no row of them makes it true."""
    r = receiver(PERIOD, E2EProfile.NONE, 0, 32)
    assert accept(r, 0, 0, 0) == 0
    ahead = [accept(r, 0, k * PERIOD, (k + 9) * PERIOD // 1000) for k in range(1, 9)]
    assert ahead == [Rejection.WRONG] * 8
    assert (r.wrong_sequence, r.resyncs, r.sequence) == (8, 0, 0)


def test_a_late_node_catches_up_in_one_burst():
    """Twelve periods of nothing, then twelve frames at once: with a 4-bit counter."""
    r = receiver(PERIOD, E2EProfile.P02)
    for k in range(50):
        accept(r, k & 15, k * PERIOD)
    found = [accept(r, k & 15, 61 * PERIOD + k) for k in range(50, 62)]
    assert found == list(range(50, 62))
    assert accept(r, 62 & 15, 62 * PERIOD) == 62


def test_after_a_silence_of_more_than_a_turn_no_number_is_guessed():
    """Lost or late? A burst does not tell; frames at their pace do."""
    r = receiver(PERIOD, E2EProfile.P02)
    for k in range(50):
        accept(r, k & 15, k * PERIOD)
    burst = [accept(r, k & 15, 70 * PERIOD + k) for k in range(50, 70)]
    assert set(burst) == {Rejection.WRONG}
    paced = [accept(r, k & 15, k * PERIOD + 100) for k in range(71, 76)]
    assert paced == [Rejection.WRONG, Rejection.WRONG, 73, 74, 75]
    assert (r.resyncs, r.wrong_sequence) == (1, 22)


@pytest.mark.parametrize("first", [0, 1, 7])
@pytest.mark.parametrize(("silence", "known"), [(14, True), (15, True), (16, False), (40, False)])
def test_a_turn_of_the_counter_after_any_sample_leaves_the_number_unknown(first, silence, known):
    """Also after sample 0; as a frame may be a period early, 16 periods are a turn of 4 bits."""
    r = receiver(PERIOD, E2EProfile.P02)
    assert accept(r, first, first * PERIOD) == first
    k = first + silence
    assert accept(r, k & 15, k * PERIOD) == (k if known else Rejection.WRONG)


def test_a_counter_without_a_stamp_begins_anew():
    """The third frame is believed; its number is that of the time."""
    r = receiver(PERIOD, E2EProfile.P05)
    for k in range(1000, 1010):
        accept(r, k & 255, k * PERIOD)
    found = [accept(r, k, (1010 + k) * PERIOD) for k in range(300)]
    assert [n >= 0 for n in found[:3]] == [False, False, True]
    assert found[2:] == list(range(1012, 1310)) and r.resyncs == 1


def test_a_stamp_stays_true_when_the_counter_begins_anew():
    r = receiver(PERIOD, E2EProfile.P05, time_bits=32)
    for k in range(1000, 1010):
        accept(r, k & 255, k * PERIOD, k * 5000)
    found = [accept(r, k, (1010 + k) * PERIOD, (1010 + k) * 5000) for k in range(300)]
    assert found[2:] == list(range(1012, 1310)) and r.resyncs == 1


@pytest.mark.parametrize("profile", [E2EProfile.P05, E2EProfile.P04])
def test_new_counters_with_an_old_stamp_are_never_believed(profile):
    """Also in the first turn of the counter, in which the old ones were all smaller."""
    r = receiver(PERIOD, profile, time_bits=32)
    for k in range(100):
        assert accept(r, k, k * PERIOD, k * 5000) == k
    ahead = [
        accept(r, k + (0, 2, 1, 3)[k % 4] & 255, k * PERIOD, 98 * 5000) for k in range(100, 400)
    ]
    assert max(ahead) < 0 and r.resyncs == 0 and r.sequence == 99


@pytest.mark.parametrize("part", [-0.49, -0.2, 0.2, 0.49])
def test_a_stamp_between_two_nominal_times_is_of_the_nearest_sample(part):
    """A foreign sender samples at times of its own."""
    r = receiver(PERIOD, E2EProfile.P05, time_bits=32)
    for k in range(1000, 1010):
        assert accept(r, k & 255, (k + 1) * PERIOD, round((k + part) * 5000)) == k


def test_a_recording_of_stamped_frames_is_never_believed():
    r = receiver(PERIOD, E2EProfile.P05, time_bits=32)
    for k in range(1000):
        accept(r, k & 255, k * PERIOD, k * 5000)
    again = [accept(r, k & 255, (1000 + k) * PERIOD, k * 5000) for k in range(1000)]
    assert max(again) < 0 and r.resyncs == 0 and r.reordered + r.repeated == 1000


def test_the_first_of_all_is_not_negative():
    """One that cannot have been sent yet is believed when others follow it."""
    for counter in range(2, 14):
        r = receiver(PERIOD, E2EProfile.P02)
        found = [accept(r, counter + k & 15, k * PERIOD) for k in range(3)]
        assert found == [Rejection.WRONG, Rejection.WRONG, counter + 2]
    for counter in range(2):
        assert accept(receiver(PERIOD, E2EProfile.P02), counter, 0) == counter


def times(random: np.random.Generator, n: int, M: int, drift: float) -> list[tuple[int, int]]:
    """(arrival, number), in order of arrival: 0.55 M periods late at most, stalls with bursts."""
    base = random.uniform(0, 0.05 * M * PERIOD)
    worst = 0.42 * M * PERIOD  # and two periods more for repeated ones
    kinds = random.choice([0.3, 1.5, 0.5 * M], size=n, p=[0.8, 0.15, 0.05])
    delays = np.minimum(random.uniform(0, 1, n) * kinds * PERIOD, worst)
    sent = np.arange(n) * PERIOD * (1 + drift)
    for start in random.integers(0, n, size=n // 60):  # nothing gets through, then all at once
        length = random.integers(1, int(0.6 * M))
        stalled = slice(start, start + length)
        end = sent[start] + length * PERIOD
        delays[stalled] = np.maximum(delays[stalled], end - sent[stalled])
        delays[stalled] = np.minimum(delays[stalled], worst)
    arrival = (base + sent + delays).astype(np.int64)
    return sorted(zip(arrival.tolist(), range(n), strict=True))


@given(PROFILES, st.integers(0, 2**32 - 1), st.floats(-1e-4, 1e-4), st.floats(0, 0.6))
def test_never_a_wrong_number(profile, seed, drift, loss):
    """Whatever is lost (silences included), repeated, late or overtaken; clocks 100 ppm apart."""
    random, M = np.random.default_rng(seed), 2 ** min(counter_bits(profile), 8)
    r = receiver(PERIOD, profile, round(random.uniform(-0.1, 0) * M * PERIOD))
    arrived = [x for x in times(random, 400, M, drift) if random.random() >= loss]
    for start in random.integers(0, 400, size=2):  # silences
        arrived = [x for x in arrived if not start <= x[1] < start + 3 * M // 2]
    again = [(t + int(random.integers(0, 2 * PERIOD)), k) for t, k in arrived[::7]]
    last, taken = -1, []
    for t, k in sorted(arrived + again):
        found = accept(r, k % 2 ** counter_bits(profile), t)
        if found >= 0:
            assert found == k > last
            last = k
            taken.append(k)
        elif found == Rejection.REPEATED:
            assert k == last == r.older
        elif found == Rejection.OLDER:
            assert k == r.older < last
    assert r.ok == len(taken)
    assert r.ok + r.lost == (taken[-1] - taken[0] + 1 if taken else 0)
    assert counted(r)[0] + sum(counted(r)[2:]) == len(arrived) + len(again)


@pytest.mark.parametrize("bits", [4, 8, 16])
def test_minutes_of_drift(bits):
    """A sender 200 ppm fast or slow, for five minutes; every fifth frame arrives."""
    profile = {4: E2EProfile.P02, 8: E2EProfile.P05, 16: E2EProfile.P04}[bits]
    for drift in (2e-4, -2e-4):
        r = receiver(PERIOD, profile)
        for k in range(0, 60_000, 5):
            t = int(k * PERIOD * (1 + drift))
            assert accept(r, k & (1 << bits) - 1, t) == k
