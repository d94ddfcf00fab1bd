"""Periodic traffic that is only listened to: period, jitter, losses, and age from its stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np

from bridge.ping.clocks import Floats
from bridge.ping.exchanges import NONE
from bridge.ping.figures import WayFigures, way_figures
from bridge.ping.ros import attachment, header_stamp

#: Most samples of a stream that are kept (the last ones), and most streams.
KEPT, STREAMS = 50_000, 64
#: A gap longer than this many median periods counts as lost samples.
GAP = 1.5
#: An age beyond this is not that of a clock of the same date, s.
FOREIGN = 86_400.0


class StreamSample(NamedTuple):
    """A sample that was heard at `t_ns` (monotonic) and `date_ns`, with what it says of itself.

    `sequence`: its number, NONE without one; `published_ns`, `stamp_ns`: dates of its publishing
    and of its content, NONE: not said.
    """

    t_ns: int
    date_ns: int
    sequence: int = NONE
    published_ns: int = NONE
    stamp_ns: int = NONE


def zenoh_sample(
    key: str,
    payload: bytes,
    attached: bytes | None,
    stamped_ns: int | None,
    t_ns: int,
    date_ns: int,
) -> StreamSample:
    """The content of a Zenoh sample: by rmw_zenoh, else by the time stamp of Zenoh (`stamped_ns`).

    Times in ns; `t_ns` monotonic, the others since 1970.
    """
    ros = None if attached is None else attachment(attached)
    content = header_stamp(key, payload)
    stamp = NONE if content is None else content
    if ros is not None:
        return StreamSample(t_ns, date_ns, ros.sequence, ros.published_ns, stamp)
    published = NONE if stamped_ns is None else stamped_ns
    return StreamSample(t_ns, date_ns, NONE, published, stamp)


@dataclass(frozen=True, slots=True)
class StreamFigures:
    """A stream: `period`: figures of the times between samples, s; `lost`: samples, `numbered`: by
    their numbers (else by gaps); `repeated`: numbers that came again or late.

    `ages`: figures of ages by name, s; `remarks`: what the stamps say otherwise.
    """

    n: int
    period: WayFigures
    lost: int
    numbered: bool
    repeated: int
    ages: Mapping[str, WayFigures] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def share_lost(self) -> float:
        """Part of the samples that did not arrive."""
        return self.lost / (self.lost + self.n)


@final
class HeardStreams:
    """Streams heard, by key or identifier, in bounded memory. `ignored`: further streams."""

    def __init__(self) -> None:
        self._rows: dict[str, np.ndarray[Any, np.dtype[np.int64]]] = {}
        self.counts: dict[str, int] = {}
        self.ignored = 0

    def add(self, name: str, sample: StreamSample) -> None:
        """A sample of a stream."""
        if name not in self._rows:
            if len(self._rows) == STREAMS:
                self.ignored += 1
                return
            self._rows[name] = np.full((KEPT, 5), NONE, dtype=np.int64)
            self.counts[name] = 0
        self._rows[name][self.counts[name] % KEPT] = sample
        self.counts[name] += 1

    def figures(self) -> dict[str, StreamFigures]:
        """Figures of every stream of at least three samples."""
        found = {}
        for name, n in self.counts.items():
            rows = self._rows[name][:n] if n <= KEPT else np.roll(self._rows[name], -n, axis=0)
            if n >= 3:
                found[name] = stream_figures(rows)
        return found


def stream_figures(rows: np.ndarray[Any, np.dtype[np.int64]]) -> StreamFigures:
    """Figures of samples (n, 5): the fields of :class:`StreamSample`, ns, n >= 3."""
    period: Floats = np.diff(rows[:, 0]) * 1e-9
    numbers = rows[:, 2][rows[:, 2] != NONE]
    repeated = 0
    if numbers.size == rows.shape[0]:
        steps = np.diff(numbers)
        repeated = int(np.sum(steps <= 0))
        lost = int(np.max(numbers) - np.min(numbers) + 1 - np.unique(numbers).size)
    else:
        median = float(np.median(period))
        gaps = period[period > GAP * median]
        lost = int(np.sum(np.rint(gaps / median) - 1)) if median > 0 else 0
    ages, remarks = _ages(rows)
    return StreamFigures(
        rows.shape[0], way_figures(period), lost, numbers.size == rows.shape[0], repeated,
        ages, tuple(remarks),
    )  # fmt: skip


def _ages(rows: np.ndarray[Any, np.dtype[np.int64]]) -> tuple[dict[str, WayFigures], list[str]]:
    found: dict[str, WayFigures] = {}
    remarks: list[str] = []
    for name, column in (("since publishing", 3), ("of the content", 4)):
        known = rows[:, column] != NONE
        if not known.any():
            continue
        stamps = rows[known, column]
        if not stamps.any():
            remarks.append(f"age {name}: the publisher does not fill the stamp")
            continue
        age: Floats = (rows[known, 1] - stamps) * 1e-9
        if abs(float(np.median(age))) > FOREIGN:
            remarks.append(f"age {name}: the stamps are of another clock, simulated time perhaps")
            continue
        found[name] = way_figures(age)
        if age.min() < 0:
            remarks.append(f"age {name}: below 0, so the clocks of the hosts differ")
    return found, remarks


def stream_lines(name: str, f: StreamFigures) -> list[str]:
    """A stream in words."""
    p50, p95, p99, p999 = (1e3 * q for q in f.period.quantiles)
    how = "by their numbers" if f.numbered else "by gaps"
    lines = [
        f"{name}: {f.n} samples, {1 / f.period.mean:.4g} a second",
        f"  period p50 {p50:.3f}  p95 {p95:.3f}  p99 {p99:.3f}  p99.9 {p999:.3f}  "
        f"max {1e3 * f.period.maximum:.3f} ms, standard deviation {1e3 * f.period.sd:.3f} ms",
        f"  lost {f.lost} ({f.share_lost:.3%}, {how})"
        + (f", {f.repeated} out of order" if f.repeated else ""),
    ]
    for what, age in f.ages.items():
        a50, _, a99, _ = (1e3 * q for q in age.quantiles)
        lines.append(
            f"  age {what}: min {1e3 * age.minimum:.3f}  p50 {a50:.3f}  p99 {a99:.3f}  "
            f"max {1e3 * age.maximum:.3f} ms, if the clocks of both hosts agree"
        )
    return [*lines, *(f"  {remark}" for remark in f.remarks)]


def stream_values(f: StreamFigures) -> dict[str, Any]:
    """A stream for JSON, SI."""
    return {
        "n": f.n, "rate": 1 / f.period.mean,
        "period": _plain(f.period), "lost": f.lost, "lost_by": "number" if f.numbered else "gap",
        "out_of_order": f.repeated, "ages": {k: _plain(a) for k, a in f.ages.items()},
        "remarks": list(f.remarks),
    }  # fmt: skip


def _plain(f: WayFigures) -> dict[str, float]:
    names = ("p50", "p95", "p99", "p99.9")
    found = dict(zip(names, f.quantiles, strict=True))
    return {"min": f.minimum, "mean": f.mean, "sd": f.sd, "max": f.maximum, **found}
