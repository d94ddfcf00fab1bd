"""Numbers that a receiver believes, to the nanosecond, against what receiver.h says of them."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native.message import E2EProfile, Rejection, accept, receiver

MS = 1_000_000
P02, P05, P04, NONE = E2EProfile.P02, E2EProfile.P05, E2EProfile.P04, E2EProfile.NONE
WRONG, OLDER, REPEATED = Rejection.WRONG, Rejection.OLDER, Rejection.REPEATED

# ---- the greatest number of all ----

GREATEST = [  # period (ns), profile, bits of the stamp -> samples ahead of the nominal one
    (5 * MS, P02, 0, 1), (5 * MS, P05, 0, 1), (5 * MS, P04, 32, 1),
    (2 * MS, P05, 0, 1), (MS, P05, 0, 2), (MS, P04, 32, 2), (MS // 2, P02, 32, 4),
    (MS // 5, P05, 0, 10), (MS // 5, P02, 16, 10),
    (MS // 5, P02, 0, 4),  # a quarter of the counter's turn
]  # fmt: skip


@pytest.mark.parametrize(("period", "profile", "bits", "ahead"), GREATEST)
@pytest.mark.parametrize("offset", [0, 300_000])
def test_a_number_is_as_far_ahead_as_clocks_may_be_or_a_quarter_of_the_counter(
    period, profile, bits, ahead, offset
):
    """One more is a sample of a turn before, or nobody's."""
    now = 700
    for k, there in ((now + ahead, True), (now + ahead + 1, False)):
        r = receiver(period, profile, offset, bits)
        t, turn = now * period + offset, 1 << r.counter_bits
        found = accept(r, k % turn, t, (k * period + offset) // 1000 % (1 << bits))
        if there:
            assert found == k
        elif bits:
            assert found == WRONG
        else:
            assert found == (k - turn if k >= turn else WRONG)


@dataclass
class Limit:
    """A model of a receiver, times in ns: a counter without an end, and no stamps."""

    period: int
    offset: int
    lead: int = 0
    last: int = -1
    arrival: int = 0

    def now(self, t):
        """By how much the sender is ahead, as far as is known at `t`; 244 ppm are forgotten."""
        passed = t - self.arrival if self.last >= 0 else 0
        return self.lead - max(0, passed) // 4096

    def says(self, k, t):
        """The verdict about sample number `k` at the time `t`, ns."""
        most = t + max(self.period, 2 * MS) + max(0, self.now(t))
        if self.offset + k * self.period > most:
            return WRONG
        if self.last >= 0 and k <= self.last:
            return REPEATED if k == self.last else OLDER
        early, lead = self.offset + k * self.period - t, self.now(t)
        if early > lead:  # the fastest one so far; a clock is fast by 488 ppm at most
            passed = t - self.arrival if self.last >= 0 else 0
            lead = min(early, max(0, lead) + passed // 2048)
        self.lead, self.last, self.arrival = lead, k, t
        return k


#: Waits of some periods, as parts of one, and numbers from that of the time.
FRAMES = st.lists(
    st.tuples(st.integers(0, 300), st.integers(-3, 5), st.sampled_from([0, 0, 1, 4000])),
    min_size=5, max_size=60,
)  # fmt: skip


@given(
    frames=FRAMES,
    period=st.sampled_from([MS, 5 * MS]),
    offset=st.sampled_from([0, 1, 800_000]),
    lead=st.sampled_from([0, 0, 3 * MS, 80 * MS, -40 * MS]),
)
def test_numbers_follow_the_fastest_frame_and_clocks_that_drift(frames, period, offset, lead):
    r, limit = receiver(period, P04, offset), Limit(period, offset, lead)
    r.lead_ns, t = lead, offset
    for wait, ahead, long in frames:
        t += (wait + 100 * long) * period // 100
        k = max(0, (t - offset + max(0, limit.now(t))) // period + ahead)
        if k & 0xFFFF != k:
            return  # a turn of the counter
        r.tried = 0  # no three frames make a number true here
        before = r.ok, r.wrong_sequence, r.repeated, r.reordered, r.lost, limit.last
        said = limit.says(k, t)
        assert accept(r, k, t) == said
        gap = k - before[-1] - 1 if before[-1] >= 0 else 0
        more = (said >= 0, said == WRONG, said == REPEATED, said == OLDER, gap * (said >= 0))
        after = r.ok, r.wrong_sequence, r.repeated, r.reordered, r.lost
        assert [b - a for a, b in zip(before, after, strict=False)] == list(more)
        assert r.lead_ns == limit.lead and r.sequence == limit.last


@pytest.mark.parametrize("sequence", [0, 7])
@pytest.mark.parametrize(("passed", "known"), [(0, 50), (4096, 49), (-4096, 50)])
def test_a_lead_is_forgotten_from_the_last_frame_on_whatever_its_number(sequence, passed, known):
    """1 ms in 4096; a frame that was stamped before the last one makes nothing forgotten."""
    r = receiver(MS, P04)
    t = (100_000 + passed) * MS
    for ahead, there in ((known + 2, True), (known + 3, False)):
        r.sequence, r.lead_ns, r.arrival_ns, r.tried = sequence, 50 * MS, 100_000 * MS, 0
        found = accept(r, (t // MS + ahead) & 0xFFFF, t)
        assert (found == t // MS + ahead) is there, ahead


# ---- without a counter ----


@pytest.mark.parametrize("offset", [0, 2 * MS])
def test_without_a_counter_the_arrival_gives_the_number_and_one_may_be_early(offset):
    r, period = receiver(5 * MS, NONE, offset), 5 * MS
    times = [
        (-1, 0), (0, 1), (0, REPEATED), (period - 1, REPEATED), (period, 2), (period, REPEATED),
        (3 * period - 1, 3), (3 * period, 4), (9 * period, 9),
    ]  # fmt: skip
    assert [accept(r, 0, offset + t) for t, _ in times] == [k for _, k in times]
    assert (r.ok, r.repeated, r.lost) == (6, 3, 0)


def test_numbers_one_ahead_of_their_arrival_end_with_the_65th_in_a_row():
    r, period = receiver(5 * MS, NONE), 5 * MS
    assert accept(r, 0, 0) == 0
    found = [accept(r, 0, (k + 1) * period - 1) for k in range(100)]
    assert found.index(REPEATED) == 64
    assert [k for k in found if k >= 0] == [*range(1, 65), *range(65, 100)]


@pytest.mark.parametrize(("silence", "known"), [(0, True), (1, False)])
def test_a_number_is_unknown_after_more_than_half_a_turn_without_a_frame(silence, known):
    """A frame that came 9 periods late, and one 8 periods behind it: one of a turn later."""
    r, period = receiver(5 * MS, P02), 5 * MS
    assert accept(r, 32 & 15, 41 * period) == 32
    assert accept(r, 49 & 15, 49 * period + silence) == (49 if known else WRONG)


# ---- what frames that agree make true ----


def refused(r, t, period=5 * MS):
    """A receiver of sample 1000 at its time; from there on another counter, at `t` periods each."""
    assert accept(r, 1000 & (1 << r.counter_bits) - 1, 1000 * period) == 1000
    return [accept(r, k, round((1001 + x) * period)) for k, x in enumerate(t)]


@pytest.mark.parametrize(
    ("times", "believed"),
    [
        ((0, 1, 2), True), ((0, 2, 3), True), ((0, 2.01, 3.01), False), ((0, 0.01, 1.01), True),
        ((0, 1, 1), True), ((0, 1, 0.99), False), ((0, 1, 3), True), ((0, 1, 3.01), False),
    ],
)  # fmt: skip
def test_three_frames_in_a_row_are_believed_at_their_pace_within_a_period(times, believed):
    assert [k >= 0 for k in refused(receiver(5 * MS, P04), times)] == [False, False, believed]


def test_frames_that_do_not_follow_each_other_begin_a_new_row():
    r, period = receiver(5 * MS, P04), 5 * MS
    refused(r, (0, 1))
    found = [accept(r, k, (1003 + n) * period) for n, k in enumerate((7, 8, 9))]
    assert [k >= 0 for k in found] == [False, False, True]


@pytest.mark.parametrize(("back", "new"), [(1, False), (63, False), (64, True), (65, True)])
def test_numbers_that_were_not_received_are_overtaken_ones_for_64_samples(back, new):
    """Older ones are another count; so is one that was received."""
    r, period = receiver(5 * MS, P04), 5 * MS
    for k in range(900, 911):
        accept(r, k, k * period)
    assert accept(r, 1100, 1100 * period) == 1100
    first = 1100 - back - 2
    found = [accept(r, first + n, (1101 + n) * period) for n in range(3)]
    assert (found[2] >= 0) is new


def test_what_was_received_is_known_for_64_samples_also_over_gaps():
    r, period = receiver(5 * MS, P04), 5 * MS
    seen = [1000, 1001, 1003, 1010, 1063]
    for k in seen:
        accept(r, k, k * period)
    assert [1063 - i for i in range(64) if r.seen >> i & 1] == seen[::-1]
    accept(r, 1127, 1127 * period)
    assert r.seen == 1


# ---- time stamps ----


@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("k", [0, 1, 9])
def test_the_time_of_a_sample_is_the_nominal_one_and_not_that_of_its_rounded_stamp(bits, k):
    offset, period = 300_500, 5 * MS
    r = receiver(period, P02, offset, bits)
    exact = k * period + offset
    assert accept(r, k & 15, exact, exact // 1000 & (1 << bits) - 1) == k
    assert r.sampled_ns == exact
    other = receiver(period, P02, offset, bits)  # a sender that samples at times of its own
    assert accept(other, k & 15, exact, (exact // 1000 + 7) & (1 << bits) - 1) == k
    assert other.sampled_ns == (exact // 1000 + 7) * 1000


STEP = 1_024_000  # ns: 64 of them are a turn of a stamp of 16 bits, and four of a counter of 4


@pytest.mark.parametrize(("ahead", "number"), [(1, 1001), (2, WRONG), (15, WRONG), (16, 1000 - 48)])
def test_a_stamp_that_is_a_quarter_of_its_turn_ahead_is_late(ahead, number):
    r, k = receiver(STEP, P02, 0, 16), 1000 + ahead
    assert accept(r, k & 15, 1000 * STEP, k * STEP // 1000 & 0xFFFF) == number


@pytest.mark.parametrize("shift", [0, 3, 12])
@pytest.mark.parametrize("late", [0, 7, 64, 64 * 5, 64 * 62])
def test_a_turned_counter_and_a_stamp_of_many_turns_ago_give_one_number(shift, late):
    """The counter decides among 64 turns of the stamp where its turn is no part of theirs."""
    period, k = 1_000_000, 8000  # 65 periods and a half are a turn of the stamp
    r = receiver(period, P02, 0, 16)
    r.shift = shift
    t = (k + late) * period
    assert accept(r, k - shift & 15, t, k * 1000 & 0xFFFF) == k
    assert r.sampled_ns == k * period


@pytest.mark.parametrize("first", [0, 1, 40])
def test_a_counter_is_turned_back_by_three_frames_whatever_their_numbers(first):
    r = receiver(5 * MS, P04, 0, 32)
    r.shift = 5
    for n in range(3):
        assert r.shift == 5
        k = first + n
        found = accept(r, k, k * 5 * MS, k * 5000)
    assert (r.shift, r.unturned, found) == (0, 0, first + 2)


@pytest.mark.parametrize("sequence", [0, 1, 50])
def test_a_count_that_begins_anew_is_counted_whatever_the_last_number_was(sequence):
    r, period = receiver(5 * MS, P04), 5 * MS
    assert accept(r, sequence, sequence * period) == sequence
    found = [accept(r, 30_000 + n, (sequence + 1 + n) * period) for n in range(3)]
    assert [k >= 0 for k in found] == [False, False, True] and r.resyncs == 1


def test_the_first_count_that_is_believed_has_not_begun_anew():
    r, period = receiver(5 * MS, P04), 5 * MS
    found = [accept(r, 30_000 + n, n * period) for n in range(3)]
    assert [k >= 0 for k in found] == [False, False, True] and r.resyncs == 0


@pytest.mark.parametrize("ahead", [-3, 0, 3])
def test_a_counter_without_a_stamp_that_begins_anew_goes_on_with_the_clock_of_its_sender(ahead):
    """The sender's clock is some periods ahead of this one by the fastest frame, or behind it."""
    r, period = receiver(5 * MS, P04), 5 * MS
    for k in range(1000, 1200):
        r.lead_ns = ahead * period
        assert accept(r, k, (k - ahead) * period) == k
    found = [accept(r, n, (1200 + n - ahead) * period) for n in range(3)]
    assert [k >= 0 for k in found] == [False, False, True]
    assert found[2] == 1202
