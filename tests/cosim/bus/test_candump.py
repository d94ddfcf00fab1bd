"""Logs of candump: those of other programs are read, other files are refused."""

from __future__ import annotations

from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.errors import CosimError
from cosim.bus.candump import candump_lines, read_candump
from cosim.bus.frames import BusFrame, frame_of
from cosim.bus.timing import FrameFormat


def read(tmp_path: Path, text: str) -> list[BusFrame]:
    path = tmp_path / "bus.log"
    path.write_text(text)
    return [frame_of(row) for row in read_candump(path)[1]]


def test_every_kind_of_frame_is_read(tmp_path: Path) -> None:
    text = """\
(1.5) can0 123#1122
(1.500001) can0 12345678#
(1.500002) can0 123#R5
(1.500003) can0 123#R

(1.500004) can0 123##51122 T
(1.500005) can0 123#11.22
(1.500006) can0 20000004#0000000000000000
"""
    assert read(tmp_path, text) == [
        BusFrame(0x123, b"\x11\x22"),
        BusFrame(0x12345678, b"", FrameFormat(extended=True)),
        BusFrame(0x123, b"", FrameFormat(remote=True), 5),
        BusFrame(0x123, b"", FrameFormat(remote=True)),
        BusFrame(0x123, b"\x11\x22", FrameFormat(fd=True, brs=True)),
        BusFrame(0x123, b"\x11\x22"),
    ]


@pytest.mark.parametrize(("digits", "times"), [(6, [0, 10**6]), (9, [0, 1_234_000])])
def test_frames_of_every_kind_are_written_and_read_back(
    tmp_path: Path, digits: int, times: list[int]
) -> None:
    """Times are rounded down to the last digit."""
    kinds = [
        BusFrame(0x123, b"\x11\x22"),
        BusFrame(0x12345678, b"", FrameFormat(extended=True)),
        BusFrame(0x123, b"", FrameFormat(remote=True), 5),
        BusFrame(0x123, b"\x11\x22", FrameFormat(fd=True, brs=True)),
        BusFrame(0x123, bytes(64), FrameFormat(extended=True, fd=True, esi=True)),
    ]
    for frame in kinds:
        path = tmp_path / "bus.log"
        path.write_text(candump_lines([(0, frame), (1_234_567, frame)], "can0", digits))
        at, rows = read_candump(path)
        assert list(at) == times
        assert [frame_of(row) for row in rows] == [frame, frame]


def test_frames_are_in_the_order_of_their_times(tmp_path: Path) -> None:
    (path := tmp_path / "bus.log").write_text("(2.000000001) a 001#\n(1.5) a 002#\n(1.5) a 003#\n")
    times, rows = read_candump(path)
    assert times.tolist() == [0, 0, 500_000_001_000]
    assert rows["id"].tolist() == [2, 3, 1]


def test_times_since_1970_are_exact(tmp_path: Path) -> None:
    """The example of can-utils: as candump writes them without an option."""
    path = tmp_path / "bus.log"
    path.write_text("(1436509053.850870) vcan0 1FFFFFFF#R\n(1436509052.249713) vcan0 044#2A\n")
    times, rows = read_candump(path)
    assert times.tolist() == [0, 1_601_157_000_000]
    assert rows["id"].tolist() == [0x044, 0x1FFFFFFF]


def test_what_python_can_writes_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    sent = [
        can.Message(1.25, 0x123, False, data=b"\1\2\3"),
        can.Message(2.5, 0x1ABCDEF0, True, data=bytes(8)),
        can.Message(3.75, 0x7FF, False, is_remote_frame=True, dlc=4),
        can.Message(4.0, 0x55, False, is_fd=True, bitrate_switch=True, data=bytes(range(12))),
    ]
    with can.CanutilsLogWriter(path) as log:
        for message in sent:
            log.on_message_received(message)
    times, rows = read_candump(path)
    assert times.tolist() == [round((m.timestamp - 1.25) * 1e12) for m in sent]
    for row, message in zip(rows, sent, strict=True):
        frame = frame_of(row)
        assert frame.identifier == message.arbitration_id
        assert frame.data == bytes(message.data)
        assert frame.length == (
            0 if message.is_remote_frame else message.dlc
        )  # it writes no length
        assert frame.format.extended == message.is_extended_id
        assert (frame.format.fd, frame.format.brs) == (message.is_fd, message.bitrate_switch)
        assert frame.format.remote == message.is_remote_frame


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("hello", "line 2: found 'hello'"),
        ("(1.0) can0 12#", "line 2: found"),
        ("(1.0) can0 123#ABC", "line 2: found the data 'ABC'"),
        ("(1.0) can0 123##", "line 2: found the data '#'"),
        ("(1.0) can0 123##1A", "line 2: found the data '#1A'"),
        ("(1.0) can0 123#112233445566778899", "line 2: found the data"),
        ("(1.0) can0 123##0" + "00" * 65, "line 2: found the data"),
        ("(1.0) can0 123#R9", "line 2: found the data 'R9'"),
        ("(1.0) can0 900#", "line 2: found identifier 0x900, expected 11 bits"),
        ("(1.0) can0 F0000000#", ""),
        ("(5000000.0) can0 123#", r"4\.99\w*e\+06 s apart|5e\+06 s apart"),
        ("(1.0) can1 123#", r"the buses can0 \(line 1\), can1 \(line 2\)"),
    ],
)
def test_what_is_no_frame_is_refused_with_its_line(tmp_path: Path, line: str, says: str) -> None:
    text = f"(0.5) can0 001#\n{line}\n"
    if not says:
        assert len(read(tmp_path, text)) == 1  # an error frame
        return
    with pytest.raises(CosimError, match=says):
        read(tmp_path, text)


@pytest.mark.parametrize("content", [b"", b"\n\n", b"\xff\xfe", None])
def test_a_file_without_frames_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "bus.log"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CosimError, match=r"bus\.log: .*expected"):
        read_candump(path)


LINE = "(1.000000) can0 123##1112233445566778899AABBCC"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    at=st.integers(0, len(LINE) - 1),
    put=st.text(alphabet="0123456789ABCDEFR#._() \tg\u00e9", max_size=3),
    cut=st.integers(0, 3),
)
def test_any_damage_is_read_or_refused(tmp_path: Path, at: int, put: str, cut: int) -> None:
    text = LINE[:at] + put + LINE[at + cut :]
    try:
        read(tmp_path, text)
    except CosimError as error:
        assert "bus.log" in str(error)
