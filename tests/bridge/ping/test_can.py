"""Round trips on a CAN bus with exact frame times, with our responder and a drive's answers."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest

from bridge.can.interface import CanBusSpec
from bridge.can.plain import PlainBus
from bridge.cli.paths.path import EndOptions, PathRequest, ping_path
from bridge.native.frame import Flags, Frame
from bridge.ping.can import (
    ASK,
    CanCodec,
    CanPath,
    CanQuestion,
    CanResponder,
    DriveCodec,
    can_lines,
    parse_question,
    transmission,
)
from bridge.ping.exchanges import Exchanges
from bridge.ping.figures import evaluate
from bridge.ping.measure import PingPlan, measure
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import ScenarioError
from cosim.bus.timing import BusTiming
from tests.bridge.ping.test_paths import answering

RATE = 125_000
TIMING = BusTiming(RATE)


def _spec(channel: str) -> CanBusSpec:
    return CanBusSpec(channel, interface="cosim", channel=channel, bitrate=RATE)


def test_a_round_trip_takes_at_least_its_bits_and_each_way_is_bounded() -> None:
    asks = CanQuestion(ASK, b"", ASK + 1)
    near = CanPath(_spec("ping-1"), asks, ASK + 1, TIMING)
    far = CanPath(_spec("ping-1"), CanQuestion(ASK + 1, b"", ASK), ASK)
    other = PlainBus(_spec("ping-1"))
    record = Exchanges("can", 40, 8, 5_000_000)
    with answering(CanResponder(far)):
        other.send(Frame.of(0x100, bytes(8)))
        measure(near, CanCodec(), PingPlan(5_000_000, 40), record)
    for end in (near, far, other):
        end.close()
    found = evaluate(record)
    question, answer = transmission(asks, TIMING)
    assert record.received == 40 and found.there is not None
    assert found.below is not None and found.above is not None
    # A frame is received three bits before its time ends.
    assert np.all(found.there + found.above >= question - 3 / RATE - 2e-6)
    assert np.all(found.rtt >= question + answer - 6 / RATE - 5e-6)
    assert (near.others, near.others_ns > 800_000) == (1, True)
    [time, load] = can_lines(near, asks, TIMING, float(np.median(found.rtt)), 0.2)
    assert f"question {1e6 * question:.0f} us" in time and load.startswith("1 other frames, 0.5 %")


def test_a_drive_that_answers_a_refresh_is_measured_without_anything_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The drive answers 1 or 4 ms late and keeps its own delays."""
    drive, done = PlainBus(_spec("ping-2")), threading.Event()
    turns: list[int] = []

    def serve() -> None:
        while not done.is_set():
            found = drive.receive(monotonic_ns() + 20_000_000)
            if found and found.frame.payload[:3] == bytes.fromhex("0100CC"):
                sleep((0.001, 0.004)[len(turns) % 2])
                turns.append(monotonic_ns() - found.t_ns)
                drive.send(Frame.of(0x011, bytes(8)))

    thread = threading.Thread(target=serve)
    thread.start()
    end = EndOptions(interface="cosim", bitrate=RATE, ask="7FF#0100CC0000000000", answer="011")
    try:
        ping_path(PathRequest("can", "ping-2", 50, 8, 0.4, tmp_path, end), tmp_path / "said.json")
    finally:
        done.set()
        thread.join()
        drive.close()
    table = np.genfromtxt(tmp_path / "half.csv", delimiter=",", skip_header=1)
    bits = sum(transmission(parse_question(end.ask, end.answer), TIMING))
    rest = 2 * table[:, 1] - np.array(turns) * 1e-9
    # What is left without the drive's own time are the frames, and neither rises with it: the
    # least of each, for a busy machine adds to some. An answer that it delays too long is lost.
    assert np.nanmin(rest) >= bits - 6 / RATE - 5e-6
    later = np.median(turns[1::2]) - np.median(turns[::2])
    assert abs(np.nanmin(rest[1::2]) - np.nanmin(rest[::2])) < 0.2 * later * 1e-9
    found = json.loads((tmp_path / "said.json").read_text("utf-8"))
    assert found["answered"] == np.isfinite(rest).sum() >= 10 and list(found["delays"]) == [
        "round trip"
    ]
    assert found["uncertainty"] is None and list(found["links"]) == ["half"]


def test_numbers_and_times_that_wrap_are_completed() -> None:
    codec = CanCodec()
    first = codec.answer(bytes.fromhex("ffff 0500 feffffff".replace(" ", "")), 65536)
    later = codec.answer(bytes.fromhex("0100 0700 02000000".replace(" ", "")), 65540)
    assert first is not None and later is not None
    assert (first.k, later.k) == (65535, 65537)
    assert later.t2 - first.t2 == 4000 and later.t3 - later.t2 == 7000
    assert codec.answer(b"123", 1) is None


def test_a_question_is_written_as_for_cansend() -> None:
    damiao = parse_question("7FF#0100CC0000000000", "011")
    assert (damiao.identifier, damiao.answer, damiao.data[2]) == (0x7FF, 0x11, 0xCC)
    assert DriveCodec(damiao).question(5, 0) == damiao.data
    odrive = parse_question("009#R", "9")
    assert odrive.frame(b"x").flags == Flags.REMOTE and odrive.frame(b"x").length == 0
    assert parse_question("18FF0001#00", "18FF0002").flags == Flags.EXTENDED
    for ask, answer in (("7FF", "1"), ("7FF#0", "1"), ("7FF#00", ""), ("#00", "1")):
        with pytest.raises(ScenarioError, match="expected ID#DATA"):
            parse_question(ask, answer)
