"""Delays that were measured or come from a simulated CAN bus, and the files of measured ones.

A trace gives the `delay` (s) of a packet sent at `t_send` (s). CSV: one header line names these
columns (others are ignored), and lines that start with ``#`` are comments. Parquet: two columns of
these names. An empty, NaN or infinite delay is a lost packet.
:class:`BusDelays` has those of the frames of one link (:mod:`cosim.bus.simulation`).

Source: own construction.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import write_file
from cosim.links.laws import Delays, FloatArray
from cosim.record.groups import numpy

if TYPE_CHECKING:
    from numpy.random import Generator


COLUMNS = ("t_send", "delay")


@dataclass(frozen=True, slots=True, eq=False)
class DelayTrace:
    """Measured delays: row i was sent at t_send[i] and arrived delay[i] later.

    `t_send` (n,), s, increasing, counted from its first row; `delay` (n,), s, not finite for a lost
    packet. ``lookup = "time"``: a sample sent at t has the delay of the last row with t_send <= t
    (+ 1 ns for rounding); the trace lasts until one (last) interval after its last row. ``lookup =
    "index"``: sample k has the delay of row k. After its end a trace starts again (`repeat`) or
    there are no more delays. `file`: its name in messages.
    """

    t_send: FloatArray
    delay: FloatArray
    lookup: str = "time"
    repeat: bool = False
    file: str = "trace"

    def __post_init__(self) -> None:
        """Take private copies; refuse what is no trace. Raises ScenarioError with the row."""
        for name in ("t_send", "delay"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.lookup not in ("time", "index"):
            raise ScenarioError(f"lookup = {self.lookup!r}; expected 'time' or 'index'", self.file)
        problem = _problem(self.t_send, self.delay)
        if problem is not None:
            raise ScenarioError(f"row {problem[0]}: {problem[1]}", self.file)
        if self.lookup == "time" and self.t_send.size < 2:
            raise ScenarioError("one row has no interval; expected at least two", self.file)

    @property
    def minimum(self) -> float:
        """Shortest delay in the trace, s."""
        return float(np.min(self.delay[np.isfinite(self.delay)]))

    @property
    def maximum(self) -> float:
        """Longest delay of a packet that arrived, s."""
        return float(np.max(self.delay[np.isfinite(self.delay)]))

    @property
    def mean(self) -> float:
        """The mean delay of packets that arrived, weighted by the duration of each, s."""
        arrives = np.isfinite(self.delay)
        if self.lookup == "index":
            return float(np.mean(self.delay[arrives]))
        lasts = np.diff(self.t_send, append=self.t_send[0] + self.duration)  # (n,), s
        return float(np.average(self.delay[arrives], weights=lasts[arrives]))

    @property
    def loses_packets(self) -> bool:
        """True if a packet of the trace was lost."""
        return not bool(np.isfinite(self.delay).all())

    @property
    def duration(self) -> float:
        """The time from the first row to one (last) interval after the last, s."""
        return float(2 * self.t_send[-1] - self.t_send[-2] - self.t_send[0])

    def limit(self, period: Fraction) -> int | None:
        """Samples until the end of the trace; None if it starts again."""
        if self.repeat:
            return None
        if self.lookup == "index":
            return int(self.delay.size)
        return int(np.ceil((self.duration - 1e-9) / float(period)))

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The rows in order; nothing is drawn."""
        return _Looked(self, period)

    def facts(self) -> dict[str, Any]:
        """Name, file, look-up and a digest of the content."""
        digest = sha256(self.t_send.astype("<f8").tobytes() + self.delay.astype("<f8").tobytes())
        return {
            "law": "trace",
            "file": self.file,
            "lookup": self.lookup,
            "repeat": self.repeat,
            "sha256": digest.hexdigest(),
        }


class _Looked:
    def __init__(self, trace: DelayTrace, period: Fraction) -> None:
        self._trace, self._period, self._limit = trace, float(period), trace.limit(period)
        self._t = trace.t_send - trace.t_send[0]  # (n,), s
        self._sample = 0

    def take(self, n: int) -> FloatArray:
        k = np.arange(self._sample, self._sample + n, dtype=np.int64)
        self._sample += n
        if self._limit is not None and self._sample > self._limit:
            raise RunError(f"{self._trace.file}: the trace ends after {self._limit} samples")
        if self._trace.lookup == "index":
            return self._trace.delay[k % self._trace.delay.size]
        t = k * self._period + 1e-9
        if self._trace.repeat:
            t = np.mod(t, self._trace.duration)
        return self._trace.delay[np.searchsorted(self._t, t, side="right") - 1]


def read_trace(path: str | Path, *, lookup: str = "time", repeat: bool = False) -> DelayTrace:
    """The trace in a file (``.parquet``, otherwise CSV).

    Raises ScenarioError with the file and the line (CSV) or row (Parquet) that cannot be.
    """
    path = Path(path)
    if not path.is_file():
        raise ScenarioError("no such file; expected a trace with columns t_send, delay", str(path))
    if path.suffix == ".parquet":
        t_send, delay = _parquet(path)
        places: list[int] | range = range(t_send.size)
        word = "row "
    else:
        t_send, delay, places = _csv(path)
        word = ""
    problem = _problem(t_send, delay)
    if problem is not None:
        row, sentence = problem
        raise ScenarioError(sentence, f"{path}:{word}{places[row]}" if places else str(path))
    return DelayTrace(t_send, delay, lookup, repeat, str(path))


def write_trace(path: Path, sent: FloatArray, delay: FloatArray) -> None:
    """Write a trace as CSV: `sent` and `delay` (n,), s; NaN: lost. The least delay is 1 us.

    Measured delays of one direction may be negative by the uncertainty of the clocks.
    """
    lines = [",".join(COLUMNS)]
    lines += [
        f"{t:.9f},{'' if np.isnan(d) else f'{max(d, 1e-6):.9f}'}"
        for t, d in zip(sent, delay, strict=True)
    ]
    write_file(path, "\n".join(lines) + "\n")


def _csv(path: Path) -> tuple[FloatArray, FloatArray, list[int]]:
    """t_send (n,), delay (n,) and the line of each row."""
    t_send: list[float] = []
    delay: list[float] = []
    lines: list[int] = []
    with path.open(newline="", encoding="utf-8-sig") as stream:
        rows = _rows(stream, path)
        line, header = next(rows, (1, []))
        columns = [_column(header, name, f"{path}:{line}") for name in COLUMNS]
        for line, row in rows:
            if len(row) <= max(columns):
                raise ScenarioError(
                    f"{len(row)} values; expected {len(header)} as in the header", f"{path}:{line}"
                )
            t, d = (row[column].strip() for column in columns)
            t_send.append(_number(t, "t_send", f"{path}:{line}"))
            delay.append(_number(d, "delay", f"{path}:{line}") if d else np.nan)
            lines.append(line)
    return np.array(t_send), np.array(delay), lines


def _rows(stream: Iterator[str], path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every line that is neither empty nor a comment."""
    reader = csv.reader(stream)
    try:
        for row in reader:
            if row and not row[0].lstrip().startswith("#"):
                yield reader.line_num, row
    except (UnicodeDecodeError, csv.Error) as error:
        place = f"{path}:{reader.line_num + 1}"
        raise ScenarioError(f"this is not UTF-8 text ({error})", place) from None


def _column(header: list[str], name: str, place: str) -> int:
    names = [cell.strip() for cell in header]
    if name not in names:
        raise ScenarioError(f"columns {', '.join(names) or 'none'}; expected {name!r}", place)
    return names.index(name)


def _number(text: str, name: str, place: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ScenarioError(f"{name} = {text!r} is not a number (s)", place) from None


def _parquet(path: Path) -> tuple[FloatArray, FloatArray]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        names = pq.read_schema(path).names
        for name in COLUMNS:
            _column(names, name, str(path))
        table = pq.read_table(path, columns=list(COLUMNS))
        t_send, delay = (numpy(table.column(name), np.float64) for name in COLUMNS)
    except (pa.ArrowException, OSError) as error:
        raise ScenarioError(f"this cannot be read as a trace ({error})", str(path)) from None
    return t_send, delay


def _problem(t_send: FloatArray, delay: FloatArray) -> tuple[int, str] | None:
    """The first thing that makes (t_send, delay) no trace: its row (from 0) and a sentence."""
    if t_send.ndim != 1 or t_send.shape != delay.shape or not t_send.size:
        return 0, f"t_send {t_send.shape} and delay {delay.shape}; expected two columns, not empty"
    broken = ~np.isfinite(t_send)
    broken[1:] |= ~(t_send[1:] > t_send[:-1])
    negative = delay < 0
    if broken.any() or negative.any():
        row = int(np.argmax(broken | negative))
        if broken[row]:
            before = f" after {t_send[row - 1]:g} s" if row else ""
            return row, f"t_send = {t_send[row]:g} s{before}; expected increasing times"
        return row, f"delay = {delay[row]:g} s; expected 0 or more, or empty for a lost packet"
    if not np.isfinite(delay).any():
        return int(delay.size) - 1, "every packet is lost; expected one that arrives"
    return None


@dataclass(frozen=True, slots=True, eq=False)
class BusDelays:
    """Sample k arrived delay[k] after it was sent; `delay` (n,), s, infinite where it was lost.

    `known`: what is written down with the run (bus, identifier, response times). Raises
    ScenarioError if no sample arrives.
    """

    delay: FloatArray
    known: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a frame that no link receives. Raises ScenarioError."""
        if not np.isfinite(self.delay).any():
            raise ScenarioError(
                f"bus {self.known.get('bus')}: found no frame {self.known.get('identifier')} that"
                " arrives, expected at least one; look at load, errors and queues of this bus"
            )

    @property
    def minimum(self) -> float:
        """Shortest delay, s."""
        return float(self.delay[np.isfinite(self.delay)].min())

    @property
    def maximum(self) -> float:
        """Longest delay of a sample that arrived, s."""
        return float(self.delay[np.isfinite(self.delay)].max())

    @property
    def mean(self) -> float:
        """The mean delay of the samples that arrived, s."""
        return float(self.delay[np.isfinite(self.delay)].mean())

    @property
    def loses_packets(self) -> bool:
        """True if a sample did not arrive."""
        return not bool(np.isfinite(self.delay).all())

    def limit(self, period: Fraction) -> int | None:
        """The number of samples that the bus was simulated for."""
        return int(self.delay.size)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays in order; nothing is drawn.

        A test of `cosim analyze` that lasts longer than the run repeats them from the start.
        """
        rows = np.arange(self.delay.size, dtype=np.float64)
        return _Looked(DelayTrace(rows, self.delay, lookup="index", repeat=True), period)

    def facts(self) -> dict[str, Any]:
        """Facts about the bus and the frame, and a digest of the delays."""
        digest = sha256(self.delay.astype("<f8").tobytes())
        return {"law": "bus", **self.known, "sha256": digest.hexdigest()}
