"""A known table of delays comes out of every kind of recording exactly."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin

from bridge.captures.evaluation import CaptureChoice, of_one_recording, of_two_recordings
from bridge.captures.judged import ClockKnowledge
from bridge.captures.reading import read_recording
from bridge.captures.report import CaptureResult
from bridge.captures.samples import StreamRows
from bridge.captures.ways import one_way
from bridge.ping.exchanges import NONE
from cosim.base.errors import ScenarioError
from cosim.links.traces import read_trace
from tests.bridge.captures import recorded
from tests.bridge.captures.recorded import KnownTable, table

TOPIC = "/joint_states"


def one(path: Path, topic: str = TOPIC, **choice: object) -> CaptureResult:
    chosen = CaptureChoice(topic, **choice)  # type: ignore[arg-type]
    return of_one_recording(read_recording(str(path)), chosen, path.parent / "out")


def two(files: Sequence[str], folder: Path, **choice: object) -> CaptureResult:
    first, second = (read_recording(file) for file in files)
    return of_two_recordings(first, second, CaptureChoice(**choice), folder)  # type: ignore[arg-type]


def same(result: CaptureResult, known: KnownTable, link: int = 0) -> None:
    """The file has the table to the last nanosecond, and losses where they were."""
    found = read_trace(result.links[link].file)
    sent, delay = known.expected()
    np.testing.assert_array_equal(np.rint(found.t_send * 1e9), np.rint(sent * 1e9))
    np.testing.assert_array_equal(np.rint(found.delay * 1e9), np.rint(delay * 1e9))


@pytest.mark.parametrize("options", [{}, {"numbered": True}, {"publish": True}])
def test_mcap(tmp_path: Path, options: dict[str, bool]) -> None:
    known = table()
    result = one(recorded.write_mcap(tmp_path / "a.mcap", known, **options))
    same(result, known)
    assert result.judged.clock is None
    how = "by their numbers" if "numbered" in options else "by gaps in a regular stream"
    assert result.links[0].way.how == how
    assert result.stamps.startswith("time of publishing" if "publish" in options else "header")


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_bags(tmp_path: Path, plugin: StoragePlugin) -> None:
    known = table()
    same(one(recorded.write_bag(tmp_path / "bag", known, plugin)), known)
    if plugin == StoragePlugin.SQLITE3:
        same(one(next((tmp_path / "bag").glob("*.db3"))), known)


def test_csv(tmp_path: Path) -> None:
    known = table()
    path = recorded.write_csv(tmp_path / "a.csv", known)
    same(one(path, "a"), known)
    path.write_text(path.read_text().replace("seq,sent_ns,received_ns", "n;b_ns;a_ns"))
    path.write_text(path.read_text().replace(",", ";"))
    renamed = read_recording(str(path), columns=("b_ns", "a_ns", "n"))
    same(of_one_recording(renamed, CaptureChoice("a"), tmp_path), known)


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng"])
def test_captures_of_both_ends_with_one_clock(tmp_path: Path, suffix: str) -> None:
    there, back = table(1), table(2)
    files = recorded.write_ends(tmp_path, there, back, recorded.no_shift, suffix)
    known = ClockKnowledge("same")
    result = two([str(f) for f in files], tmp_path, known=known)
    same(result, there, 0)
    same(result, back, 1)
    assert result.links[0].way.how == "by the other recording"


def test_captures_in_the_wrong_order_are_put_right(tmp_path: Path) -> None:
    there, back = table(1), table(2, n=300)
    files = recorded.write_ends(tmp_path, there, back, recorded.no_shift)
    result = two([str(f) for f in files[::-1]], tmp_path)
    assert [link.way.sent.size for link in result.links] == [300, 400]
    assert all(np.nanmin(link.delay) >= 0 for link in result.links)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_gateway_in_one_log(tmp_path: Path, suffix: str) -> None:
    known = table(unit=1_000_000)  # .asc has microseconds of a float
    path = recorded.write_gateway(tmp_path / f"gw{suffix}", known)
    channels = sorted({s.partition(" ")[0] for s in read_recording(str(path)).streams.names})
    result = two([f"{path}@{channel}" for channel in channels], tmp_path)
    found = read_trace(result.links[0].file)
    sent, delay = known.expected()
    np.testing.assert_allclose(found.t_send, sent, atol=2e-6)
    np.testing.assert_allclose(found.delay, delay, atol=2e-6)
    assert result.links[0].semantics == "last-arrival" and result.judged.clock is None


@pytest.mark.parametrize("lost", [0.0, 0.05, 0.3])
def test_a_gateway_whose_frames_count_to_16(tmp_path: Path, lost: float) -> None:
    """Contents repeat after 80 ms, delays are shorter."""
    known = table(unit=1_000_000, lost=lost)
    path = recorded.write_gateway(tmp_path / "gw.log", known, 16)
    result = two([f"{path}@can1", f"{path}@can2"], tmp_path)
    found = read_trace(result.links[0].file)
    np.testing.assert_allclose(found.delay, known.expected()[1], atol=2e-6)
    assert any("repeat after 80 ms" in r for r in result.remarks) == (lost == 0.3)


def test_contents_that_are_all_the_same_tell_nothing_apart(tmp_path: Path) -> None:
    known = table(unit=1_000_000, lost=0.05)
    path = recorded.write_gateway(tmp_path / "gw.log", known, 1)
    other = tmp_path / "other.log"
    other.write_text(path.read_text())
    with pytest.raises(ScenarioError, match="expected a counter or a stamp"):
        two([f"{path}@can1", f"{other}@can2"], tmp_path)
    result = two([f"{path}@can1", f"{path}@can2"], tmp_path)
    assert any("repeat after 5 ms" in r for r in result.remarks)
    assert float(np.nanmax(result.links[0].delay)) <= 0.005


def test_a_regular_sender_with_one_stamp(tmp_path: Path) -> None:
    known = table(lost=0.02, scale=2e5)
    path = recorded.write_mcap(tmp_path / "a.mcap", known)
    result = one(path, period_ns=5_000_000, known=ClockKnowledge(least=0.002))
    _, delay = known.expected()
    np.testing.assert_array_equal(np.isnan(result.links[0].delay), known.lost)
    np.testing.assert_allclose(result.links[0].delay, delay, atol=5e-5)
    with pytest.raises(ScenarioError, match="is --period right"):
        one(path, period_ns=9_000_000)


def test_duplicates_are_counted_once(tmp_path: Path) -> None:
    known = table(n=50)
    path = recorded.write_csv(tmp_path / "a.csv", known)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:20], lines[19], lines[19], *lines[20:]]) + "\n")
    result = one(path, "a")
    same(result, known)
    assert result.links[0].way.repeated == 2
    assert any("came twice" in remark for remark in result.remarks)


def test_stamps_out_of_order_are_sorted_and_counted(tmp_path: Path) -> None:
    known = table(lost=0)
    rng = np.random.default_rng(3)
    delay = known.delay + rng.integers(0, 20_000_000, known.delay.size)
    known = KnownTable(known.sent, delay, known.lost)
    result = one(recorded.write_mcap(tmp_path / "a.mcap", known))
    same(result, known)
    arrivals = known.sent + known.delay
    late = int(np.sum(arrivals < np.maximum.accumulate(arrivals)))
    assert result.links[0].way.overtaken == late > 0


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 10**9), st.integers(0, 10**10), st.booleans()), min_size=5)
)
def test_numbered_samples_are_recovered_whatever_their_times(
    rows: list[tuple[int, int, bool]],
) -> None:
    """Any increasing times of sending, any delays, and any losses but those at the ends."""
    sent = START_NS + np.cumsum([gap for gap, _, _ in rows])
    delay = np.array([d for _, d, _ in rows])
    lost = np.array([gone for _, _, gone in rows])
    lost[[0, 1, -1]] = False
    n = np.arange(sent.size)
    keep = np.flatnonzero(~lost)[np.argsort((sent + delay)[~lost], kind="stable")]
    none = np.full(keep.size, NONE)
    stream = StreamRows((sent + delay)[keep], n[keep], none, sent[keep], n[keep])
    way = one_way(stream, sent[keep])
    arrived, came = way.there
    np.testing.assert_array_equal(arrived, sent[~lost])
    np.testing.assert_array_equal(came, (sent + delay)[~lost])
    assert np.all(np.diff(way.sent) > 0)
    if way.how == "by their numbers":
        between = np.diff(sent[~lost]) > np.diff(n[~lost])  # room for them in ns
        assert way.lost.sum() == lost.sum() or not between.all()


START_NS = recorded.START
