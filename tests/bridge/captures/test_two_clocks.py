"""Clocks of two ends: offset and drift against known truth, and clocks that are mixed."""

from math import inf
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from bridge.captures.evaluation import (
    CaptureChoice,
    of_one_recording,
    summary_of_clocks,
)
from bridge.captures.judged import ClockKnowledge, judge
from bridge.captures.mixed import one_clock
from bridge.captures.reading import read_recording
from bridge.captures.ways import RecordedWay
from bridge.ping.clocks import estimate_both_ways, estimate_one_way
from cosim.base.errors import ScenarioError
from tests.bridge.captures import recorded
from tests.bridge.captures.recorded import START, drifting, table
from tests.bridge.captures.test_recovered import one, two

PPM = 1e-6


@pytest.mark.parametrize("ppm", [50.0, -50.0, 7.0])
def test_drift_of_one_direction_to_1_ppm(tmp_path: Path, ppm: float) -> None:
    known = table(n=12_000)  # 60 s
    path = recorded.write_mcap(tmp_path / "a.mcap", known, log=drifting(-0.3, ppm))
    result = one(path, known=ClockKnowledge(least=0.002))
    clock = result.judged.clock
    assert clock is not None
    assert clock.drift[1] == pytest.approx(ppm * PPM, abs=1 * PPM)
    assert result.judged.offset[1] == pytest.approx(-0.3, abs=1e-4)
    _, delay = known.expected()
    np.testing.assert_allclose(result.links[0].delay, delay, atol=1e-4)


def test_drift_that_only_the_fastest_samples_show(tmp_path: Path) -> None:
    """Every sample arrives after it was sent: only the drift tells that there are two clocks."""
    known = table(n=12_000)
    path = recorded.write_mcap(tmp_path / "a.mcap", known, log=drifting(0.3, 50))
    result = one(path)
    assert result.judged.clock is not None and "drift" in result.judged.why
    assert result.judged.clock.drift[1] == pytest.approx(50 * PPM, abs=1 * PPM)
    assert one(path, known=ClockKnowledge("same")).judged.clock is None


def test_drift_of_both_directions_to_1_ppm_and_within_the_bounds(tmp_path: Path) -> None:
    there, back = table(1, n=12_000), table(2, n=12_000)
    files = recorded.write_ends(tmp_path, there, back, drifting(5.0, 50))
    result = two([str(f) for f in files], tmp_path)
    assert result.judged.clock is not None
    least, drift, most = result.judged.clock.drift
    assert drift == pytest.approx(50 * PPM, abs=1 * PPM)
    assert least <= 50 * PPM <= most
    low, middle, high = result.judged.offset
    assert low <= 5.0 <= high and middle == pytest.approx(5.0, abs=5e-4)
    for link, known in zip(result.links, (there, back), strict=True):
        _, delay = known.expected()
        np.testing.assert_array_equal(np.isnan(link.delay), known.lost)
        np.testing.assert_allclose(link.delay, delay, atol=5e-4)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), n=st.integers(2, 300), m=st.integers(1, 300),
    offset=st.floats(-1e3, 1e3), ppm=st.floats(-200, 200), least=st.floats(0, 0.3),
)  # fmt: skip
def test_the_truth_is_within_the_bounds_of_both_ways(
    seed: int, n: int, m: int, offset: float, ppm: float, least: float
) -> None:
    """Independent packets in both directions; delays known to have a least and a largest value."""
    rng = np.random.default_rng(seed)
    t2, t3 = np.sort(rng.uniform(0, 250, n)), np.sort(rng.uniform(0, 250, m))  # of the other clock
    there, back = least + rng.exponential(0.01, n), rng.exponential(0.02, m)
    theta = lambda t: offset + ppm * PPM * t  # noqa: E731
    both = estimate_both_ways(t2, there + theta(t2), t3, back - theta(t3))
    low, middle, high = both.offsets(t2)
    assert np.all(low - 1e-9 <= theta(t2)) and np.all(theta(t2) <= high + 1e-9)
    assert np.all(low - 1e-9 <= middle) and np.all(middle <= high + 1e-9)
    alone = estimate_one_way(t2, there + theta(t2), least, float(there.max()))
    low, _, high = alone.offsets(t2)
    assert np.all(low - 1e-9 <= theta(t2)) and np.all(theta(t2) <= high + 1e-9)
    assert alone.drift[0] - 1e-12 <= ppm * PPM <= alone.drift[2] + 1e-12


def test_a_jump_between_two_recordings_is_found() -> None:
    """The other clock jumps by 2 s; what is around it is known as well as without."""
    rng = np.random.default_rng(4)
    t2, t3 = (np.sort(rng.uniform(0, 60, 600)) for _ in range(2))

    def theta(t: np.ndarray) -> np.ndarray:
        return 3 + 50 * PPM * t + np.where(t > 33.3, 2.0, 0.0)

    there, back = 0.002 + rng.exponential(0.001, 600), 0.002 + rng.exponential(0.001, 600)
    found = estimate_both_ways(t2, there + theta(t2), t3, back - theta(t3))
    assert any(abs(step - 33.3) < 1 for step in found.steps)
    low, _, high = found.offsets(t2)
    far = np.abs(t2 - 33.3) > 1
    assert np.all(low[far] <= theta(t2)[far]) and np.all(theta(t2)[far] <= high[far])


def test_one_direction_without_a_largest_delay_has_no_lower_bound() -> None:
    t = np.arange(100.0)
    low, middle, high = estimate_one_way(t, np.full(100, 0.5)).offsets(t)
    assert np.all(low == -inf) and np.all(middle == 0.5) and np.all(high <= 0.5 + 0.1)


def test_packets_before_their_cause_are_refused() -> None:
    t = START + np.arange(100) * 10_000_000
    there, back = RecordedWay(t, t + 10), RecordedWay(t + 5, t - 1_000_000)
    with pytest.raises(ScenarioError, match="arrive before they were sent"):
        judge([there, back], ClockKnowledge("differ"))
    with pytest.raises(ScenarioError, match="expected --clocks differ"):
        judge([back], ClockKnowledge("same"))


def test_simulated_time_at_another_speed_is_refused() -> None:
    t = START + np.arange(1000) * 10_000_000
    simulated = RecordedWay((t - START) * 4 // 5, t)
    with pytest.raises(ScenarioError, match=r"one second of the sender's clock is 1\.25 s"):
        judge([simulated], ClockKnowledge())


def test_a_queue_that_grows_is_no_clock() -> None:
    t = START + np.arange(1000) * 10_000_000
    growing = RecordedWay(t, t + 5_000_000 + (t - START) // 4)
    judged = judge([growing], ClockKnowledge())
    assert judged.clock is None and "+250 ms a second: does a queue grow?" in judged.why
    np.testing.assert_allclose(judged.delays[0], (growing.received - t) * 1e-9)
    slower = RecordedWay(t, t + 5_000_000 + (t - START) // 2000)  # 0.5 ms a second
    assert judge([slower], ClockKnowledge()).clock is not None
    assert judge([slower], ClockKnowledge("same")).clock is None


def test_a_queue_that_grows_one_way_is_no_clock_either() -> None:
    """The way there takes 250 ms more every second; the clock is 5 s ahead and runs 50 ppm fast."""
    clock = drifting(5, 50)
    t = START + np.arange(1000) * 10_000_000
    grows = t + 5_000_000 + (t - START) // 4
    there = RecordedWay(t, np.array([clock(int(x)) for x in grows]))
    back = RecordedWay(np.array([clock(int(x)) for x in t]), t + 5_000_000)
    judged = judge([there, back], ClockKnowledge("differ"))
    low, _, high = judged.offset
    assert low <= 5 <= high and high - low < 0.02
    less = judged.delays[0] - (grows - t) * 1e-9
    more = judged.delays[1] - 0.005
    for error in (less, -more):
        assert np.all((-judged.above <= error) & (error <= judged.below))


def test_simulated_time_at_the_speed_of_the_wall_gives_delays(tmp_path: Path) -> None:
    known = table(n=2000)
    path = recorded.write_mcap(tmp_path / "a.mcap", known, stamp=lambda t: t - START + 10**9)
    result = one(path, known=ClockKnowledge(least=0.002))
    assert "simulated time perhaps" in result.judged.why
    _, delay = known.expected()
    np.testing.assert_allclose(result.links[0].delay, delay, atol=2e-4)


def test_simulated_and_wall_time_in_one_stream_are_named(tmp_path: Path) -> None:
    known = table(n=2000)
    path = recorded.write_mcap(
        tmp_path / "a.mcap", known, stamp=lambda t: t - START + 10**9 if t // 10**7 % 4 == 0 else t
    )
    result = one(path)
    assert any("two clocks are mixed in this stream" in r for r in result.remarks)
    assert result.judged.clock is None  # the wall's are more
    assert float(np.nanmax(result.links[0].delay)) < 0.1


def test_stamps_of_two_hosts_in_one_stream_are_named() -> None:
    """Two senders with losses, one of them with a clock 0.4 s ahead."""
    first, second = table(1, n=1000), table(2, n=600)
    t = np.concatenate([k.sent + k.delay for k in (first, second)])
    stamps = np.concatenate([first.sent, second.sent + 400_000_000])
    there = ~np.concatenate([first.lost, second.lost])
    order = np.argsort(t[there])
    found = one_clock(t[there][order], stamps[there][order])
    assert found.kept.sum() == int(np.sum(~first.lost))
    assert "two senders or hosts are 0.4" in found.remarks[0]


def test_two_routes_are_not_two_clocks() -> None:
    """A third of the packets, at random, takes 0.4 s longer."""
    known = table(n=1000)
    slow = np.random.default_rng(5).random(1000) < 1 / 3
    t = known.sent + known.delay + np.where(slow, 400_000_000, 0)
    order = np.argsort(t)
    found = one_clock(t[order], known.sent[order])
    assert found.kept.all() and not found.remarks


def test_a_step_of_a_clock_is_named_and_a_longer_delay_is_not() -> None:
    known = table(n=1000, lost=0)
    t = known.sent + known.delay
    later = np.arange(1000) >= 300
    found = one_clock(t, known.sent + np.where(later, 2_000_000_000, 0))
    assert "stamps jumped by +2.0" in found.remarks[0] and found.kept.sum() == 700
    found = one_clock(t - np.where(later, 2_000_000_000, 0), known.sent)
    assert "recording jumped by -1.99" in found.remarks[0]
    delayed = one_clock(t + np.where(later, 2_000_000_000, 0), known.sent)
    assert delayed.kept.all() and not delayed.remarks


def test_topics_with_different_clocks_are_named(tmp_path: Path) -> None:
    known = table(n=2000)
    clocks = {"/here": recorded.no_shift, "/far": drifting(0.5, 40), "/sim": lambda t: t - START}
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(recorded.JOINT_STATE, "ros2msg", b"Header header\n")
        for topic, clock in clocks.items():
            channel = writer.register_channel(topic, "cdr", schema)
            for i in known.rows:
                t = known.received(i)
                data = recorded.joint_state(clock(int(known.sent[i])), i)
                writer.add_message(channel, t, data, t)
        writer.finish()
    lines = summary_of_clocks(read_recording(str(tmp_path / "a.mcap")), list(clocks))
    assert lines[0].startswith("3 clocks are mixed in this recording")
    assert [line.strip().partition(":")[0] for line in lines[1:]] == list(clocks)
    with pytest.raises(ScenarioError, match="there are: /far, /here, /sim"):
        of_one_recording(read_recording(str(tmp_path / "a.mcap")), CaptureChoice("/none"), tmp_path)
