"""The result of a recording: as text, and as values for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any

import numpy as np

from bridge.captures.judged import JudgedWays
from bridge.captures.ways import RecordedWay
from bridge.ping.as_link import FittedLaw, link_toml, netem_line
from bridge.ping.clocks import DRIFT, Floats
from bridge.ping.figures import WayFigures, way_figures
from bridge.ping.losses import runs
from bridge.ping.report import COLUMNS, cells, way_values


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLink:
    """A direction of a recording as a link: its name, packets, delays (n,), s, and nearest law.

    `semantics`: how a receiver takes its samples; `file`: the table.
    """

    name: str
    way: RecordedWay
    delay: Floats
    law: FittedLaw
    semantics: str
    file: str

    def toml(self) -> str:
        """The keys of a link that repeats the table."""
        return link_toml(self.file, self.semantics)

    def netem(self) -> str:
        """The command of ``tc`` that comes closest."""
        line = netem_line(self.law, self.way.period)
        return f"tc qdisc add dev DEV root netem {line or '(none)'}"


@dataclass(frozen=True, slots=True, eq=False)
class CaptureResult:
    """The result: `what` was read (in words), its links, clocks, and `remarks` on what was
    left out. `stamps`: what the delays are between, in words.
    """

    what: str
    stamps: str
    links: tuple[RecordedLink, ...]
    judged: JudgedWays
    remarks: Sequence[str] = field(default_factory=list)


def capture_lines(result: CaptureResult) -> list[str]:
    """The result in lines, without the links."""
    lines = [f"{result.what}: {result.stamps}"]
    lines += [f"warning: {remark}" for remark in result.remarks]
    lines.append(" " * 12 + "".join(f"{h:>9}" for h in COLUMNS) + "   (ms)")
    for link, f in zip(result.links, _figures(result), strict=True):
        lines.append(f"{link.name:<12}" + "".join(f"{1e3 * x:9.3f}" for x in cells(f)))
    lines += [_count_line(link) for link in result.links]
    return [*lines, *_clock_lines(result.judged)]


def _figures(result: CaptureResult) -> list[WayFigures]:
    j = result.judged
    bounds = [(j.below, j.above), (j.above, j.below)]
    return [
        way_figures(link.delay, *bound)
        for link, bound in zip(result.links, bounds[: len(result.links)], strict=True)
    ]


def _count_line(link: RecordedLink) -> str:
    way, lost = link.way, link.way.lost
    length = float(way.seconds[-1])
    line = (
        f"{link.name}: {way.sent.size} samples in {length:.6g} s, "
        f"one every {1e3 * way.period:.6g} ms (median)"
    )
    if not way.how:
        return f"{line}; without numbers or a regular period losses are not known"
    if not lost.any():
        return f"{line}; none lost ({way.how})"
    burst, longest = runs(lost)
    return (
        f"{line}; lost {int(lost.sum())} ({float(lost.mean()):.3%}, {way.how}), "
        f"{burst:.1f} in a row in the mean, at most {longest}"
    )


def _clock_lines(j: JudgedWays) -> list[str]:
    if j.clock is None:
        return [j.why]
    low, middle, high = j.offset
    least, drift, most = j.clock.drift
    lines = [
        j.why,
        f"clock of the receiver: {middle:+.9g} s from the sender's at the start"
        f"{_between(low, high, 1.0, 's')}",
        f"its drift: {1e6 * drift:+.2f} ppm{_drift_bounds(least, most)}",
    ]
    if not isfinite(j.above):
        lines.append(
            f"the fastest samples are taken to have had {1e3 * j.least:.6g} ms, and others that "
            "much more: one direction does not tell; --least TIME states it, --most TIME bounds "
            "the clocks"
        )
    else:
        lines.append(f"delays are exact to -{1e3 * j.below:.3f} / +{1e3 * j.above:.3f} ms")
    lines += [f"the clocks jumped at {at:.3f} s" for at in j.clock.steps]
    return lines


def _between(low: float, high: float, unit: float, name: str) -> str:
    if not isfinite(low):
        return f", and no more than {unit * high:+.9g} {name} (one direction has no other bound)"
    return f" (between {unit * low:+.9g} and {unit * high:+.9g} {name})"


def _drift_bounds(least: float, most: float) -> str:
    if least <= -DRIFT and most >= DRIFT:
        return " (the line under the fastest samples; one direction has no bounds)"
    return f" (between {1e6 * least:+.2f} and {1e6 * most:+.2f} ppm)"


def link_lines(link: RecordedLink) -> list[str]:
    """The table, the nearest law and the netem line of a link."""
    return [
        f"{link.name}, as a link ({link.way.sent.size} rows in {link.file}):",
        *(f"  {line}" for line in link.toml().splitlines()),
        f"  # or a law, whose quantiles differ by {1e3 * link.law.error:.3g} ms in the mean:",
        *(f"  {line}" for line in link.law.toml().splitlines()),
        *(f"  {line}" for line in link.netem().splitlines()),
    ]


def capture_values(result: CaptureResult) -> dict[str, Any]:
    """The same for JSON, SI; None for what is not known or not bounded."""
    j = result.judged
    data: dict[str, Any] = {
        "recording": result.what, "stamps": result.stamps, "remarks": list(result.remarks),
        "one_clock": j.clock is None, "why": j.why, "below": j.below, "above": j.above,
        "links": {
            link.name: _link_values(link, f)
            for link, f in zip(result.links, _figures(result), strict=True)
        },
    }  # fmt: skip
    if j.clock is not None:
        names = ("least", "estimate", "most")
        data["offset"] = dict(zip(names, j.offset, strict=True))
        least, drift, most = j.clock.drift
        bound = least > -DRIFT or most < DRIFT
        known = (least if bound else -inf, drift, most if bound else inf)
        data["drift"] = dict(zip(names, known, strict=True))
        data["clock_steps"] = list(j.clock.steps)
    return data


def _link_values(link: RecordedLink, f: WayFigures) -> dict[str, Any]:
    way, (burst, longest) = link.way, runs(link.way.lost)
    return {
        "file": link.file, "toml": link.toml(), "law": link.law.toml(), "netem": link.netem(),
        "law_error": link.law.error, "samples": int(way.sent.size), "period": way.period,
        "duration": float(way.seconds[-1]), "delay": way_values(f),
        "loss": {
            "known": way.how or None, "share": float(np.mean(way.lost)), "burst": burst,
            "longest": longest,
        },
        "repeated": way.repeated, "equal_stamps": way.equal, "overtaken": way.overtaken,
        "unstamped": way.unstamped,
    }  # fmt: skip
