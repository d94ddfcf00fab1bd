"""Requests of a node to the operating system (priority, memory, timers), and their results.

The requests are independent, and the report has one row for each: granted or refused, and why. With
`ask` a node continues without refused requests (rehearsal); with `enforce` it refuses to start
(hardware). The kernel's throttling of real-time tasks is not changed, so that a node that never
sleeps cannot block the machine. Threads and processes started later are not real-time. See
``docs/rehearsal.md``.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from bridge.native import pace
from bridge.realtime.lateness import Lateness, lateness
from bridge.realtime.os_grants import ASKED, Item, Mode, Realtime, kernel, reason
from cosim.base.copies import asdict
from cosim.base.errors import CosimError

#: Greatest p99.9 of the lateness a node may have to be armed, as a share of its period.
LIMIT = 0.2

#: What `enforce` insists on where it is asked for; the rest helps and is only reported.
REQUIRED = ("cpus", "scheduler", "memory")

__all__ = [
    "LIMIT",
    "REQUIRED",
    "Granted",
    "Item",
    "Mode",
    "Realtime",
    "RealtimeError",
    "enter",
    "warm_up",
    "warm_up_warning",
]


class RealtimeError(CosimError, RuntimeError):
    """The machine does not give what a node on hardware needs."""

    exit_code = 1


@dataclass(slots=True)
@final
class Granted:
    """The granted requests; leaving them (``with``, or :meth:`leave`) gives everything back."""

    mode: Mode
    kernel: str
    items: tuple[Item, ...]
    _undo: ExitStack = field(default_factory=ExitStack, repr=False)

    def __enter__(self) -> Granted:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def leave(self) -> None:
        """Put everything back as it was before, last first; again: nothing."""
        self._undo.close()

    @property
    def refused(self) -> tuple[Item, ...]:
        """The requests that were not granted."""
        return tuple(item for item in self.items if not item.granted)

    def rows(self) -> list[list[str]]:
        """A header and a row each: name, yes or no, what exactly or why not."""
        rows = [[i.name, "yes" if i.granted else "no", i.said] for i in self.items]
        return [["asked for", "granted", ""], *rows, ["kernel", "", self.kernel]]

    def facts(self) -> dict[str, Any]:
        """Everything as JSON takes it."""
        return {"mode": self.mode, "kernel": self.kernel, "items": [asdict(i) for i in self.items]}


def enter(spec: Realtime) -> Granted:
    """Request everything in `spec` for this process and the calling thread.

    Raises RealtimeError in mode `enforce` if something in :data:`REQUIRED` is refused (everything
    else is released first), and CosimError for an invalid priority or CPU.
    """
    if not 0 <= spec.priority <= 99 or any(cpu < 0 for cpu in spec.cpus):
        raise CosimError(
            f"real time: found priority {spec.priority} and CPUs {spec.cpus}; expected a priority "
            "from 0 to 99 and CPUs from 0 on"
        )
    items = []
    with ExitStack() as undo:
        for name, wanted, ask in ASKED:
            if wanted(spec):
                try:
                    items.append(Item(name, True, ask(spec, undo)))
                except OSError as error:
                    items.append(Item(name, False, reason(name, spec, error)))
        granted = Granted(spec.mode, kernel(), tuple(items), undo.pop_all())
    missing = [i for i in granted.refused if i.name in REQUIRED]
    if spec.mode == "enforce" and missing:
        granted.leave()
        said = "; ".join(f"{i.name}: {i.said}" for i in missing)
        raise RealtimeError(f"real time is enforced and was not granted: {said}")
    return granted


def warm_up(period_ns: int, seconds: float = 1.0, spin_ns: int = 0) -> Lateness:
    """Lateness of this thread when it only sleeps, measured for `seconds` (s). Blocks that long."""
    n = max(2, round(seconds * 1e9 / period_ns))
    start = pace.now() + period_ns
    woke = pace.run(start, period_ns, n, spin_ns)
    return lateness(start + period_ns * np.arange(n), woke, period_ns)


def warm_up_warning(found: Lateness, mode: Mode) -> str:
    """Empty when a warm-up was good enough to arm, else the warning.

    Raises RealtimeError with it in mode `enforce`.
    """
    if found.ratio <= LIMIT:
        return ""
    said = (
        f"warm-up of {found.late.count} slots: p99.9 of the lateness is "
        f"{found.late.p999 * 1e-3:.0f} us, {100 * found.ratio:.0f} % of the period of "
        f"{found.period_ns * 1e-3:g} us; expected at most {100 * LIMIT:.0f} %"
    )
    if mode == "enforce":
        raise RealtimeError(f"did not arm: {said}")
    return said
