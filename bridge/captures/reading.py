"""The reader of a recording, by its suffix and its first bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.captures.samples import CollectedStreams, ReadingNotes, RecordedSample
from cosim.base.errors import ScenarioError
from cosim.base.files import regular
from cosim.base.names import unknown

if TYPE_CHECKING:
    from bridge.captures.samples import StreamRows

Reader = Callable[[Path, ReadingNotes], Iterator[RecordedSample]]

_CAN = (".log", ".asc", ".blf", ".mf4", ".candump")
_PACKETS = (".pcap", ".pcapng", ".cap")
_BAGS = (".db3", ".bag")
_TEXT = (".csv", ".tsv", ".txt")
#: First bytes of files whose suffix says nothing, in hexadecimal digits.
_MAGIC = {
    "894d4341": ".mcap", "d4c3b2a1": ".pcap", "4d3cb2a1": ".pcap", "a1b2c3d4": ".pcap",
    "a1b23c4d": ".pcap", "0a0d0d0a": ".pcap", "53514c69": ".db3", "23524f53": ".bag",
    "4c4f4747": ".blf",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReadRecording:
    """A recording that was read: the `path` in words, its `kind`, its streams, what was left out.

    `kind`: can, packets, bag or csv.
    """

    name: str
    kind: str
    streams: CollectedStreams
    notes: ReadingNotes = field(default_factory=ReadingNotes)

    def rows(self, stream: str) -> StreamRows:
        """The samples of a stream. Raises ScenarioError if there is none of this name."""
        if stream not in self.streams.names:
            raise ScenarioError(unknown(stream, list(self.streams.found), "stream"), self.name)
        return self.streams.rows(stream)


def read_recording(
    text: str, wanted: Sequence[str] = (), columns: Sequence[str] = (), marks: bool = True
) -> ReadRecording:
    """Read ``FILE`` or ``FILE@CHANNEL``; keep the streams in `wanted`, or all.

    `marks`: packets are told apart by marks of their headers, too.

    Raises ScenarioError for what cannot be read, or has no samples; LogError for logs of CAN.
    """
    path, channel = _place(text)
    try:
        kind, reader = _reader(path, columns, marks)
        notes = ReadingNotes()
        samples = reader(path, notes)
        if channel:
            samples = (s for s in samples if s.stream.startswith(f"{channel} "))
        streams = CollectedStreams(samples, wanted)
    except OSError as error:
        raise ScenarioError(f"it cannot be read ({error.strerror or error})", str(path)) from None
    if not streams.found:
        said = "; ".join(notes.said())
        raise ScenarioError(
            f"no samples{f' of channel {channel}' if channel else ''}"
            f"{f' ({said})' if said else ''}; expected at least one stream",
            str(path),
        )
    for name in wanted:
        if name not in streams.found:
            raise ScenarioError(unknown(name, list(streams.found), "stream"), str(path))
    return ReadRecording(text, kind, streams, notes)


def _place(text: str) -> tuple[Path, str]:
    path = Path(text)
    if path.exists():
        return path, ""
    name, at, channel = text.rpartition("@")
    if at and Path(name).exists():
        return Path(name), channel
    raise ScenarioError(
        "no such file; expected a recording: .mcap, a bag of ROS, .pcap, .pcapng, candump text "
        "(.log), .asc, .blf or .csv",
        text,
    )


def _reader(path: Path, columns: Sequence[str], marks: bool) -> tuple[str, Reader]:
    """The kind of a recording, and its reader."""
    from bridge.captures.columns import csv_samples
    from bridge.captures.packets import packet_samples
    from bridge.captures.ros_bags import bag_samples, mcap_samples

    if path.is_dir():
        return "bag", bag_samples
    with regular(path).open("rb") as file:
        suffix = _MAGIC.get(file.read(4).hex(), path.suffix.lower())
    if suffix == ".mcap":
        return "bag", mcap_samples
    if suffix in _BAGS:
        return "bag", bag_samples
    if suffix in _PACKETS:
        return "packets", partial(packet_samples, marks=marks)
    if suffix in _CAN:
        return "can", _can_samples
    if suffix in _TEXT:
        return "csv", partial(csv_samples, columns=columns)
    raise ScenarioError(
        f"the suffix {path.suffix!r} is none of a recording; expected .mcap, a bag of ROS, .pcap, "
        ".pcapng, candump text (.log), .asc, .blf or .csv",
        str(path),
    )


def _can_samples(path: Path, notes: ReadingNotes) -> Iterator[RecordedSample]:
    """The frames of a log, ``CHANNEL IDENTIFIER`` each; error frames are left out."""
    from bridge.can.log import LogError, stream_log
    from bridge.native.frame import Flags
    from bridge.ping.exchanges import NONE

    count = 0
    try:
        for channel, frame in stream_log(path):
            count += 1
            if frame.flags & Flags.ERROR:
                notes.counts["error frames are left out"] += 1
                continue
            identifier = f"{frame.id:0{8 if frame.flags & Flags.EXTENDED else 3}X}"
            key = hash((identifier, bytes(frame.payload)))
            yield RecordedSample(f"{channel} {identifier}", frame.t_ns, NONE, NONE, NONE, key)
    except LogError as error:
        if not count:
            raise
        notes.lines.append(f"{error}: what follows these {count} frames is lost")
