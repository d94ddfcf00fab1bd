"""Parts of a report: what the check found, controllers, and configured delays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.measure.joint_limits import beyond
from cosim.record import Run
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
    """Recorded signals of every sampled component, as a folded table; "" without any.

    A signal that a limit cuts off is at its greatest magnitude for more than a moment.
    """
    of = set(facts.get("order", ()))
    names = [name for name in run.names if name.partition(".")[0] in of] if len(run) else []
    if not names:
        return ""
    head = ["signal", "unit", "start", "end", "least", "greatest", "RMS",
            f"change in the last {TAIL:.0%}", "time at its greatest magnitude"]  # fmt: skip
    rows = [(name, run.units[name], *_numbers(run.column(name))) for name in names[: many.ROWS]]
    below = many.further(len(names), many.ROWS, "signals")
    return folded("Controllers", table(head, rows, len(head) - 2) + below)


def _numbers(x: Array) -> Iterator[str]:
    tail = x[int(len(x) * (1 - TAIL)) :]
    rms = float(np.sqrt(np.mean(x**2)))
    for value in (x[0], x[-1], np.min(x), np.max(x), rms, np.ptp(tail)):
        yield f"{value:.4g}"
    magnitude = np.abs(x)
    changes = bool(np.ptp(x) > 0)
    yield f"{np.mean(magnitude == magnitude.max()):.2%}" if changes else "–"


def configured_delay(law: Mapping[str, Any]) -> str:
    """A delay law as the scenario has it: ``uniform, low = 0.3, high = 1.2``."""
    values = [f"{k} = {v}" for k, v in law.items() if k not in ("law", "hold") and v is not None]
    return ", ".join([str(law.get("law", "")), *values])


def transit(ages: Array, sent: NDArray[np.int64]) -> Array:
    """The age of each used sample of a link when its receiver first held it, (samples,), s.

    `ages` (n,), s, and `sent` (n,): of the sample held at every look, -1 for none. A delay that the
    link drew shows up rounded up to the receiver's next look.
    """
    new = np.flatnonzero((sent >= 0) & (np.diff(sent, prepend=-1) != 0))
    return ages[new]
