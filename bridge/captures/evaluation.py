"""The way from recordings to links: a stream with two stamps, or a stream at its two ends."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bridge.captures.judged import ClockKnowledge, judge
from bridge.captures.matching import MatchedWay, matched, shared
from bridge.captures.mixed import one_clock
from bridge.captures.reading import ReadRecording, read_recording
from bridge.captures.report import CaptureResult, RecordedLink
from bridge.captures.samples import StreamRows
from bridge.captures.ways import RecordedWay, one_way, periodic_way
from bridge.ping.as_link import fitted
from bridge.ping.exchanges import NONE, Integers
from bridge.ping.figures import autocorrelation
from cosim.base.errors import ScenarioError
from cosim.links.traces import write_trace


@dataclass(frozen=True, slots=True)
class CaptureChoice:
    """The choice of what is evaluated: `topic` of the way there and `back` of the way back, empty:
    found; `stamp` header, publish or auto; `period_ns` of a sender without stamps, 0: unknown.
    """

    topic: str = ""
    back: str = ""
    stamp: str = "auto"
    period_ns: int = 0
    known: ClockKnowledge = field(default_factory=ClockKnowledge)


class UsedStamps(NamedTuple):
    """Stamps of sending (n,), ns, NONE: not said; in words; `header`: of the content."""

    ns: Integers
    said: str


def sending_stamps(rows: StreamRows, kind: str, wanted: str = "auto") -> UsedStamps | None:
    """The stamps of sending that a stream has: of its header, or else of its publishing, where that
    is not the time of recording itself. None without any.
    """
    filled = (rows.stamp != NONE) & (rows.stamp != 0)
    if filled.any() and wanted != "publish":
        said = "the sender's stamp" if kind == "csv" else "header stamp"
        return UsedStamps(rows.stamp, f"{said} to time of {_recorded(kind)}")
    published = (rows.published != NONE) & (rows.published != 0)
    if published.any() and np.any(rows.published != rows.t) and wanted != "header":
        return UsedStamps(rows.published, f"time of publishing to time of {_recorded(kind)}")
    return None


def _recorded(kind: str) -> str:
    return "arrival" if kind == "csv" else "recording"


def usable_streams(recording: ReadRecording, wanted: str = "auto") -> list[str]:
    """The streams whose samples have two stamps."""
    streams = recording.streams
    return [
        name
        for name in streams.names
        if sending_stamps(streams.rows(name), recording.kind, wanted) is not None
    ]


def of_one_recording(recording: ReadRecording, choice: CaptureChoice, out: Path) -> CaptureResult:
    """The delays of the stream `choice.topic`; its table is written to `out`.

    Raises ScenarioError with the stream for what cannot be evaluated.
    """
    rows = recording.rows(choice.topic)
    place = f"{recording.name}, {choice.topic}"
    remarks = list(recording.notes.said())
    try:
        if choice.period_ns:
            way = periodic_way(rows, choice.period_ns)
            said = f"a grid of {choice.period_ns * 1e-6:.6g} ms to time of recording"
            known = ClockKnowledge("differ", choice.known.least, choice.known.most)
        else:
            stamps = sending_stamps(rows, recording.kind, choice.stamp)
            if stamps is None:
                raise ScenarioError(
                    "its samples have one stamp; expected a stamp of sending too, the recording of "
                    "the other end as a second file, or --period TIME of a regular sender"
                )
            said, known = stamps.said, choice.known
            arrived = np.flatnonzero((rows.t != NONE) & (stamps.ns != NONE) & (stamps.ns != 0))
            kept = np.ones(rows.t.size, dtype=bool)
            mixed = one_clock(rows.t[arrived], stamps.ns[arrived])
            kept[arrived[~mixed.kept]] = False
            remarks += mixed.remarks
            way = one_way(rows.where(kept), stamps.ns[kept])
        judged = judge([way], known)
    except ScenarioError as error:
        raise ScenarioError(str(error), place) from None
    remarks += way.remarks()
    link = _link(_name(choice.topic), way, judged.delays[0], _semantics(recording.kind, way), out)
    return CaptureResult(place, said, (link,), judged, [*remarks, *_full(recording)])


def read_ends(
    files: Sequence[str], columns: Sequence[str] = ()
) -> tuple[ReadRecording, ReadRecording]:
    """The recordings of two ends. Packets that have nothing in common with their marks are read
    again without. Raises ScenarioError for other than two files, and for what cannot be read.
    """
    if len(files) != 2:
        raise ScenarioError(
            f"found {len(files)} recordings; expected one, or one of each of two ends"
        )
    first, second = (read_recording(file, (), columns) for file in files)
    if first.kind == second.kind == "packets" and not _common(first, second):
        first, second = (read_recording(file, (), columns, marks=False) for file in files)
        if _common(first, second):
            first.notes.lines.append(
                "packets are matched by their payload alone: a relay or a VPN between both ends "
                "sends them anew"
            )
    return first, second


def _common(first: ReadRecording, second: ReadRecording) -> bool:
    here, there = (
        np.concatenate([one.rows(name).key for name in one.streams.names])
        for one in (first, second)
    )
    return bool(np.isin(here, there).any())


def of_two_recordings(
    first: ReadRecording, second: ReadRecording, choice: CaptureChoice, out: Path
) -> CaptureResult:
    """The delays between the two ends of a stream, the first of which sends, and of one that comes
    back, if there is one. Tables are written to `out`.

    Raises ScenarioError for streams that cannot be matched.
    """
    same_file = first.name.partition("@")[0] == second.name.partition("@")[0]
    topic = choice.topic or _commonest(first, second)
    partner = _partner(topic, first, second)
    there = _matched(first, topic, second, partner, same_file)
    found, names = [there], ["there"]
    back = choice.back or _reverse(topic, first, second)
    if back:
        returning = _matched(second, _partner(back, first, second), first, back, same_file)
        if not choice.back and _median(there.way) + _median(returning.way) < 0:
            # The first recording is of the end that receives the larger stream.
            there = _matched(second, partner, first, topic, same_file)
            returning = _matched(first, back, second, _partner(back, first, second), same_file)
            there, returning, topic, back = returning, there, back, topic
        found, names = [there, returning], ["there", "back"]
    known = choice.known
    if known.clocks == "auto" and (same_file or len(found) == 2):
        known = ClockKnowledge("same" if same_file else "differ", known.least, known.most)
    place = f"{first.name} to {second.name}, {topic}"
    ways = [m.way for m in found]
    try:
        judged = judge(ways, known)
    except ScenarioError as error:
        raise ScenarioError(str(error), place) from None
    links = tuple(
        _link(name, way, delay, _semantics(first.kind, way), out)
        for name, way, delay in zip(names, ways, judged.delays, strict=True)
    )
    remarks = [*first.notes.said(), *second.notes.said(), *_full(first), *_full(second)]
    for name, match in zip(names, found, strict=True):
        remarks += [f"{name}: {remark}" for remark in match.remarks()]
    said = "stamps of both ends" + (f", back by {back}" if back else "")
    return CaptureResult(place, said, links, judged, remarks)


def _full(recording: ReadRecording) -> list[str]:
    if not recording.streams.full:
        return []
    read = sum(recording.streams.found.values())
    return [
        f"{recording.name}: reading ended after {read} samples, and figures are of these; "
        "--topic STREAM keeps one stream only"
    ]


def _matched(
    sender: ReadRecording, sent: str, receiver: ReadRecording, received: str, same: bool
) -> MatchedWay:
    try:
        return matched(sender.rows(sent), receiver.rows(received), same)
    except ScenarioError as error:
        place = f"{sender.name}, {sent} and {receiver.name}, {received}"
        raise ScenarioError(str(error), place) from None


def _median(way: RecordedWay) -> float:
    sent, received = way.there
    return float(np.median(received - sent))


def _commonest(first: ReadRecording, second: ReadRecording) -> str:
    """The stream of `first` with the most contents that `second` has, too."""
    everything = np.concatenate([second.rows(name).key for name in second.streams.names])
    counts = {
        name: int(np.isin(np.unique(first.rows(name).key), everything).sum())
        for name in first.streams.names
    }
    best = max(counts, key=lambda name: counts[name])
    if not counts[best]:
        raise ScenarioError(
            f"none of the samples of {first.name} is in {second.name}; expected two recordings of "
            "the same traffic"
        )
    return best


def _partner(topic: str, first: ReadRecording, second: ReadRecording) -> str:
    """The stream of `second` that has the contents of `topic`: of the same name, or most of them.

    Raises ScenarioError.
    """
    rows = first.rows(topic)
    if topic in second.streams.names and shared(rows, second.rows(topic)):
        return topic
    counts = {name: shared(rows, second.rows(name)) for name in second.streams.names}
    best = max(counts, key=lambda name: counts[name])
    if not counts[best]:
        raise ScenarioError(
            f"none of the samples of {topic} in {first.name} is in {second.name}; expected two "
            "recordings of the same traffic"
        )
    return best


def _reverse(topic: str, first: ReadRecording, second: ReadRecording) -> str:
    """The flow of packets against that of `topic`, if both recordings have it; else empty."""
    found = re.fullmatch(r"(udp|tcp) (\S+) -> (\S+)", topic)
    if found is None:
        return ""
    name = f"{found[1]} {found[3]} -> {found[2]}"
    there = name in first.streams.names and name in second.streams.names
    enough = there and shared(first.rows(name), second.rows(name)) >= 3
    return name if enough else ""


def _name(stream: str) -> str:
    """A stream as the name of a file."""
    return re.sub(r"[^\w.-]+", "-", stream).strip("-.") or "link"


def _semantics(kind: str, way: RecordedWay) -> str:
    """The semantics of a receiver: frames of CAN by arrival, others by their stamps."""
    if kind == "can":
        return "last-arrival"
    return "newest-stamp"


def _link(
    name: str, way: RecordedWay, delay: np.ndarray, semantics: str, out: Path
) -> RecordedLink:
    out.mkdir(parents=True, exist_ok=True)
    file = out.resolve() / f"{name}.csv"
    write_trace(file, way.seconds, delay)
    law = fitted(delay, autocorrelation(delay[~np.isnan(delay)]), way.period)
    return RecordedLink(name, way, delay, law, semantics, str(file))


def summary_of_clocks(recording: ReadRecording, usable: Sequence[str]) -> list[str]:
    """The clocks of several streams, in lines, where they are not all of one."""
    groups: dict[str, list[str]] = {}
    for name in usable:
        rows = recording.rows(name)
        stamps = sending_stamps(rows, recording.kind)
        if stamps is None:
            continue
        good = (rows.t != NONE) & (stamps.ns != NONE) & (stamps.ns != 0)
        t, sent = rows.t[good], stamps.ns[good]
        if t.size < 3:
            continue
        groups.setdefault(_clock_of(t, sent), []).append(name)
    if len(groups) < 2:
        return []
    said = [f"{', '.join(names)}: {clock}" for clock, names in groups.items()]
    return [f"{len(groups)} clocks are mixed in this recording:", *(f"  {line}" for line in said)]


def _clock_of(t: Integers, sent: Integers) -> str:
    """The clock of stamps (n,), ns, in words."""
    age = t - sent
    if one_clock(t, sent).remarks:
        return "stamps of two clocks in one stream"
    if abs(int(np.median(age))) > 86_400 * 10**9:
        return "a clock more than a day apart, simulated time perhaps"
    try:
        way = RecordedWay(np.sort(sent), t[np.argsort(sent, kind="stable")])
        judged = judge([way], ClockKnowledge())
    except ScenarioError:
        return "a clock of another speed"
    if judged.clock is None:
        return "the clock of the recording, by their stamps"
    apart, drift = judged.offset[1], 1e6 * judged.clock.drift[1]
    return f"another host's clock ({apart:+.3g} s or less to the recording's, {drift:+.1f} ppm)"
