"""The messages of a DBC file as traffic: identifier, length, sender and period of each.

Only what traffic needs is read: ``BO_`` (messages), ``BA_DEF_DEF_`` and ``BA_`` of
``GenMsgCycleTime`` (ms), ``GenMsgStartDelayTime`` (ms), ``VFrameFormat`` and ``CANFD_BRS``. Signals
are not; the data of the frames is random.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.base.files import regular
from cosim.bus.frames import BusFrame
from cosim.bus.timing import FrameFormat, TimingError, padded
from cosim.bus.traffic import PeriodicSource, TrafficError

EXTENDED = 0x80000000
_MESSAGE = re.compile(r"^BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)\s+(\w+)", re.MULTILINE)
_VALUE = re.compile(r'^BA_\s+"(\w+)"\s+BO_\s+(\d+)\s+"?([^";]*)"?\s*;', re.MULTILINE)
_DEFAULT = re.compile(r'^BA_DEF_DEF_\s+"(\w+)"\s+"?([^";]*)"?\s*;', re.MULTILINE)
_CHOICES = re.compile(r'^BA_DEF_\s+BO_\s+"VFrameFormat"\s+ENUM\s+([^;]*);', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class TrafficMessage:
    """A message of a bus: its frame without data, its sender, and its period (ps)."""

    name: str
    identifier: int
    format: FrameFormat
    length: int
    sender: str
    period_ps: int
    offset_ps: int = 0


def read_messages(path: Path | str) -> tuple[TrafficMessage, ...]:
    """The messages of a DBC file that have a period, in its order.

    Raises TrafficError for a file that cannot be read, has no message with a period, or has one
    that CAN has not.
    """
    try:
        text = regular(Path(path)).read_text(encoding="cp1252")
    except OSError as error:
        why = "no such file" if isinstance(error, FileNotFoundError) else error.strerror or error
        raise TrafficError(f"{path}: {why}; expected a DBC file") from error
    except UnicodeDecodeError as error:
        raise TrafficError(f"{path}: {error}; expected a DBC file") from error
    defaults = dict(_DEFAULT.findall(text))
    choices = [c.strip().strip('"') for c in "".join(_CHOICES.findall(text)).split(",")]
    given: dict[int, dict[str, str]] = {}
    for key, number, value in _VALUE.findall(text):
        given.setdefault(int(number), {})[key] = value
    found = []
    for number, name, length, sender in _MESSAGE.findall(text):
        attributes = {**defaults, **given.get(int(number), {})}
        place = f"{path}: message {name}"
        period = _milliseconds(attributes, "GenMsgCycleTime", place)
        if period > 0:
            offset = _milliseconds(attributes, "GenMsgStartDelayTime", place)
            kind = _format(int(number), attributes, choices, int(length))
            found.append(
                _message(place, name, int(number), kind, int(length), sender, period, offset)
            )
    if not found:
        raise TrafficError(f"{path}: found no message with a GenMsgCycleTime, expected one or more")
    return tuple(found)


def _message(
    place: str, name: str, number: int, kind: FrameFormat, length: int, sender: str,
    period: int, offset: int,
) -> TrafficMessage:  # fmt: skip
    try:
        length = padded(length, kind.fd)
        frame = BusFrame(number & 0x1FFFFFFF, bytes(length), kind)
    except TimingError as error:
        raise TrafficError(f"{place}: {error}") from error
    return TrafficMessage(name, frame.identifier, kind, length, sender, period, offset)


def _milliseconds(attributes: Mapping[str, str], key: str, place: str) -> int:
    """An attribute in ms, as ps; 0 if it is not given."""
    text = attributes.get(key, "0") or "0"
    try:
        return round(float(text) * 1e9)
    except ValueError as error:
        raise TrafficError(f"{place}: found {key} {text!r}, expected a number of ms") from error


def _format(
    number: int, attributes: Mapping[str, str], choices: Sequence[str], length: int
) -> FrameFormat:
    said = attributes.get("VFrameFormat", "")
    if said.isdigit() and int(said) < len(choices):
        said = choices[int(said)]
    fd = "FD" in said or length > 8
    brs = fd and attributes.get("CANFD_BRS", "0") in ("1", "1.0")
    return FrameFormat(extended=bool(number & EXTENDED), fd=fd, brs=brs)


def senders(messages: Sequence[TrafficMessage]) -> tuple[str, ...]:
    """The nodes that send, each once, in the order of their first message."""
    return tuple(dict.fromkeys(message.sender for message in messages))


def dbc_sources(
    messages: Sequence[TrafficMessage],
    nodes: Mapping[str, int],
    jitter: float = 0.0,
    seed: int = 0,
) -> list[PeriodicSource]:
    """The messages whose sender is in `nodes` (name to number), as sources with random data.

    `jitter`: maximum lateness of a request, as a fraction of its period.
    """
    return [
        PeriodicSource(
            nodes[m.sender],
            BusFrame(m.identifier, bytes(m.length), m.format),
            m.period_ps,
            offset_ps=m.offset_ps,
            jitter_ps=round(jitter * m.period_ps),
            seed=seed + i,
            random_data=True,
        )
        for i, m in enumerate(messages)
        if m.sender in nodes
    ]
