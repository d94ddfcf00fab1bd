"""The result of a ping: as text, and as values for JSON."""

from __future__ import annotations

from math import inf, isfinite, isnan
from typing import Any

import numpy as np

from bridge.ping.exchanges import CAPACITY, Exchanges
from bridge.ping.figures import PathResult, WayFigures
from bridge.ping.intervals import FEWEST

#: Columns of the table of delays.
COLUMNS = ("min", "p50", "p95", "p99", "p99.9", "max", "mean", "sd", "jitter")


def live_line(record: Exchanges) -> str:
    """One line while it runs."""
    lost = record.sent - record.received
    return (
        f"{record.sent} sent, {record.received} answered, {lost} open or lost, "
        f"last round trip {record.last_rtt_ns * 1e-6:.3f} ms"
    )


def text(result: PathResult) -> list[str]:
    """All that was found, in lines."""
    return [
        *_counts(result), *_table(result), *_clock_lines(result),
        *_loss_lines(result), *_parts(result), *_advice(result),
    ]  # fmt: skip


def _counts(result: PathResult) -> list[str]:
    record = result.record
    took = float(result.sent[-1] - result.sent[0])
    rate = (result.sent.size - 1) / took if took > 0 else 0.0
    lines = [
        f"{record.what}: {record.sent} questions of {record.size} bytes, {rate:.4g} a second "
        f"(asked: {1e9 / record.period_ns:.4g}), {record.received} answered"
    ]
    if record.sent > result.sent.size:
        lines.append(f"figures are of the last {CAPACITY} questions")
    odd = [
        f"{n} {what}"
        for n, what in (
            (record.reordered, "answers overtaken"),
            (record.duplicates, "duplicates"),
            (record.strange, "packets that were no answer"),
            (record.refused, "questions refused by this system"),
        )
        if n
    ]
    return [*lines, *([", ".join(odd)] if odd else [])]


def cells(f: WayFigures) -> tuple[float, ...]:
    """The figures of `COLUMNS`, s."""
    return (f.minimum, *f.quantiles, f.maximum, f.mean, f.sd, f.jitter)


def _table(result: PathResult) -> list[str]:
    lines = [" " * 12 + "".join(f"{h:>9}" for h in COLUMNS) + "   (ms)"]
    figures = result.figures()
    for name, found in figures.items():
        lines.append(f"{name:<12}" + "".join(f"{1e3 * x:9.3f}" for x in cells(found)))
    return [*lines, *_confidence(figures["round trip"])]


def _confidence(f: WayFigures) -> list[str]:
    p50, _, p99, p999 = zip(("p50", "p95", "p99", "p99.9"), f.ranges, f.independent, strict=True)
    said = "; ".join(_interval(*one) for one in (p50, p99))
    lines = [f"of the round trip (95 %): {said}; autocorrelation of neighbours {f.lag1:.2f}"]
    if not isfinite(p999[1][1]):
        lines.append(f"p99.9 has no upper bound with {f.n} answers: measure longer")
    return lines


def _interval(name: str, ends: tuple[float, float], independent: float) -> str:
    """An interval, and how much the delays say of it although they depend on each other."""
    if independent < FEWEST:
        return (
            f"{name} has no interval, since the answers say as little of it as "
            f"{independent:.0f} independent ones: measure longer"
        )
    low, high = (f"{1e3 * x:.3f}" if isfinite(x) else "no bound" for x in ends)
    return f"{name} between {low} and {high} ms, as of {independent:.0f} independent answers"


def _clock_lines(result: PathResult) -> list[str]:
    if result.clock is None:
        return ["the other end has no clock to ask: each way is between 0 and the round trip"]
    if result.same_host:
        return ["both ends have one clock (the same host): each way is exact"]
    low, middle, high = (float(x[0]) for x in result.clock.offsets(result.sent[-1:]))
    slowest, drift, fastest = (1e6 * x for x in result.clock.drift)
    lines = [
        f"each way: to within {1e3 * result.uncertainty:.3f} ms (the two ends cannot see whether "
        "their fastest packets took equally long; the sum is exact)",
        f"clock of the other end: known to -{1e3 * (middle - low):.3f} / "
        f"+{1e3 * (high - middle):.3f} ms, drift {drift:+.2f} ppm "
        f"({slowest:+.2f} to {fastest:+.2f})",
    ]
    if result.dates is not None:
        lines.append(
            f"date of the other host: {1e3 * result.dates:+.3f} ms from ours, "
            f"to within {1e3 * result.uncertainty:.3f} ms"
        )
        lines.append(_dates_line(result.kept))
    lines += [f"the other clock jumped at {at:.1f} s" for at in result.clock.steps]
    return lines


def _dates_line(kept: tuple[float, float]) -> str:
    """True if runs in lock-step and limits of age can rely on the dates of both hosts."""
    lacking = [host for host, error in zip(("here", "there"), kept, strict=True) if error == inf]
    if lacking:
        return (
            f"the hosts do not share a date: no time server keeps it {' and '.join(lacking)}; a "
            "common start and max_age need chrony, ptp4l or systemd-timesyncd on both"
        )
    here, there = (1e3 * error for error in kept)
    return (
        f"time servers keep the date of both hosts: here to {here:.3g} ms, there to {there:.3g} ms"
    )


def _loss_lines(result: PathResult) -> list[str]:
    loss = result.loss
    if not loss.share:
        return ["nothing lost"]
    line = f"lost {loss.share:.3%}, {loss.burst:.1f} in a row in the mean, at most {loss.longest}"
    if not isnan(loss.there):
        line += f"; there {loss.there:.3%} of the questions, back {loss.back:.3%} of the answers"
    lines = [line]
    if loss.undecided:
        lines.append(
            f"{loss.undecided:.3%} of the questions count as lost there although they may have "
            "arrived: no later answer of the same responder counts them"
        )
    if loss.outages:
        lines.append(f"{loss.outages} outages, the longest {loss.longest_outage:.3f} s")
    return lines


def _parts(result: PathResult) -> list[str]:
    cells = ", ".join(f"{name} {1e6 * t:.0f} us" for name, t in result.parts.items())
    late = np.quantile(result.late, (0.5, 0.99))
    return [
        f"where a round trip goes (medians): {cells}",
        f"questions left {1e6 * late[0]:.0f} us (p50), {1e6 * late[1]:.0f} us (p99), "
        f"{1e6 * float(result.late.max()):.0f} us (max) after their time",
    ]


def _advice(result: PathResult) -> list[str]:
    asked = 1e9 / result.record.period_ns
    took = float(result.sent[-1] - result.sent[0])
    reached = (result.sent.size - 1) / took if took > 0 else asked
    if reached < 0.95 * asked:
        return [f"this host sent {reached:.4g} a second instead of {asked:.4g}"]
    return []


def values(result: PathResult) -> dict[str, Any]:
    """The same for JSON: SI, None for what is not known or not bounded."""
    record, loss = result.record, result.loss
    data: dict[str, Any] = {
        "path": record.what, "size": record.size, "period": record.period_ns * 1e-9,
        "sent": record.sent, "answered": record.received, "kept": int(result.sent.size),
        "overtaken": record.reordered, "duplicates": record.duplicates,
        "strange": record.strange, "refused": record.refused,
        "delays": {name: way_values(found) for name, found in result.figures().items()},
        "uncertainty": _finite(result.uncertainty), "same_clock": result.same_host,
        "date_difference": result.dates,
        "date_errors": [_finite(error) for error in result.kept],
        "loss": {
            "share": loss.share, "there": _finite(loss.there), "back": _finite(loss.back),
            "undecided": loss.undecided,
            "burst": loss.burst, "longest": loss.longest,
            "outages": loss.outages, "longest_outage": loss.longest_outage,
        },
        "parts": result.parts, "late_max": float(result.late.max()),
    }  # fmt: skip
    if result.clock is not None:
        data["drift"] = dict(zip(("least", "estimate", "most"), result.clock.drift, strict=True))
        data["clock_steps"] = list(result.clock.steps)
    return data


def way_values(f: WayFigures) -> dict[str, Any]:
    """Figures of a direction for JSON, s."""
    names = ("p50", "p95", "p99", "p99.9")
    return {
        "n": f.n, "min": f.minimum, "mean": f.mean, "sd": f.sd, "max": f.maximum,
        "jitter": f.jitter, "autocorrelation": f.lag1,
        **dict(zip(names, f.quantiles, strict=True)),
        "confidence": {
            n: [_finite(x) for x in r] for n, r in zip(names, f.ranges, strict=True)
        },
        "independent": dict(zip(names, f.independent, strict=True)),
    }  # fmt: skip


def _finite(x: float) -> float | None:
    return x if -inf < x < inf else None
