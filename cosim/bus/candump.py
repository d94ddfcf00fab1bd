"""Logs of ``candump -l``: a line for each frame, ``(1.000000) can0 123#11223344``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.files import regular
from cosim.bus.frames import FRAME, BusFrame
from cosim.bus.timing import FrameFormat, TimingError
from cosim.bus.traffic import LONGEST_PS, TrafficError

_LINE = re.compile(
    r"\((?P<s>\d{1,12})\.(?P<part>\d{1,9})\)\s+(?P<bus>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?P<rest>\S*)(\s+[RT])?\s*"
)
_CLASSIC = re.compile(r"(?:[0-9A-Fa-f]{2}\.?){0,8}(?:_[9A-Fa-f])?")
_REMOTE = re.compile(r"R([0-8]?)(?:_[9A-Fa-f])?")
_FLEXIBLE = re.compile(r"#([0-9A-Fa-f])((?:[0-9A-Fa-f]{2}\.?){0,64})")
#: The flag of an error frame in an identifier, as in ``linux/can.h``.
_ERROR = 0x20000000


def read_candump(path: Path | str) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """The data and remote frames of a log in the order of their times, without error frames.

    Returns the times after the first frame in ps (n,) and the frames (n,), rows of ``FRAME``; the
    times of ``candump -l`` count from 1970 and have too many ps for an integer of 64 bits. Raises
    TrafficError for a file that cannot be read, has no frame, frames of several buses, more than
    50 days, or an invalid line.
    """
    try:
        lines = regular(Path(path)).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TrafficError(f"{path}: {error}; expected a log of candump -l") from error
    times, rows, buses = [], [], dict[str, int]()
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        place = f"{path}, line {number}"
        match = _LINE.fullmatch(line.strip())
        if match is None:
            raise TrafficError(f"{place}: found {line[:80]!r}, expected (TIME) BUS IDENTIFIER#DATA")
        if len(match["id"]) == 8 and int(match["id"], 16) & _ERROR:
            continue
        buses.setdefault(match["bus"], number)
        times.append(int(match["s"]) * 10**12 + int(match["part"].ljust(12, "0")))
        rows.append(_frame(match["id"], match["rest"], place).row())
    if not rows:
        raise TrafficError(f"{path}: found no frames, expected one or more")
    if len(buses) > 1:
        found = ", ".join(f"{name} (line {number})" for name, number in buses.items())
        raise TrafficError(f"{path}: found frames of the buses {found}; expected those of one bus")
    first, last = min(times), max(times)
    if last - first > LONGEST_PS:
        raise TrafficError(
            f"{path}: found frames that are {(last - first) / 1e12:.6g} s apart, expected at most"
            f" {LONGEST_PS / 1e12:.6g} s (50 days)"
        )
    at = np.array([t - first for t in times], np.int64)
    order = np.argsort(at, kind="stable")
    return at[order], np.array(rows, FRAME)[order]


def candump_lines(frames: Iterable[tuple[int, BusFrame]], bus: str, digits: int = 6) -> str:
    """Frames, each with its time in ps, as ``candump -l`` writes them (nine digits: ``-N``)."""
    return "".join(
        f"({at // 10**12}.{at % 10**12 // 10 ** (12 - digits):0{digits}}) {bus} {_text(frame)}\n"
        for at, frame in frames
    )


def _text(frame: BusFrame) -> str:
    kind, data = frame.format, frame.data.hex().upper()
    identifier = f"{frame.identifier:08X}" if kind.extended else f"{frame.identifier:03X}"
    if kind.fd:
        return f"{identifier}##{kind.brs | kind.esi << 1:X}{data}"
    return f"{identifier}#R{frame.length or ''}" if kind.remote else f"{identifier}#{data}"


def _frame(identifier: str, text: str, place: str) -> BusFrame:
    """The frame of the text behind the first #. Raises TrafficError."""
    number, extended = int(identifier, 16), len(identifier) == 8
    try:
        if fd := _FLEXIBLE.fullmatch(text):
            flags = int(fd[1], 16)
            kind = FrameFormat(extended=extended, fd=True, brs=bool(flags & 1), esi=bool(flags & 2))
            data = bytes.fromhex(fd[2].replace(".", ""))
            return BusFrame(number, data, kind)
        if remote := _REMOTE.fullmatch(text):
            kind = FrameFormat(extended=extended, remote=True)
            return BusFrame(number, b"", kind, int(remote[1] or "0"))
        if _CLASSIC.fullmatch(text):
            data = bytes.fromhex(text.partition("_")[0].replace(".", ""))
            return BusFrame(number, data, FrameFormat(extended=extended))
    except TimingError as error:
        raise TrafficError(f"{place}: {error}") from error
    raise TrafficError(
        f"{place}: found the data {text[:80]!r}; expected up to 8 bytes as hexadecimal digits, R "
        "with a length, or for CAN FD # with a digit of flags and up to 64 bytes"
    )
