"""Cases that run side by side: one pool, one way to interrupt them, one account of what is missing.

Sweeps, comparisons, campaigns and soak tests differ in how cases are made and what runs one of
them; this module knows neither.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol, TypeVar

from cosim.base.errors import ScenarioError
from cosim.base.interrupts import stop_on_signal
from cosim.base.processes import Opened, spread
from cosim.fmi import components
from cosim.schedule.plan import Plan
from cosim.study import store as stores

C = TypeVar("C")
R = TypeVar("R", contravariant=True)


@dataclass(frozen=True, slots=True)
class PlannedRuns:
    """The work to be done: `points` of the study, which are `runs` different ones, `found` there.

    `to_run`: runs this time; `changed`: the folder was begun with another study; `foreign_rows`:
    rows in it that this study does not have; `retried`: of those found, the runs that failed and
    are made again.
    """

    points: int
    runs: int
    found: int
    to_run: int
    changed: bool = False
    foreign_rows: int = 0
    retried: int = 0


@dataclass(frozen=True, slots=True)
class Observer:
    """Observer of many runs: `begun` once, `done` with every row, `stopping` after Ctrl-C.

    A row is what a run returns; its `reason` says why it has no result, empty if it has.
    """

    begun: Callable[[PlannedRuns], None] = lambda begun: None
    done: Callable[[Any], None] = lambda row: None
    stopping: Callable[[], None] = lambda: None


UNOBSERVED = Observer()


@contextmanager
def interruptible(stopping: Callable[[], None] = lambda: None) -> Iterator[Callable[[], bool]]:
    """A block whose first Ctrl-C calls `stopping`, and lets active runs come to their end.

    The value tells whether it came; KeyboardInterrupt is raised at the end of the block, or by a
    second Ctrl-C.
    """
    pressed: list[bool] = []

    def stop() -> None:
        pressed.append(True)
        stopping()

    with stop_on_signal(stop):
        yield lambda: bool(pressed)


def perform(
    function: Callable[[C], R],
    cases: Sequence[C],
    opened: Opened | None,
    stopping: Callable[[], None] = lambda: None,
) -> Iterator[tuple[C, R | str]]:
    """(case, result) in the order of completion; a text instead of the result if the worker died.

    `opened`: None runs the cases in this process, one after the other, where nothing holds off a
    crash. Raises what `function` raises, and KeyboardInterrupt once active calls have ended.
    """
    if opened is None:
        for case in cases:
            yield case, function(case)
        return
    with interruptible(stopping) as stopped:
        yield from spread(opened, function, cases, stopped)


class RowStore(Protocol[R]):
    """The place where rows stay: names of runs that are `done`, and of those that `failed`."""

    done: set[str]
    failed: set[str]

    def append(self, row: R, /) -> None:
        """Take a row."""


def run_named(
    function: Callable[[C], R],
    cases: Mapping[str, C],
    store: RowStore[R],
    opened: Opened | None,
    observer: Observer = UNOBSERVED,
    *,
    retry: bool = False,
    died: Callable[[str, str], R],
) -> None:
    """Run the cases whose rows the store lacks; with `retry` also those whose newest row failed.

    `function` runs a case and returns the row of its name; `died` makes the row of a name whose
    worker died, with the reason. `opened`: as :func:`perform` takes it.
    """
    again = store.failed & set(cases) if retry else set[str]()
    names = {id(case): name for name, case in cases.items()}
    todo = [case for name, case in cases.items() if name not in store.done - again]
    there = len(store.done & set(cases))
    observer.begun(PlannedRuns(len(cases), len(cases), there, len(todo), retried=len(again)))
    for case, result in perform(function, todo, opened, observer.stopping):
        row = died(names[id(case)], result) if isinstance(result, str) else result
        store.append(row)
        observer.done(row)


def claim(folder: Path, what: str, facts: Mapping[str, Any]) -> bool:
    """Take a folder for runs with these facts; true if it has none yet.

    It is empty, or was begun with the same facts. Raises ScenarioError, in which `what` says what
    the folder is for.
    """
    state = stores.read_state(folder)
    refuse_others(folder, what, state)
    for key, value in facts.items():
        if state and state.get(key) != value:
            raise ScenarioError(
                f"was started with another {key}, {state.get(key)}; expected {value}, or another "
                "folder",
                str(folder),
            )
    return not state


def fingerprint_of(data: bytes, plans: Sequence[Plan]) -> str:
    """A hash of what runs have in common: `data`, and the FMUs of these plans."""
    facts = {
        step.name: found["sha256"]
        for plan in plans
        for step in plan.components
        if (found := components.facts(step.component)) is not None
    }
    return sha256(data + json.dumps(facts, sort_keys=True).encode()).hexdigest()


def refuse_others(folder: Path, what: str, state: Mapping[str, Any]) -> None:
    """Raise ScenarioError if there are files in a folder without a state."""
    present = sorted(p.name for p in folder.iterdir())
    if present and not state:
        raise ScenarioError(
            f"the folder holds {present[0]} but no {what}; expected an empty folder", str(folder)
        )
