"""Listening only: streams whose gaps and stamps are known, on CAN and over Zenoh."""

import json
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from zenoh import CongestionControl
from zenoh.ext import Int64, z_serialize

from bridge.can.interface import CanBusSpec
from bridge.can.plain import PlainBus
from bridge.cli.paths.listen import ping_listen
from bridge.cli.paths.path import EndOptions
from bridge.native.frame import Frame
from bridge.ping.exchanges import NONE
from bridge.ping.listening import HeardStreams, StreamSample, stream_lines, zenoh_sample
from bridge.ping.ros import RosAttachment, attachment, header_stamp
from bridge.zenoh.exchange import plain_session
from cosim.base.clock import realtime_ns, sleep
from cosim.base.errors import CosimError
from tests.bridge.zenoh.ends import endpoint

JOINTS = "0/joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_a13e"
MS = 1_000_000


def _attached(sequence: int, date_ns: int) -> bytes:
    """As rmw_zenoh makes it, by Zenoh's own serialisation."""
    return bytes(z_serialize((Int64(sequence), Int64(date_ns), bytes(range(16)))))


def _joint_state(stamp_ns: int) -> bytes:
    header = struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9)
    return b"\0\1\0\0" + header + struct.pack("<I", 1) + bytes(16)


def test_attachments_of_both_forms_are_read() -> None:
    new = _attached(7, 123_456)
    assert len(new) == 33 and attachment(new) == RosAttachment(7, 123_456)
    old = b"\x0fsequence_number" + struct.pack("<q", 9)
    old += b"\x10source_timestamp" + struct.pack("<q", 1000) + b"\x0asource_gid\x10" + bytes(16)
    assert attachment(old) == RosAttachment(9, 1000)
    for broken in (b"", new[:-1], b"\x0fsequence_nombre" + old[16:], old[:30]):
        assert attachment(broken) is None


def test_the_stamp_of_the_content_is_read_where_the_type_has_a_header() -> None:
    assert header_stamp(JOINTS, _joint_state(5_000_000_007)) == 5_000_000_007
    big = b"\0\0\0\0" + struct.pack(">iI", 5, 7)
    assert header_stamp(JOINTS, big) == 5_000_000_007
    twist = "0/cmd/geometry_msgs::msg::dds_::TwistStamped_/x"
    assert header_stamp(twist, _joint_state(1)) == 1
    assert header_stamp(twist.replace("Stamped", ""), _joint_state(1)) is None
    assert header_stamp(JOINTS, b"\0\1\0\0\1") is None


def _stream(numbers: list[int], numbered: bool, age_ns: int = 2 * MS) -> HeardStreams:
    heard = HeardStreams()
    for k in numbers:
        t, date = k * 10 * MS, 10**18 + k * 10 * MS
        sequence = k if numbered else NONE
        heard.add("x", StreamSample(t, date, sequence, date - age_ns, date - 2 * age_ns))
    return heard


def test_losses_are_counted_by_numbers_and_by_gaps() -> None:
    numbers = [k for k in range(100) if k not in (20, 21, 22, 60)]
    for numbered in (True, False):
        f = _stream(numbers, numbered).figures()["x"]
        assert (f.lost, f.numbered, f.n) == (4, numbered, 96)
        assert f.share_lost == pytest.approx(0.04)
        assert f.period.quantiles[0] == pytest.approx(0.01)
        assert f.period.maximum == pytest.approx(0.04)
    swapped = _stream([0, 1, 3, 2, 4], True).figures()["x"]
    assert (swapped.lost, swapped.repeated) == (0, 1)


def test_ages_are_those_of_the_stamps_and_foreign_clocks_are_named() -> None:
    f = _stream(list(range(10)), True).figures()["x"]
    assert f.ages["since publishing"].mean == pytest.approx(0.002)
    assert f.ages["of the content"].mean == pytest.approx(0.004)
    far = _stream(list(range(10)), True, age_ns=10**18 // 2).figures()["x"]
    assert not far.ages or "of the content" not in far.ages
    assert "simulated time" in " ".join(stream_lines("x", far))
    ahead = _stream(list(range(10)), True, age_ns=-MS).figures()["x"]
    assert "clocks of the hosts differ" in " ".join(ahead.remarks)
    empty = HeardStreams()
    for k in range(5):
        empty.add("x", StreamSample(k * MS, 10**18, NONE, NONE, 0))
    assert "does not fill the stamp" in " ".join(empty.figures()["x"].remarks)


def test_zenoh_stamps_count_where_ros_says_nothing() -> None:
    plain = zenoh_sample("a/b", b"x", None, 5, 1, 2)
    assert plain == StreamSample(1, 2, NONE, 5, NONE)
    ros = zenoh_sample(JOINTS, _joint_state(9), _attached(3, 4), 5, 1, 2)
    assert ros == StreamSample(1, 2, 3, 4, 9)


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.ping.listening.KEPT", 8)
    monkeypatch.setattr("bridge.ping.listening.STREAMS", 1)
    heard = _stream(list(range(21)), True)
    heard.add("y", StreamSample(1, 1))
    f = heard.figures()["x"]
    assert (f.n, f.lost, f.period.n, heard.ignored) == (8, 0, 7, 1)
    assert f.period.minimum == pytest.approx(f.period.maximum) == pytest.approx(0.01)


@contextmanager
def _repeated(send: Callable[[int], None], seconds: float = 0.005) -> Iterator[None]:
    done = threading.Event()

    def run() -> None:
        k = 0
        while not done.is_set():
            send(k)
            k += 1
            sleep(seconds)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_a_ros_topic_is_heard_over_zenoh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = endpoint(tmp_path)
    with plain_session(at, listen=True) as session:

        def send(k: int) -> None:
            if k % 10 == 5:  # a number that nobody hears
                return
            date = realtime_ns()
            session.put(
                JOINTS, _joint_state(date - 3 * MS), attachment=_attached(k, date),
                congestion_control=CongestionControl.BLOCK,  # none is dropped if none is read yet
            )  # fmt: skip

        with _repeated(send):
            ping_listen(
                ["zenoh", "0/joint_states/**"], identifier="", connect=at, duration=0.5,
                json=tmp_path / "said.json", end=EndOptions(),
            )  # fmt: skip
    [(name, found)] = json.loads((tmp_path / "said.json").read_text("utf-8"))["streams"].items()
    assert name == JOINTS and found["lost_by"] == "number"
    assert found["lost"] == pytest.approx(found["n"] / 9, abs=1.2)
    since, content = found["ages"]["since publishing"], found["ages"]["of the content"]
    assert since["min"] > 0
    assert content["min"] == pytest.approx(since["min"] + 0.003, abs=1e-5)


def test_an_identifier_is_heard_on_can(capsys: pytest.CaptureFixture[str]) -> None:
    spec = CanBusSpec("listen-1", interface="cosim", channel="listen-1", bitrate=500_000)
    bus = PlainBus(spec)

    def send(k: int) -> None:
        bus.send(Frame.of(0x123, bytes(8)))
        bus.send(Frame.of(0x124, bytes(2)))

    with _repeated(send):
        ping_listen(
            ["can", "listen-1"], identifier="0x123", connect="", duration=0.3, json=None,
            end=EndOptions(interface="cosim", bitrate=500_000),
        )  # fmt: skip
    bus.close()
    said = capsys.readouterr().out
    assert said.startswith("123: ") and "124" not in said.splitlines()[0]
    period = float(said.partition("period p50 ")[2].split()[0])
    assert "by gaps" in said and period >= 5  # ms, which the sender sleeps


@pytest.mark.parametrize(
    ("target", "identifier", "said"),
    [
        (["udp", "x"], "", "found 'udp x'; expected can CHANNEL or zenoh KEY"),
        (["can", "nobody"], "zz", "found --id 'zz'; expected a hexadecimal identifier"),
        (["can", "nobody"], "", "0 samples heard; expected at least three"),
    ],
)
def test_what_cannot_be_heard_is_said(target: list[str], identifier: str, said: str) -> None:
    end = EndOptions(interface="cosim", bitrate=500_000)
    with pytest.raises(CosimError, match=said):
        ping_listen(target, identifier=identifier, connect="", duration=0.01, json=None, end=end)
