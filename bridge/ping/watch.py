"""A measurement of days in windows: a line and a record for each, and alarms; bounded memory.

The figures of a window are computed in another process, so that this does not make questions or
answers of the next one late.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

import numpy as np

from bridge.ping.exchanges import CAPACITY, NONE, Exchanges
from bridge.ping.figures import QUANTILES, evaluate, way_figures
from bridge.ping.measure import LINGER_NS
from bridge.ping.report import values
from cosim.base.clock import realtime_offset_ns
from cosim.base.errors import RunError, ScenarioError, UnitError
from cosim.base.processes import spawned
from cosim.base.units import quantity

#: What an alarm may compare, and its unit; delays are of the round trip.
QUANTITIES = {
    "p50": "s", "p95": "s", "p99": "s", "p99.9": "s", "max": "s", "mean": "s", "jitter": "s",
    "outage": "s", "lost": "%",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class PingAlarm:
    """An alarm: sounds in a window whose `quantity` is above `limit` (s; lost: a share)."""

    text: str
    quantity: str
    limit: float

    @staticmethod
    def parse(text: str) -> PingAlarm:
        """The alarm of a text like ``p99 > 20 ms``. Raises ScenarioError."""
        found = re.fullmatch(r"\s*([\w.]+)\s*>\s*([\d.eE+-]+)\s*([\w%]+)\s*", text)
        known = ", ".join(QUANTITIES)
        if found is None or found[1] not in QUANTITIES:
            raise ScenarioError(
                f"found {text!r}; expected QUANTITY > VALUE UNIT, such as 'p99 > 20 ms' or "
                f"'lost > 1 %', with one of {known}",
                "--alarm",
            )
        try:
            limit = _limit(found[2], found[3], QUANTITIES[found[1]])
        except (UnitError, ValueError) as error:
            raise ScenarioError(f"{text!r}: {error}", "--alarm") from None
        return PingAlarm(" ".join(text.split()), found[1], limit)


def _limit(value: str, unit: str, expected: str) -> float:
    if expected == "%":
        if unit != "%":
            raise UnitError(f"found the unit {unit!r}; expected %")
        return float(value) / 100
    return quantity(f"{value} {unit}", expected)


@dataclass(frozen=True, slots=True)
class PingWindow:
    """Questions from the date `start` (s since 1970) for `length` s. `numbers`: as alarms compare
    them, infinite where nothing was answered; `figures`: for JSON, None where nothing was.
    """

    start: float
    length: float
    sent: int
    numbers: dict[str, float]
    figures: dict[str, Any] | None

    @property
    def date(self) -> str:
        """The start in local time."""
        return _local(self.start)

    @property
    def text(self) -> str:
        """In a line."""
        n = self.numbers
        if self.figures is None:
            return f"{self.date}  {self.sent} questions, none answered"
        silent = f", silent for {n['outage']:.3g} s" if n["outage"] else ""
        p50, p99, most = (1e3 * n[k] for k in ("p50", "p99", "max"))
        return (
            f"{self.date}  {self.sent} questions, lost {n['lost']:.3%}, round trip p50 {p50:.3f}  "
            f"p99 {p99:.3f}  max {most:.3f} ms{silent}"
        )


def window_figures(record: Exchanges, start: float) -> PingWindow:
    """Figures of a part of a measurement whose first question was sent at the date `start`, s."""
    t1 = record.stamp("t1")
    length = (int(t1[-1] - t1[0]) + record.period_ns) * 1e-9
    if not record.received or np.all(record.stamp("t4") == NONE):
        numbers = {name: 1.0 if unit == "%" else inf for name, unit in QUANTITIES.items()}
        return PingWindow(start, length, record.sent, {**numbers, "outage": length}, None)
    found = evaluate(record)
    way = way_figures(found.rtt)
    names = [f"p{100 * q:g}" for q in QUANTILES]
    numbers = {
        **dict(zip(names, way.quantiles, strict=True)), "max": way.maximum, "mean": way.mean,
        "jitter": way.jitter, "lost": found.loss.share,
        "outage": found.loss.longest_outage,
    }  # fmt: skip
    return PingWindow(start, length, record.sent, numbers, values(found))


class PingWatch:
    """Cuts a running measurement into windows of `every` s; `say` gets a line for each and for
    alarms that begin and end. `file`: a line of JSON for each window is appended.

    `show` is called while it is measured, `finish` after it. `sounded`: alarms that ever began.
    Raises ScenarioError for windows that hold fewer than ten questions or too many.
    """

    def __init__(
        self, every: float, period_ns: int, alarms: Sequence[PingAlarm], file: TextIO,
        say: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._count = round(every * 1e9 / period_ns)
        if not 10 <= self._count <= CAPACITY // 2:
            raise ScenarioError(
                f"windows of {every:g} s have {self._count} questions; expected 10 to "
                f"{CAPACITY // 2}",
                "--watch",
            )
        self._alarms, self._file, self._say = alarms, file, say
        self._next = 0
        self._waiting: list[Future[PingWindow]] = []
        self._since: dict[str, float] = {}
        self.sounded: set[str] = set()
        self._pool = spawned(1)

    def __enter__(self) -> PingWatch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def show(self, record: Exchanges) -> None:
        """Begin with windows whose last answers have had their time, and tell finished ones."""
        late = max(LINGER_NS, 3 * record.last_rtt_ns) // record.period_ns + 1
        while record.sent >= self._next + self._count + late:
            self._begin(record, self._count)
        self._tell(wait=False)

    def finish(self, record: Exchanges) -> None:
        """The rest of the measurement, at least two questions, as a last window."""
        while record.sent >= self._next + self._count:
            self._begin(record, self._count)
        if record.sent - self._next >= 2:
            self._begin(record, record.sent - self._next)
        self._tell(wait=True)
        for text, since in self._since.items():
            self._say(f"alarm {text}: still sounding, since {_local(since)}")

    def _begin(self, record: Exchanges, count: int) -> None:
        part = record.between(self._next, self._next + count)
        start = (int(part.stamp("t1")[0]) + realtime_offset_ns()) * 1e-9
        self._waiting.append(self._pool.submit(window_figures, part, start))
        self._next += count

    def _tell(self, *, wait: bool) -> None:
        while self._waiting and (wait or self._waiting[0].done()):
            window = self._waiting.pop(0).result()
            self._say(window.text)
            self._judge(window)
            now = sorted(self._since)
            line = {
                "date": window.date, "length": window.length, "sent": window.sent,
                "alarms": now, "figures": window.figures,
            }  # fmt: skip
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def _judge(self, window: PingWindow) -> None:
        for alarm in self._alarms:
            value = window.numbers[alarm.quantity]
            if value > alarm.limit and alarm.text not in self._since:
                self._since[alarm.text] = window.start
                self.sounded.add(alarm.text)
                self._say(f"ALARM {alarm.text}: {_said(alarm, value)}")
            elif value <= alarm.limit and alarm.text in self._since:
                took = window.start - self._since.pop(alarm.text)
                self._say(f"alarm {alarm.text}: over after {took:.0f} s, {_said(alarm, value)}")


def append(path: Path) -> TextIO:
    """Open a file to append to, its folder made. Raises RunError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("a", encoding="utf-8")
    except OSError as error:
        raise RunError(f"{path}: cannot be written: {error}") from None


def _said(alarm: PingAlarm, value: float) -> str:
    if alarm.quantity == "lost":
        return f"{alarm.quantity} is {value:.3%}"
    if value == inf:
        return "nothing was answered"
    return f"{alarm.quantity} is {1e3 * value:.3f} ms"


def _local(date: float) -> str:
    return datetime.fromtimestamp(date).astimezone().isoformat(timespec="seconds")
