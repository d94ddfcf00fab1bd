"""Times of a run that diagrams mark: events of its scenario, faults and fault states of a
rehearsal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cosim.base.convert import number
from cosim.record.folder import FINISHED
from cosim.reporting.html import TimedEvent


def marks(facts: Mapping[str, Any]) -> list[TimedEvent]:
    """The marks in every diagram of a run, by time.

    `facts`: ``run.json``. Its key ``marks`` holds what the nodes of a rehearsal went through.
    """
    given = (facts.get("scenario") or {}).get("events") or ()
    found = [*map(_event, given), *(TimedEvent(**mark) for mark in facts.get("marks", ()))]
    return sorted(found, key=lambda mark: mark.t)


def _event(event: Mapping[str, Any]) -> TimedEvent:
    """A table ``[[events]]``: until its values have changed, and changed back."""
    at, over, lasts = (number(event.get(key) or 0.0, "s", key) for key in ("at", "over", "for"))
    values = ", ".join(f"{name} = {value}" for name, value in event["set"].items())
    length = over + lasts
    return TimedEvent(at, values, at + length if length > 0.0 else None)


def failure(facts: Mapping[str, Any]) -> str:
    """The end of a run that was cut short, as one sentence; "" for any other."""
    return "; ".join(_failure(facts))


def _failure(facts: Mapping[str, Any]) -> Iterator[str]:
    judged = facts.get("rehearsal") or {}
    if judged.get("verdict") == "failed":
        yield from judged.get("reasons", ())
        return
    status = facts.get("status", FINISHED)
    if status != FINISHED:
        yield str(facts.get("error") or f"the run is {status}").removeprefix("RunError: ")
