"""Values of inputs over time: tables of a file or of the scenario, and events.

All become the same: from times t_i on, an input has the value v_i + s_i (t - t_i). They are read at
the hits of the input's component; there is no delay and no interpolation within a step.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import number
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import conversion
from cosim.record.recording import Recording
from cosim.scenario.spec import EventSpec, InputSpec
from cosim.schedule.parts import Player, Slot

if TYPE_CHECKING:
    from cosim.scenario.connect import ScenarioComponents

Array = NDArray[np.float64]
#: Part of a step by which an event may be later than the tick it is applied at: rounding.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class TimedValues:
    """Values at the hits of a component, every `period` ticks of `h` s.

    From `times` (n,), s, increasing, on: `values` (n,) and `slopes` (n,) per s, in the unit of the
    signal; before the first time its value. Of rows at one time the last one counts from there on.
    `origin`: where they come from, for people; `start`: the time of the first hit, s.
    """

    times: Array
    values: Array
    slopes: Array
    period: int
    h: float
    origin: str
    details: Mapping[str, Any] = field(default_factory=dict)
    start: float = 0.0

    def stream(self) -> _TimedStream:
        """The values from the first hit on."""
        return _TimedStream(self)

    def facts(self) -> dict[str, Any]:
        """The origin of the values, as plain data."""
        return {"from": self.origin, **self.details}


class _TimedStream:
    """The values in order."""

    def __init__(self, source: TimedValues) -> None:
        self._source, self._next = source, 0
        self._first = np.ceil(
            (source.times - source.start) / source.h - _ROUNDING
        )  # tick from which each holds

    def rows(self, n: int) -> Array:
        """The next `n` values."""
        x = self._source
        ticks = np.arange(self._next, self._next + n) * x.period
        self._next += n
        i = np.searchsorted(self._first, ticks, side="right") - 1
        found = x.values[i] + x.slopes[i] * (x.start + ticks * x.h - x.times[i])
        return np.where(i < 0, x.values[0], found)


# ---- tables -----------------------------------------------------------------------------------


def table_players(parts: ScenarioComponents) -> list[Player]:
    """The inputs of components that are fed from a table. Raises ScenarioError."""
    found: list[Player] = []
    for name, spec in parts.scenario.components.items():
        for port, given in spec.inputs.items():
            if isinstance(given, InputSpec) and not given.source:
                place = parts.scenario.place("components", name, "inputs", port)
                target = parts.endpoint(f"{name}.{port}", "input", place)
                found += _table_players(parts, target, port, given, place)
    return found


def _table_players(
    parts: ScenarioComponents, target: Slot, port: str, spec: InputSpec, place: str
) -> list[Player]:
    t, rows, facts = (
        _from_file(parts, target, port, spec, place)
        if spec.table
        else _points(parts, target, spec, place)
    )
    period = parts.steps[target.component].period
    rows = spec.gain * rows + spec.offset
    slopes = np.zeros_like(rows)
    if spec.interpolate == "linear":
        slopes[:-1] = _slopes(t, rows)
    origin = f"the table {Path(spec.table).name}" if spec.table else "the points of the scenario"
    return [
        Player(
            slot,
            TimedValues(t, rows[:, i], slopes[:, i], period, parts.h, origin, facts, parts.start),
        )
        for i, slot in enumerate(_scalars(target))
    ]


def _slopes(t: Array, rows: Array) -> Array:
    """Slopes from each row to the next, per s, (n - 1, m); 0 at a jump (one time stands twice)."""
    steps = np.diff(t)[:, None]
    return np.divide(np.diff(rows, axis=0), steps, out=np.zeros_like(rows[1:]), where=steps > 0.0)


def _from_file(
    parts: ScenarioComponents, target: Slot, port: str, spec: InputSpec, place: str
) -> tuple[Array, Array, dict[str, Any]]:
    column = spec.column or port
    path = parts.scenario.path.parent / spec.table
    try:
        recording = Recording.read(path, (column,), jumps=True)
        rows = recording.signal(column, target.base if column == port else None)
        unit = recording.unit(column)
    except ScenarioError as error:
        raise ScenarioError(str(error), place) from None
    if rows.shape[1:] != target.shape:
        raise ScenarioError(
            f"{column} of {path} has shape {list(rows.shape[1:])}, {target.name} expects "
            f"{list(target.shape)}",
            place,
        )
    gain, offset = _conversion(parts, unit, target, f"{column} of {path}", place)
    facts = {"file": str(path), "column": column, "interpolate": spec.interpolate}
    return recording.t, gain * rows.reshape(len(rows), -1) + offset, facts


def _conversion(
    parts: ScenarioComponents, unit: str | None, target: Slot, what: str, place: str
) -> tuple[float, float]:
    same = len(set(target.units)) == 1  # of entries with units of their own
    expected = target.units[0] if same else target.unit
    if unit is None or unit == expected:
        return 1.0, 0.0
    try:
        return conversion(unit, expected if same else parts.unit(target))
    except UnitError:
        raise ScenarioError(
            f"units do not fit: {what} is in [{unit}], {target.name} expects [{expected}]", place
        ) from None


def _points(
    parts: ScenarioComponents, target: Slot, spec: InputSpec, place: str
) -> tuple[Array, Array, dict[str, Any]]:
    rows = [
        (number(t, "s", f"{place}.points.{i}"), parts.values(target, value, f"{place}.points.{i}"))
        for i, (t, value) in enumerate(spec.points)
    ]
    times = np.array([t for t, _ in rows])
    if not (np.diff(times) >= 0.0).all():
        raise ScenarioError("the times of the points do not increase", f"{place}.points")
    facts = {"points": len(rows), "interpolate": spec.interpolate}
    return times, np.array([v for _, v in rows]).reshape(len(rows), -1), facts


# ---- events -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Change:
    """A scalar becomes `value` at `at` s, over `over` s, and goes back after `lasts` s, if any."""

    at: float
    value: float
    over: float
    lasts: float | None
    place: str

    @property
    def end(self) -> float:
        """The time from which the scalar is at rest again, s."""
        return self.at + self.over if self.lasts is None else self.at + self.lasts + self.over


def event_players(parts: ScenarioComponents) -> list[Player]:
    """The inputs that the events of the scenario change. Raises ScenarioError."""
    changes: defaultdict[Slot, list[_Change]] = defaultdict(list)
    for i, event in enumerate(parts.scenario.events):
        _collect(parts, event, parts.scenario.place("events", i), changes)
    return [_event_player(parts, slot, found) for slot, found in changes.items()]


def _collect(
    parts: ScenarioComponents,
    event: EventSpec,
    place: str,
    changes: defaultdict[Slot, list[_Change]],
) -> None:
    at, over = number(event.at, "s", f"{place}.at"), number(event.over, "s", f"{place}.over")
    lasts = None if event.lasts is None else number(event.lasts, "s", f"{place}.for")
    begin = parts.start
    for key, time, least in (
        ("at", at - begin, f"{begin:g} s or more" + (", where the run starts" if begin else "")),
        ("over", over, "0 s or more"),
        ("for", 0.0 if lasts is None else lasts - over, "at least `over`"),
    ):
        if time < 0.0:
            raise ScenarioError(f"expected {least}", f"{place}.{key}")
    for text, value in event.set.items():
        target = parts.endpoint(text, "input", f"{place}.set")
        given = parts.values(target, value, f"{place}.set.{text}")
        for slot, wanted in zip(_scalars(target), given, strict=True):
            changes[slot].append(_Change(at, wanted, over, lasts, place))


def _event_player(parts: ScenarioComponents, slot: Slot, changes: Sequence[_Change]) -> Player:
    step = parts.steps[slot.component]
    now = parts.held(slot)
    rows: list[tuple[float, float, float]] = [(parts.start, now, 0.0)]
    ordered = sorted(changes, key=lambda c: c.at)
    for change, following in zip(ordered, [*ordered[1:], None], strict=True):
        if following is not None and following.at < change.end - _ROUNDING * parts.h:
            raise ScenarioError(
                f"changes {slot.name} at {following.at:g} s, before the event at {change.at:g} s "
                f"is over at {change.end:g} s",
                following.place,
            )
        rows += _ramp(change.at, now, change.value, change.over)
        if change.lasts is not None:
            rows += _ramp(change.at + change.lasts, change.value, now, change.over)
        else:
            now = change.value
    times, values, slopes = (np.array(x) for x in zip(*rows, strict=True))
    times = np.maximum.accumulate(times)  # 0.1 s + 0.2 s is after 0.3 s, by rounding
    source = TimedValues(
        times, values, slopes, step.period, parts.h, "events of the scenario",
        {"events": len(changes)}, parts.start,
    )  # fmt: skip
    return Player(slot, source)


def _ramp(at: float, start: float, end: float, over: float) -> list[tuple[float, float, float]]:
    if over == 0.0:
        return [(at, end, 0.0)]
    return [(at, start, (end - start) / over), (at + over, end, 0.0)]


def _scalars(slot: Slot) -> list[Slot]:
    """The scalars of a slot, as slots."""
    return [
        replace(slot, name=name, start=slot.start + i, shape=())
        for i, name in enumerate(slot.scalars())
    ]
