"""Parts of a report: what the check found, controllers, and configured delays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from math import inf, nan
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.base.units import engineering, engineering_range, prefixed, readable
from cosim.measure.joint_limits import beyond
from cosim.record import Run
from cosim.record.piecewise import PairwiseSum
from cosim.reporting import many
from cosim.reporting.html import folded, table

Array: TypeAlias = NDArray[np.float64]

#: The share of a run at its end, over which a signal is said to settle or not.
TAIL = 0.1


def findings(facts: Mapping[str, Any]) -> str:
    """The findings of the check before the run, as HTML. `facts`: ``run.json``."""
    found = facts.get("findings")
    if found is None:
        return "<h2>Check before the run</h2><p>Not checked.</p>"
    rows = [(f["severity"], f["where"], f["reason"], f.get("advice", ""), f["rule"]) for f in found]
    if not rows:
        return "<h2>Check before the run</h2><p>It found no error and no warning.</p>"
    head = ["severity", "where", "what was found", "what to change", "rule"]
    return f"<h2>Check before the run</h2>{table(head, rows)}"


def limits(run: Run, facts: Mapping[str, Any]) -> str:
    """Joints that left their limits in a run, as HTML; "" for none. `facts`: ``run.json``."""
    said = beyond(facts.get("limits", {}), run)
    return "".join(f"<p>{escape(sentence)}.</p>" for sentence in said)


def controllers(run: Run, facts: Mapping[str, Any]) -> str:
    """Recorded signals of every sampled component, as a folded table, not on paper; "" without any.

    A signal that a limit cuts off is at its greatest magnitude for more than a moment.
    """
    of = set(facts.get("order", ()))
    names = [name for name in run.names if name.partition(".")[0] in of] if len(run) else []
    if not names:
        return ""
    head = ["signal", "unit", "start", "end", "least", "greatest", "RMS",
            f"change in the last {TAIL:.0%}", "time at its greatest magnitude"]  # fmt: skip
    rows = _controller_rows(run, names[: many.ROWS])
    below = many.further(len(names), many.ROWS, "signals")
    whole = folded("Controllers", table(head, rows, len(head) - 2) + below)
    return f'<div class="screen">{whole}</div>'


def _controller_rows(run: Run, names: Sequence[str]) -> list[tuple[str, ...]]:
    """The name, the printed unit and the numbers of each of these signals."""
    ranges = {name: _SignalRange(len(run)) for name in names}
    for piece in run.pieces(names):
        for name, found in ranges.items():
            found.add(piece.column(name))
    counts = dict.fromkeys(names, 0)
    for piece in run.pieces(names):
        for name, found in ranges.items():
            counts[name] += int((np.abs(piece.column(name)) == found.magnitude).sum())
    return [(name, *x.texts(run.units[name], counts[name])) for name, x in ranges.items()]


class _SignalRange:
    """Extremes and RMS of a signal of `count` rows that come in pieces, in its unit."""

    def __init__(self, count: int) -> None:
        self._count, self._tail, self._at = count, int(count * (1 - TAIL)), 0
        self._squares = PairwiseSum(count)
        self._ends = (nan, nan)
        self._whole, self._late = (inf, -inf), (inf, -inf)  # least and greatest

    def add(self, x: Array) -> None:
        """Take the next rows, (n,)."""
        self._squares.add(x**2)
        self._ends = (self._ends[0] if self._at else float(x[0])), float(x[-1])
        self._whole = _wider(self._whole, x)
        self._late = _wider(self._late, x[max(0, self._tail - self._at) :])
        self._at += len(x)

    @property
    def magnitude(self) -> float:
        """The greatest magnitude; NaN where one is."""
        return float(np.maximum(-self._whole[0], self._whole[1]))

    def texts(self, unit: str, at_greatest: int) -> Iterator[str]:
        """The printed unit of the signal and its numbers in it."""
        rms = float(np.sqrt(self._squares.value / self._count))
        scale, shown = prefixed(self.magnitude, unit)
        yield shown
        for value in (*self._ends, *self._whole, rms, self._late[1] - self._late[0]):
            yield readable(scale * value)
        changes = self._whole[1] - self._whole[0] > 0
        yield f"{100 * (at_greatest / self._count):.3g} %" if changes else "–"


def _wider(known: tuple[float, float], x: Array) -> tuple[float, float]:
    """The least and the greatest of both; NaN where one is."""
    if not len(x):
        return known
    return float(np.minimum(known[0], x.min())), float(np.maximum(known[1], x.max()))


def configured_delay(law: Mapping[str, Any]) -> str:
    """A delay law with units: ``0.3 to 1.2 s, held 30 ms`` or ``gamma, shape 2, scale 5 ms``."""
    keys = {k: v for k, v in law.items() if k not in _UNSAID and v is not None}
    hold, kind = keys.pop("hold", None), str(law.get("law", ""))
    if kind == "uniform" and {"low", "high"} <= keys.keys():
        said = engineering_range(keys["low"], keys["high"], "s")
    elif kind == "constant" and "delay" in keys:
        said = engineering(keys["delay"], "s")
    else:
        said = ", ".join([kind, *(_said(key, x) for key, x in keys.items() if x is not False)])
    return f"{said}, held {_value('hold', hold)}" if hold else said


#: Keys of a delay law that are not in a table of links, and those that are times, s.
_UNSAID = ("law", "loss", "sha256", "lookup")
_TIMES = {"hold", "delay", "low", "high", "shift", "scale", "minimum", "maximum", "median", "mean",
          "centre", "sd", "step", "means", "levels", "dwell"}  # fmt: skip


def _said(key: str, value: Any) -> str:
    return _value(key, value) if key == "file" else f"{key} {_value(key, value)}".rstrip()


def _value(key: str, value: Any) -> str:
    if isinstance(value, Mapping):
        return f"({configured_delay(value)})"
    if isinstance(value, list | tuple):
        return " / ".join(_value(key, x) for x in value)
    if isinstance(value, bool):
        return ""
    if isinstance(value, int | float):
        return engineering(value, "s" if key in _TIMES else "1")
    return Path(value).name if key == "file" else str(value)
