"""Logs: put together from several nodes, and read by the tools that others use."""

import shutil
import subprocess
import sys
from io import StringIO
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.log import (
    FrameLog,
    LogError,
    candump_lines,
    merge_node_logs,
    read_log,
    rows_of,
    write_log,
)
from bridge.native.frame import Flags, Frame

LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


@st.composite
def frames(draw, exact: bool = True) -> Frame:
    fd, extended = draw(st.booleans()), draw(st.booleans())
    length = draw(st.sampled_from(LENGTHS if fd else LENGTHS[:9]))
    flags = (Flags.FD if fd else 0) | (Flags.EXTENDED if extended else 0)
    if fd:
        flags |= draw(st.sampled_from([0, Flags.BRS, Flags.BRS | Flags.ESI]))
    identifier = draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF))
    t_us = draw(st.integers(0, 10**12))
    return Frame.of(
        identifier, draw(st.binary(min_size=length, max_size=length)), flags, t_us * 1000
    )


def log(*given: Frame, buses: tuple[str, ...] = ("vcan0",)) -> FrameLog:
    return FrameLog(rows_of(given), buses)


def keys(found: FrameLog) -> list[tuple]:
    return [(f.key(), int(bus)) for f, bus in zip(found.frames(), found.rows["bus"], strict=True)]


@given(st.lists(frames(), max_size=20))
def test_candump_text_comes_back_to_the_microsecond(tmp_path_factory, given):
    path = tmp_path_factory.mktemp("log") / "a.log"
    write_log(log(*given), path)
    found = read_log(path)
    assert [f.key() for f in found.frames()] == [f.key() for f in given]
    assert found.rows["t_ns"].tolist() == [f.t_ns for f in given]


@given(st.lists(frames(), min_size=1, max_size=10))
def test_python_can_reads_candump_text(given):
    text = "\n".join(candump_lines(log(*given)))
    messages = list(can.CanutilsLogReader(StringIO(text)))
    assert [(m.arbitration_id, m.is_extended_id, m.is_fd, bytes(m.data)) for m in messages] == [
        (f.id, bool(f.flags & Flags.EXTENDED), bool(f.flags & Flags.FD), f.payload) for f in given
    ]
    assert [m.bitrate_switch for m in messages] == [bool(f.flags & Flags.BRS) for f in given]


def test_lines_are_those_of_candump():
    given = log(
        Frame.of(0x1A0, b"\x01\x02", 0, 1_436_509_052_249_713_999),
        Frame.of(0x1A0, b"", Flags.EXTENDED, 2_000_000_000),
        Frame.of(0x7FF, bytes(12), Flags.FD | Flags.BRS, 3_000_000_000),
        Frame.of(0x4, bytes(8), Flags.ERROR, 4_000_000_000),
        Frame.of(0x12, b"", Flags.REMOTE, 5_000_000_000),
    )
    assert list(candump_lines(given, wall_ns=1000)) == [
        "(1436509052.249714) vcan0 1A0#0102",
        "(2.000001) vcan0 000001A0#",
        "(3.000001) vcan0 7FF##1000000000000000000000000",
        "(4.000001) vcan0 20000004#0000000000000000",
        "(5.000001) vcan0 012#R",
    ]


@pytest.mark.parametrize("suffix", ["blf", "asc", "mf4"])
def test_other_formats_come_back(tmp_path: Path, suffix: str):
    rng = np.random.default_rng(1)
    given = [
        Frame.of(0x100 + n, rng.bytes(n), Flags.FD | Flags.BRS, 10**9 + n * 10**6) for n in LENGTHS
    ] + [Frame.of(0x10 + n, rng.bytes(n), Flags.EXTENDED, 2 * 10**9 + n * 10**6) for n in range(9)]
    for frame in given[::2]:
        frame.bus = 1
    path = tmp_path / f"a.{suffix}"
    wall = 1_700_000_000 * 10**9
    write_log(log(*given, buses=("left", "right")), path, wall)
    found = read_log(path, wall)
    assert [f.key() for f in found.frames()] == [f.key() for f in given]
    assert len(set(found.rows["bus"])) == 2
    t = found.rows["t_ns"] - [f.t_ns for f in given]
    assert np.ptp(t) <= 100_000  # BLF counts in 10 us or ns, ASC from the first frame


LATE = """
import sys
import bridge, can
assert can.io.mf4.asammdf is None and "asammdf" not in sys.modules
with can.Logger(sys.argv[1]) as writer:
    writer(can.Message(arbitration_id=5, data=b"12", timestamp=1.0, channel=1))
with can.LogReader(sys.argv[1]) as reader:
    assert [bytes(message.data) for message in reader] == [b"12"]
assert "asammdf" in sys.modules
"""


def test_asammdf_waits_for_the_first_mf4_log(tmp_path: Path):
    """It imports pandas and polars: half a second and 90 MiB for each process with a bus."""
    command = [sys.executable, "-c", LATE, str(tmp_path / "a.mf4")]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which("log2asc") is None, reason="can-utils are not installed")
def test_log2asc_reads_candump_text(tmp_path: Path):
    write_log(
        log(*(Frame.of(i, bytes([i]), 0, i * 10**9) for i in range(1, 6))), tmp_path / "a.log"
    )
    command = ["log2asc", "-I", str(tmp_path / "a.log"), "vcan0"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [line.split()[2] for line in lines if " Rx " in line] == list("12345")


def test_cantools_decodes_candump_text(tmp_path: Path):
    dbc = 'VERSION ""\nBU_: A\nBO_ 416 LINK: 4 A\n SG_ xi1 : 0|16@1- (0.5,0) [0|0] "" A\n'
    database = cantools.database.load_string(dbc)
    write_log(log(Frame.of(416, (7).to_bytes(4, "little"))), tmp_path / "a.log")
    parser = cantools.logreader.Parser((tmp_path / "a.log").open())
    (found,) = [frame for _, frame in parser.iterlines() if frame]
    assert database.decode_message(found.frame_id, found.data) == {"xi1": 3.5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("(1.0) vcan0 123#0G", r"a\.log:1: .*non-hexadecimal"),
        ("(1.0) vcan0 123#00\nhello", r"a\.log:2: 'hello'; expected \(seconds\) bus id#data"),
        ("(1.0) vcan0 123#000102030405060708", "9 bytes"),
        ("(1.0) vcan0 123##", "invalid literal"),
    ],
)
def test_what_is_no_candump_text_is_refused_with_its_line(tmp_path: Path, text: str, message: str):
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(LogError, match=message):
        read_log(tmp_path / "a.log")


def test_unknown_formats_are_refused(tmp_path: Path):
    with pytest.raises(LogError, match=r"expected \.log, \.asc, \.blf, \.mf4"):
        write_log(log(), tmp_path / "a.txt")
    (tmp_path / "a.blf").write_bytes(b"no such thing at all")
    with pytest.raises(LogError, match=r"expected a \.blf log"):
        read_log(tmp_path / "a.blf")


def sent(t: int, identifier: int = 1, data: bytes = b"x") -> Frame:
    return Frame.of(identifier, data, Flags.SENT, t)


def received(t: int, identifier: int = 1, data: bytes = b"x") -> Frame:
    return Frame.of(identifier, data, 0, t)


def test_each_frame_is_there_once_and_at_its_senders_time():
    a = log(sent(100), sent(300), received(250, 2))
    b = log(received(110), received(310), sent(200, 2))
    listener = log(received(105), received(205, 2), received(305))
    found = merge_node_logs([a.rows, b.rows, listener.rows])
    assert found["t_ns"].tolist() == [100, 200, 300]
    assert found["id"].tolist() == [1, 2, 1]
    assert found["flags"].tolist() == [Flags.SENT] * 3


def test_frames_of_others_are_those_of_who_heard_most():
    found = merge_node_logs([log(received(10)).rows, log(received(11), received(29)).rows])
    assert found["t_ns"].tolist() == [11, 29]


@given(st.data())
def test_what_was_sent_is_what_is_left(data):
    """Few contents, receivers are late and lose frames: all that were sent, once."""
    n = data.draw(st.integers(1, 4))
    logs: list[list[Frame]] = [[] for _ in range(n)]
    times = sorted(data.draw(st.sets(st.integers(0, 10**6), max_size=20)))
    for t in times:
        sender, content = data.draw(st.tuples(st.integers(0, n - 1), st.binary(max_size=1)))
        logs[sender].append(sent(t, 1, content))
        for other in set(range(n)) - {sender}:
            if data.draw(st.booleans()):
                logs[other].append(received(t + data.draw(st.integers(0, 10**4)), 1, content))
    assert merge_node_logs([log(*frames).rows for frames in logs])["t_ns"].tolist() == times
