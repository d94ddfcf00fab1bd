"""Logs of buses: journals of frames put together, written and read as others write and read them.

candump text (`.log`, can-utils) is written here; BLF, ASC and MF4 (with asammdf) by python-can.
Times inside are ns of the monotonic clock of the machine; `wall_ns` (CLOCK_REALTIME minus
CLOCK_MONOTONIC, ns) puts them on the wall in a file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from bridge.can.threaded import to_frame, to_message
from bridge.native.bus import FORMAT
from bridge.native.frame import Flags, Frame, frame_dtype
from cosim.base.errors import CosimError
from cosim.base.files import regular

ERROR_FLAG = 0x20000000
"""CAN_ERR_FLAG of linux/can.h, as candump text has it."""
_CANDUMP = re.compile(r"\((\d+)\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3,8})#(#?)(\S*)(?:\s+[RT])?\s*")
_OTHER = (".asc", ".blf", ".mf4")


class LogError(CosimError, ValueError):
    """A log cannot be read or written; the message names the place."""


@dataclass(frozen=True)
class FrameLog:
    """Frames of some buses. `rows`: (n,), fields of `frame_dtype()`; `bus` counts in `buses`."""

    rows: NDArray[np.void]
    buses: tuple[str, ...]

    def frames(self) -> Iterator[Frame]:
        """The frames one by one, in order, for a replay."""
        for row in self.rows:
            yield frame_of(row)


def frame_of(row: np.void) -> Frame:
    """A row of a log as a frame."""
    length = min(int(row["length"]), row["data"].size)
    data = row["data"][:length].tobytes()
    return Frame.of(int(row["id"]), data, int(row["flags"]), int(row["t_ns"]))


def merge_node_logs(parts: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Rows (n,) of one bus: the frames its nodes sent, and others' as the best listener heard them.

    Each of `parts` (k,) is the journal of one node.

    By time; each frame is there once, at its sender's time if that is one of the nodes. Frames
    with an identifier that a node sends, but of another format, are others'.
    """
    sent = [p[p["flags"] & Flags.SENT != 0] for p in parts]
    known = np.unique(np.concatenate([_kinds(p) for p in sent]))
    heard = [p[(p["flags"] & Flags.SENT == 0) & ~np.isin(_kinds(p), known)] for p in parts]
    rows = np.concatenate([*sent, max(heard, key=len)])
    return rows[np.argsort(rows["t_ns"], kind="stable")]


def _kinds(rows: NDArray[np.void]) -> NDArray[np.uint64]:
    """Identifier and format of each row in one number, (rows,)."""
    return rows["id"].astype(np.uint64) << np.uint64(8) | rows["flags"] & np.uint8(FORMAT)


def write_log(log: FrameLog, path: Path | str, wall_ns: int = 0) -> None:
    """Write candump text (`.log`), `.blf`, `.asc` or `.mf4`, by the suffix.

    Raises LogError for another suffix, and for .mf4 without asammdf.
    """
    path = Path(path)
    if path.suffix == ".log":
        path.write_text("".join(f"{line}\n" for line in candump_lines(log, wall_ns)))
    elif path.suffix in _OTHER:
        _write_other(log, path, wall_ns)
    else:
        raise LogError(f"{path}: unknown log format; expected .log, {', '.join(_OTHER)}")


def candump_lines(log: FrameLog, wall_ns: int = 0) -> Iterator[str]:
    """``(sec.usec) vcan0 1A0#0102``, CAN FD ``1A0##10102``: what `candump -L` prints."""
    for frame, bus in zip(log.frames(), log.rows["bus"], strict=True):
        seconds, us = divmod((frame.t_ns + wall_ns) // 1000, 1_000_000)
        yield f"({seconds}.{us:06d}) {log.buses[bus]} {_candump(frame)}"


def _candump(frame: Frame) -> str:
    if frame.flags & Flags.ERROR:
        name = f"{frame.id | ERROR_FLAG:08X}"
    else:
        name = f"{frame.id:08X}" if frame.flags & Flags.EXTENDED else f"{frame.id:03X}"
    if frame.flags & Flags.REMOTE:
        return f"{name}#R{frame.length or ''}"
    data = frame.payload.hex().upper()
    if frame.flags & Flags.FD:
        bits = (1 if frame.flags & Flags.BRS else 0) | (2 if frame.flags & Flags.ESI else 0)
        return f"{name}##{bits}{data}"
    return f"{name}#{data}"


def _write_other(log: FrameLog, path: Path, wall_ns: int) -> None:
    """Channels are numbers there: that of the bus."""
    try:
        with can.Logger(path) as writer:
            for frame, bus in zip(log.frames(), log.rows["bus"], strict=True):
                writer(to_message(frame, (frame.t_ns + wall_ns) / 1e9, int(bus)))
    except (NotImplementedError, ImportError) as error:
        raise LogError(f"{path}: {error}; pip install 'cosim-bridge[mf4]'") from error


def read_log(path: Path | str, wall_ns: int = 0) -> FrameLog:
    """A log in one of the formats of `write_log`; times minus `wall_ns`.

    Raises LogError for what is none (file and line).
    """
    path = Path(path)
    names: dict[str, int] = {}
    frames: list[Frame] = []
    for channel, frame in stream_log(path):
        frame.t_ns -= wall_ns
        frame.bus = names.setdefault(channel, len(names))
        frames.append(frame)
    return FrameLog(rows_of(frames), tuple(names))


def stream_log(path: Path) -> Iterator[tuple[str, Frame]]:
    """The frames of a log one by one with their channels, as :func:`read_log` without its memory.

    Raises LogError for what is none (file and line).
    """
    if path.suffix in _OTHER:
        yield from _stream_other(path)
        return
    try:
        with regular(path).open(encoding="utf-8") as lines:
            for number, line in enumerate(lines, 1):
                if line.strip():
                    yield _candump_frame(line.rstrip("\n"), f"{path}:{number}")
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: {error}; expected candump text") from error


def _candump_frame(line: str, place: str) -> tuple[str, Frame]:
    found = _CANDUMP.fullmatch(line)
    if not found:
        raise LogError(f"{place}: {line!r}; expected (seconds) bus id#data")
    try:
        return found[3], _parsed(found)
    except ValueError as error:
        raise LogError(f"{place}: {line!r}: {error}") from error


def _parsed(found: re.Match[str]) -> Frame:
    t_ns = int(found[1]) * 10**9 + int(found[2].ljust(9, "0"))
    name, text = found[4], found[6]
    flags = Flags.EXTENDED if len(name) > 3 else Flags(0)
    identifier = int(name, 16)
    if len(name) == 8 and identifier & ERROR_FLAG:
        flags, identifier = Flags.ERROR, identifier & ~ERROR_FLAG
    if found[5]:
        bits = int(text[:1], 16)
        flags |= Flags.FD | (Flags.BRS if bits & 1 else 0) | (Flags.ESI if bits & 2 else 0)
        text = text[1:]
    elif text[:1] in ("R", "r"):
        frame = Frame.of(identifier, b"", flags | Flags.REMOTE, t_ns)
        frame.length = int(text[1:] or "0", 16)
        return frame
    data = bytes.fromhex(text.replace(".", ""))
    if len(data) > (64 if found[5] else 8):
        raise ValueError(f"{len(data)} bytes")
    return Frame.of(identifier, data, flags, t_ns)


def _stream_other(path: Path) -> Iterator[tuple[str, Frame]]:
    try:
        with can.LogReader(path) as reader:
            for message in reader:
                frame = to_frame(message, round(message.timestamp * 1e9))
                frame.flags |= 0 if message.is_rx else Flags.SENT
                yield _channel(message), frame
    except (NotImplementedError, ImportError) as error:
        raise LogError(f"{path}: {error}; pip install 'cosim-bridge[mf4]'") from error
    except Exception as error:  # of python-can's readers, which let through what they meet
        text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise LogError(f"{path}: {text}; expected a {path.suffix} log") from error


def _channel(message: can.Message) -> str:
    channel: Any = message.channel
    return channel if isinstance(channel, str) else f"can{channel or 0}"


def rows_of(frames: Iterable[Frame]) -> NDArray[np.void]:
    """Frames as rows of a log, (n,), numbered in this order; data beyond 64 bytes is cut off."""
    whole = b"".join(bytes(frame) for frame in frames)
    rows = _truncate_data(np.frombuffer(whole, frame_dtype(232), len(whole) // 256))
    rows["sequence"] = np.arange(len(rows))
    return rows


def _truncate_data(rows: NDArray[np.void]) -> NDArray[np.void]:
    """A copy with 64 bytes of data a row, whatever the journal had."""
    result = np.zeros(len(rows), frame_dtype())
    for name in ("t_ns", "id", "flags", "bus", "length", "sequence"):
        result[name] = rows[name]
    width = min(rows["data"].shape[1], 64)
    result["data"][:, :width] = rows["data"][:, :width]
    return result
