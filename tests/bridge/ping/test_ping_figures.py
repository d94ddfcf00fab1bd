"""What is made of stamps whose truth is known: each way, losses, parts, laws."""

import json
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.paths.path import _links
from bridge.ping import figures
from bridge.ping.as_link import fitted, traces
from bridge.ping.exchanges import Arrival, Exchanges, ReceivedAnswer
from bridge.ping.figures import PathResult, evaluate, way_figures
from bridge.ping.packet import LEAST, PingPacket, decode
from bridge.ping.report import text, values
from bridge.realtime.host_clock import HostClock
from cosim.base.errors import RunError
from cosim.links.distributions import Gamma
from cosim.links.losses import GilbertElliott, Independent
from cosim.links.spec import delay_law, loss_model
from cosim.links.traces import read_trace

PERIOD = 10_000_000
N = 400
OFFSET = 7_000_000_000_000  # ns
DRIFT = 30e-6


def _measured(lost_there: set[int], lost_back: set[int], wake: int = 40_000) -> PathResult:
    """20 ms there and 5 ms back with queues; the other clock is OFFSET ahead and drifts."""
    rng = np.random.default_rng(5)
    record = Exchanges("udp test", N, 128, PERIOD)
    heard = 0
    there = 20_000_000 + rng.exponential(1e6, N).astype(int)
    back = 5_000_000 + rng.exponential(1e6, N).astype(int)
    answers = []
    for k in range(N):
        t1 = 1_000_000_000 + k * PERIOD
        record.asked(t1 - 70_000, t1, 9_000)
        if k in lost_there:
            continue
        heard += 1
        t2 = t1 + int(there[k])
        t3 = t2 + wake + 25_000
        other = [round(t + OFFSET + DRIFT * t) for t in (t2, t3)]
        if k not in lost_back:
            answer = ReceivedAnswer(k, other[0], other[1], wake, heard, host=1)
            answers.append((answer, Arrival(b"", t3 + int(back[k]), 15_000)))
    for answer, arrival in answers:
        record.answered(answer, arrival)
    return evaluate(record)


def test_each_way_is_within_the_stated_uncertainty_and_the_sum_is_exact() -> None:
    found = _measured(set(), set())
    assert found.there is not None and found.back is not None and found.below is not None
    rng = np.random.default_rng(5)
    there = 20e-3 + rng.exponential(1e6, N).astype(int) * 1e-9 + 40e-6
    back = 5e-3 + rng.exponential(1e6, N).astype(int) * 1e-9 + 15e-6
    assert found.above is not None
    np.testing.assert_allclose(found.rtt, there + back, atol=2e-6)
    assert np.all(found.there - found.below - 1e-6 <= there)
    assert np.all(there <= found.there + found.above + 1e-6)
    assert 12e-3 < found.uncertainty < 14e-3  # half of 25 ms, nothing tells them apart
    for name, delay in (("there", there), ("back", back)):
        low, high = values(found)["delays"][name]["confidence"]["p50"]
        assert low <= np.median(delay) <= high  # although the estimate is 7.5 ms off
        assert high - low < 0.03
    assert found.parts["turn-round"] == pytest.approx(25e-6, rel=0.01)
    assert found.parts["other wake-up"] == pytest.approx(40e-6)
    assert found.parts["own wake-up"] == pytest.approx(15e-6)
    assert found.late == pytest.approx(70e-6)


def test_losses_are_told_apart_by_the_count_of_the_other_end() -> None:
    found = _measured({50, 51, 52, 200}, {53, 300})
    assert found.loss.there == pytest.approx(4 / N)
    assert found.loss.back == pytest.approx(2 / (N - 4))  # of the answers that were sent
    assert (found.loss.longest, found.loss.outages) == (4, 0)
    there, back = traces(found).values()
    assert np.flatnonzero(np.isnan(there)).tolist() == [50, 51, 52, 200]
    assert np.flatnonzero(np.isnan(back)).tolist() == [53, 300]
    assert any("lost 1.500%" in line and "there 1.000%" in line for line in text(found))


def test_an_outage_is_counted_with_its_length() -> None:
    found = _measured(set(range(100, 130)), set())
    assert found.loss.outages == 1
    assert found.loss.longest_outage == pytest.approx(31 * PERIOD * 1e-9)


def test_the_link_that_is_printed_is_one_that_a_scenario_takes(tmp_path: Path) -> None:
    import tomllib

    found = _measured({50, 51, 52}, set())
    links = _links("udp", found, tmp_path)
    for name, lines in links.items():
        trace = tomllib.loads(lines["trace"])
        assert trace["semantics"] == "newest-stamp"
        law = delay_law(trace["delay"], tmp_path)
        assert law.minimum == pytest.approx(np.nanmin(traces(found)[name]), abs=1e-8)
        other = tomllib.loads(lines["law"])
        assert delay_law(other["delay"], tmp_path).mean == pytest.approx(law.mean, rel=0.02)
        lost = other.get("loss", {"law": "independent", "p": 0.0})  # on the way there only
        assert loss_model(lost).share == pytest.approx(3 / N * (name == "there"), rel=1e-3)
        assert "delay" in lines["netem"]
        assert ("loss gemodel" in lines["netem"]) == (name == "there")
    assert read_trace(tmp_path / "there.csv").delay.size == N
    assert json.dumps(values(found))


def test_a_law_is_fitted_to_draws_of_it() -> None:
    rng = np.random.default_rng(1)
    drawn = 0.02 + rng.gamma(2.0, 0.005, 20_000)
    lost = drawn.copy()
    lost[::400] = np.nan
    law = fitted(lost, 0.0, 0.01)
    assert isinstance(law.law, Gamma) and isinstance(law.loss, Independent)
    assert law.law.shape == pytest.approx(2.0, rel=0.1)
    assert law.error < 2e-4
    lost[::400], lost[40:60] = 0.02, np.nan
    burst = fitted(lost, 0.8, 0.01)
    assert isinstance(burst.law, Gamma) and burst.law.hold == pytest.approx(0.05)
    assert isinstance(burst.loss, GilbertElliott) and burst.loss.burst == pytest.approx(20)


def test_a_quantile_has_an_interval_only_where_enough_packets_arrived() -> None:
    x = np.random.default_rng(0).exponential(1.0, 2000)
    f = way_figures(x)
    low, high = f.ranges[0]
    assert low < np.log(2) < high and high - low < 0.2
    assert f.ranges[3][1] == np.inf and np.isfinite(f.ranges[2][1])
    assert abs(f.lag1) < 0.1
    repeated = way_figures(np.repeat(x, 20))  # tells no more, although there are more of them
    assert repeated.lag1 == pytest.approx(0.95, abs=0.05) and repeated.independent[0] <= 2000
    assert np.ptp(repeated.ranges[0]) >= 0.9 * np.ptp(f.ranges[0])


def test_memory_is_bounded_and_figures_are_of_the_last_questions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bridge.ping.exchanges.CAPACITY", 16)
    record = Exchanges("test", 10_000, 128, PERIOD)
    for k in range(40):
        record.asked(k * PERIOD, k * PERIOD, 0)
        record.answered(ReceivedAnswer(k), Arrival(b"", k * PERIOD + 1000 * (k + 1)))
    record.answered(ReceivedAnswer(39), Arrival(b"", 40 * PERIOD))
    record.answered(ReceivedAnswer(3), Arrival(b"", 40 * PERIOD))
    found = evaluate(record)
    assert (record.duplicates, record.strange, found.rtt.size) == (1, 1, 16)
    np.testing.assert_allclose(found.rtt, 1e-6 * (np.arange(24, 40) + 1), rtol=1e-6)
    assert found.there is None and list(traces(found)) == ["half"]


def test_nothing_answered_says_what_to_do() -> None:
    record = Exchanges("udp 10.0.0.1:1", 10, 128, PERIOD)
    record.asked(0, 0, 0)
    with pytest.raises(RunError, match="none of 1 questions was answered; expected a responder"):
        evaluate(record)


def test_a_packet_is_read_as_written_and_nothing_else_is() -> None:
    packet = PingPacket(False, 2**63, 7, 8)
    data = packet.encode(200)
    assert len(data) == 200 and decode(data) == packet
    answer = packet.answered(heard=1, t2=-5, wake=6, t3=7, date=8, error=9)
    assert decode(answer.encode()) == answer and answer.answer
    for broken in (b"", data[: LEAST - 1], b"XPNG" + data[4:], data[:4] + b"\2" + data[5:]):
        assert decode(broken) is None


@pytest.mark.parametrize("kept", [True, False])
def test_dates_that_time_servers_keep_narrow_each_way(
    kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other date is 1 ms ahead; both hosts say that theirs is right to 1 and 0.5 ms."""
    monkeypatch.setattr(figures, "host_clock", lambda: HostClock("here", kept, 1e-3))
    monkeypatch.setattr(figures, "realtime_offset_ns", lambda: 10**18)
    record = Exchanges("udp test", N, 128, PERIOD)
    for k in range(N):
        t1 = 1_000_000_000 + k * PERIOD
        record.asked(t1, t1, 9_000)
        t2 = t1 + 20_000_000
        date = 10**18 - OFFSET + 1_000_000
        answer = ReceivedAnswer(
            k, t2 + OFFSET, t2 + OFFSET, 0, k + 1, host=1, date=date, error=500_000
        )
        record.answered(answer, Arrival(b"", t2 + 4_000_000))
    found = evaluate(record)
    said = "\n".join(text(found))
    assert found.there is not None and found.dates is not None
    if kept:
        assert 1.5e-3 <= found.uncertainty < 3.1e-3  # of 12 ms without dates
        assert abs(found.there[0] - 20e-3) <= found.uncertainty
        assert found.dates == pytest.approx(1e-3, abs=found.uncertainty)
        assert "time servers keep the date of both hosts: here to 1 ms, there to 0.5 ms" in said
    else:
        assert found.uncertainty > 11e-3
        assert "the hosts do not share a date: no time server keeps it here; a common" in said
    assert values(found)["date_errors"] == [1e-3 if kept else None, 5e-4]
