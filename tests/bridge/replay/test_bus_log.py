"""Samples of a bus log: their numbers, the times at which they were sent, and t = 0."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native.frame import frame_dtype
from bridge.native.safety import LifeState
from bridge.records.node_lives import Life
from bridge.replay.bus_log import LoggedSample, sent_ns, sequence, start_of
from bridge.replay.from_log import (
    ControllerReplay,
    LogReplay,
    SentDifference,
    _arrivals,
    _limits,
    _numbered,
)
from bridge.replay.received_and_sent import AlteredSamples
from bridge.replay.replay import _new_components
from bridge.replay.run_facts import period
from cosim.base.errors import ScenarioError
from cosim.record import Column, Recorder, Run
from tests.bridge.deployments import named

NOW = 1_700_000_000_123_456_000  # t = 0 on the log's clock, ns
WIRE = 130_000  # ns that a frame takes
#: Deployments and messages whose counters and stamps have these bits.
LAYOUTS = {(4, 16): ("can-classic", "XI_2"), (8, 32): ("can", "LINK_2")}


@cache
def system(name):
    return named(name, "run.stop=1")


def message(bits, period=5_000_000, offset=500_000):
    """A message with a counter and a stamp of so many bits, and these times, ns."""
    name, key = LAYOUTS[bits]
    return SimpleNamespace(
        encoding=system(name).messages[key].encoding, period_ns=period, offset_ns=offset
    )


def sample(sent, counter, transit=WIRE, bits=(4, 16), life=LifeState.ACTIVE):
    """A frame that is stamped `sent` ns after t = 0, and logged `transit` ns later."""
    stamp = (sent // 1000) % (1 << bits[1])
    return LoggedSample(
        NOW + sent + transit, WIRE, counter % (1 << bits[0]), stamp, life, np.zeros(4)
    )


@given(
    sent=st.integers(0, 10**9), held_up=st.integers(0, 48_000), bits=st.sampled_from(list(LAYOUTS))
)
def test_a_stamp_says_when_a_sample_was_sent_though_it_was_held_up(sent, held_up, bits):
    """A stamp of 16 bits begins again after 65.5 ms; three quarters of that may pass on the way."""
    one = sample(sent, 0, 1000 * held_up, bits)
    assert sent_ns(message(bits), one, NOW) == sent // 1000 * 1000


@given(sent=st.integers(100_000_000, 10**9), early=st.integers(1, 16_000))
def test_a_frame_that_the_clock_of_a_log_puts_too_early_keeps_its_time(sent, early):
    """A quarter of a turn of a stamp may be missing between the clocks."""
    assert sent_ns(message((4, 16)), sample(sent, 0, -1000 * early), NOW) == sent // 1000 * 1000


@pytest.mark.parametrize(("transit", "turns"), [(49_151, 0), (49_152, 0), (49_153, 1)])
def test_beyond_three_quarters_of_a_turn_a_stamp_is_taken_for_that_of_the_next_one(transit, turns):
    sent = 200_000_000
    found = sent_ns(message((4, 16)), sample(sent, 0, 1000 * transit), NOW)
    assert found - sent == turns * 65_536_000


@given(
    number=st.integers(40, 100_000),
    late=st.integers(-20, 20),
    bits=st.sampled_from(list(LAYOUTS)),
    period=st.sampled_from([5_000_000, 3_333_333]),
    offset=st.sampled_from([0, 500_000, 777_777]),
)
def test_the_number_of_a_sample_is_the_slot_in_which_it_was_sent(
    number, late, bits, period, offset
):
    """A sender that is late by whole slots counts them: near its time, the counter decides."""
    turn = 1 << bits[0]
    one = sample((number + late) * period + offset, number, bits=bits)
    there = range(number + late - turn // 4, number + late + turn // 4 + 1)
    fitting = [k for k in there if k % turn == number % turn]
    expected = fitting[0] if fitting else number + late
    assert sequence(message(bits, period, offset), one, NOW) == expected
    if abs(late) <= turn // 4:
        assert expected == number


def test_without_a_stamp_the_time_in_the_log_counts():
    carried = system("can-damiao").messages["master_tau_1"]
    t = carried.offset_ns + 17 * carried.period_ns
    one = LoggedSample(NOW + t + 4_900_000, WIRE, 0, 0, -1, np.zeros(1))
    assert sent_ns(carried, one, NOW) == t + 4_900_000
    assert sequence(carried, one, NOW) == 17


# ---- t = 0 ---------------------------------------------------------------------------------------


def logged(first, n=120, wrong=(), bits=(4, 16), life=LifeState.ACTIVE):
    """Samples of a message from `first` on; those at the places `wrong` have bad counters."""
    name, key = LAYOUTS[bits]
    carried = system(name).messages[key]
    return [
        sample(
            j * carried.period_ns + carried.offset_ns, j + (k in wrong), WIRE + 3000 * (k % 7), bits
        )
        if life == LifeState.ACTIVE
        else sample(j * carried.period_ns + carried.offset_ns, j, WIRE, bits, life)
        for k, j in enumerate(range(first, first + n))
    ]


@pytest.mark.parametrize("first", [0, 1, 13, 14, 100, 1000, 8000])
@pytest.mark.parametrize("bits", LAYOUTS)
def test_t_0_is_found_wherever_a_log_begins(first, bits):
    name, key = LAYOUTS[bits]
    assert start_of(system(name), {key: logged(first, bits=bits)}) == NOW


def test_one_counter_in_ten_may_be_wrong():
    heard = logged(100, wrong=range(0, 50, 10))
    assert start_of(system("can-classic"), {"XI_2": heard}) == NOW
    # The counter of the first one is wrong as well; elsewhere all of them would be.
    with pytest.raises(ScenarioError, match="counters of XI_2 fit no common t = 0"):
        start_of(system("can-classic"), {"XI_2": logged(100, wrong=[*range(0, 50, 10), 1])})


def test_what_a_node_sends_before_it_runs_does_not_count():
    idle = logged(0, life=LifeState.INACTIVE)
    with pytest.raises(ScenarioError, match="no XI_2 of a node that was running in the log"):
        start_of(system("can-classic"), {"XI_2": idle})


# ---- until when a slot heard, and sums -----------------------------------------------------------


def test_a_slot_hears_until_its_frame_was_sent_but_not_into_the_next_slot():
    """Slots of 5 ms, due 1 ms into their tick; each frame tells when its slot was done."""
    made = system("can-classic")
    assert made.nodes["master_control"].h == 0.005
    due = np.arange(2, 9) * 5_000_000 + 1_000_000
    ran = {2: 0, 3: 700_000, 4: 4_999_000, 5: 5_000_000, 6: 5_001_000, 8: -2000}
    own = {
        "TAU_2": {j: sample(int(due[j - 2]) + ran[j], j) for j in (2, 3, 4, 5, 8)},
        "XI_2": {j: sample(int(due[j - 2]) + ran[j] + 200_000, j) for j in (3, 4)}
        | {6: sample(int(due[4]) + ran[6], 6)},
    }
    limits, first, known = _limits(made, "master_control", own, NOW)
    assert (first, known) == (2, 6)
    # Of two messages the earlier one tells; slot 7 has none.
    assert (limits - due).tolist() == [0, 700_000, 4_999_000, 0, 0, 0, 0]


def test_no_sum_of_nothing_is_exact():
    same = SentDifference("a.b", "m", 0.0, 0.0, 0.0, 0, -1)
    other = SentDifference("a.c", "m", 0.1, 0.1, 0.0, 1, 0)

    def node(compared, *values):
        return ControllerReplay("a", 0, 9, compared, 0, 0, values)

    assert node(3, same).exact and not node(0, same).exact and not node(3, same, other).exact
    assert LogReplay(0, (node(3, same),), ()).exact
    assert not LogReplay(0, (), ()).exact
    assert not LogReplay(0, (node(3, same), node(3, other)), ()).exact


def test_altered_samples_are_counted_by_kind():
    """7 are older ones, 4 have numbers that were never sent, the other 9 are strangers."""
    said = str(AlteredSamples(Life("a"), "M", 20, 3, 1, 0.5, 2.0, misnumbered=7, unsent=4))
    counts = [
        "9 did not come from the recorded sender",
        "4 have a number that the recorded sender never sent",
        "7 are older samples under a wrong number",
    ]
    assert all(text in said for text in counts), said
    assert "first: sample 3, value 1: heard 2, sent 0.5" in said


def test_the_period_of_a_run_without_a_scenario_is_that_of_its_rows(tmp_path):
    """Also where the rows do not begin at t = 0."""
    columns = [Column("x", "rad", 0)]
    with Recorder(tmp_path, columns, h=0.01, every=2, rows_per_chunk=5, n_signals=1) as recorder:
        buffer = recorder.buffer()
        buffer[:5] = np.arange(5)[:, None]
        recorder.submit(buffer, 50, 5)
    run, remarks = Run.open(tmp_path), []
    assert run.t[0] > 0.4
    assert period(run, remarks) == pytest.approx(0.02)
    assert "no scenario in run.json" in remarks[0]


# ---- components ----------------------------------------------------------------------------------


def test_no_two_lives_of_a_node_share_a_component():
    first = named("can", "run.stop=1")
    systems = [_new_components(first, Life("master", boot)) for boot in (1, 2, 3)]
    made = [id(s.component) for x in systems for s in x.nodes["master"].plan.components]
    assert len(set(made)) == len(made)


def test_a_node_hears_all_frames_of_its_bus_but_its_own():
    """Its two messages and its heartbeat, among seven frames, are not heard."""
    made = system("can-classic")
    number = made.deployment.nodes["master_control"].number
    own = [made.messages[m].encoding.message.id for m in ("TAU_2", "XI_2")]
    others = [made.messages[m].encoding.message.id for m in ("POS_1", "VEL_1")]
    beats = [made.services["left"].heartbeats[n].message.id for n in (number, 1)]
    bus = made.messages["POS_1"].bus
    rows = np.zeros(7, frame_dtype(8))
    rows["id"] = [*own, *others, *beats, 0x123]
    rows["t_ns"] = NOW + 1000 * np.arange(7)
    heard, times = _arrivals(made, "master_control", {bus: rows}, NOW)[bus]
    assert heard["id"].tolist() == [*others, beats[1], 0x123]
    assert times.tolist() == [2000, 3000, 5000, 6000]


def test_samples_of_the_run_are_kept_the_first_of_two_alike():
    """Not those before t = 0, of a node that does not run, or with a number below 0."""
    made = system("can-classic")
    offset = made.messages["XI_2"].offset_ns
    frames = [
        sample(offset, 0),
        sample(offset + 5_000_000, 1),
        sample(offset + 5_000_000, 1, transit=400_000),  # once more
        sample(offset + 10_000_000, 2, life=LifeState.INACTIVE),
        sample(offset + 15_000_000, 3),
        sample(offset - 5_000_000, -1, transit=4_500_000),  # of before, arrives later
        sample(offset, 0, transit=-offset - 1),  # logged before t = 0
    ]
    found = _numbered(made, "XI_2", frames, NOW)
    assert list(found) == [0, 1, 3]
    assert found[0] is frames[0] and found[1] is frames[1] and found[3] is frames[4]
    at_once = sample(offset, 0, transit=-offset)  # logged at t = 0
    assert _numbered(made, "XI_2", [at_once], NOW) == {0: at_once}
