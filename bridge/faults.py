"""Fault scripts: what goes wrong on purpose, when, and to whom. TOML read into frozen structs.

A key that is no field of a kind is an error; every error names the file and the place in it. What
the kinds mean is in docs/faults.md; what is done with a script, in :mod:`bridge.fault_script`.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any

import msgspec

from bridge.fault_script import Action, Event, FaultScript, FrameFault
from cosim.errors import ScenarioError
from cosim.scenario import Number, convert, number, read_document

Names = str | tuple[str, ...]
Range = Number | tuple[Number, Number]
Count = Annotated[int, msgspec.Meta(ge=1, le=2**20)]


class _Spec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One table ``[[fault]]``; the fields say what a kind may have."""

    kind: str


class SyncLossSpec(_Spec, frozen=True, kw_only=True, rename={"start": "from", "end": "to"}):
    """The messages called SYNC are not received. No `end`: to the end of the run."""

    node: Names = "*"
    start: Number = 0
    end: Number | None = None
    probability: Number = 1


class DropSpec(SyncLossSpec, frozen=True, kw_only=True):
    """Frames are not received: of `message` (a name, a pattern or an identifier), on `bus`."""

    message: str | int | tuple[str | int, ...] = "*"
    bus: str = ""


class CountSpec(DropSpec, frozen=True, kw_only=True):
    """`burst`: frames lost in a row; `corrupt`: bits flipped in one."""

    count: Count = 1


class LateSpec(DropSpec, frozen=True, kw_only=True):
    """`delay`, `jitter`: by so long, or by a time between two."""

    by: Range


class DuplicateSpec(CountSpec, frozen=True, kw_only=True):
    """`count` more, each `by` later than the first."""

    by: Range = 0


class ReorderSpec(DropSpec, frozen=True, kw_only=True):
    """After the next one, or `within` so long if there is none."""

    within: Number = 1


class KillSpec(_Spec, frozen=True, kw_only=True):
    """SIGKILL, for good."""

    node: Names
    at: Number


class RestartSpec(KillSpec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """SIGKILL, and a new process `lasts` later."""

    lasts: Number = 0


class FreezeSpec(KillSpec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """SIGSTOP, and SIGCONT `lasts` later."""

    lasts: Number


class ClockJumpSpec(KillSpec, frozen=True, kw_only=True):
    """The node's clock jumps `by`, forwards or (negative) back."""

    by: Number


class BusDownSpec(_Spec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """The interface is down for `lasts`."""

    bus: Names
    at: Number
    lasts: Number


class BabbleSpec(_Spec, frozen=True, kw_only=True, rename={"start": "from", "end": "to"}):
    """Somebody sends frames of `length` bytes with this identifier at this rate."""

    bus: Names
    id: Annotated[int, msgspec.Meta(ge=0, le=0x9FFFFFFF)]
    rate: Number
    length: Annotated[int, msgspec.Meta(ge=0, le=64)] = 8
    start: Number = 0
    end: Number | None = None


SPECS: dict[str, type[_Spec]] = {
    "drop": DropSpec,
    "burst": CountSpec,
    "delay": LateSpec,
    "jitter": LateSpec,
    "duplicate": DuplicateSpec,
    "reorder": ReorderSpec,
    "corrupt": CountSpec,
    "sync-loss": SyncLossSpec,
    "kill": KillSpec,
    "restart": RestartSpec,
    "freeze": FreezeSpec,
    "clock-jump": ClockJumpSpec,
    "bus-down": BusDownSpec,
    "babble": BabbleSpec,
}


def load(path: Path) -> FaultScript:
    """Read a script. Raises ScenarioError that names the file and the place in it."""
    return build(read_document(path), path)


def build(document: Mapping[str, Any], path: Path) -> FaultScript:
    """A script from an already parsed document. Raises ScenarioError."""
    for key in document:
        if key not in ("title", "seed", "fault"):
            raise ScenarioError(f"unknown key {key!r}; expected title, seed or fault", f"{path}")
    tables = document.get("fault", [])
    if not isinstance(tables, list):
        raise ScenarioError("expected an array of tables, [[fault]]", f"{path} at fault")
    frames: list[FrameFault] = []
    events: list[Event] = []
    for index, table in enumerate(tables):
        place = _Place(path, index)
        spec = _spec(table, place)
        if isinstance(spec, SyncLossSpec):
            frames.append(_frame_fault(spec, place))
        else:
            events += _events(spec, place)
    return FaultScript(
        path=path,
        title=convert(document.get("title", path.stem), str, path, "title"),
        seed=convert(document.get("seed", 0), int, path, "seed"),
        frames=tuple(frames),
        events=tuple(sorted(events, key=lambda e: (e.t, e.index))),
    )


class _Place:
    """A table of the file: what is read from it, with the place in every error."""

    def __init__(self, path: Path, index: int) -> None:
        self.path, self.index = path, index

    def of(self, key: str) -> str:
        return f"{self.path} at fault.{self.index}.{key}"

    def value(
        self, key: str, value: Number, unit: str = "s", low: float = 0, high: float = inf
    ) -> float:
        found = number(value, unit, self.of(key))
        if not (isfinite(found) and low <= found <= high):
            limit = f"{low:g} to {high:g}" if high < inf else f"{low:g} or more"
            raise ScenarioError(f"is {found:g}; expected {limit}", self.of(key))
        return found

    def span(self, start: Number, end: Number | None) -> tuple[float, float]:
        t0 = self.value("from", start)
        t1 = inf if end is None else self.value("to", end)
        if t1 <= t0:
            raise ScenarioError(f"is {t1:g} s; expected more than from, {t0:g} s", self.of("to"))
        return t0, t1

    def between(self, by: Range) -> tuple[float, float]:
        a, b = by if isinstance(by, tuple) else (by, by)
        low, high = self.value("by", a), self.value("by", b)
        if high < low:
            raise ScenarioError(
                f"is {low:g} to {high:g} s; expected [least, greatest]", self.of("by")
            )
        return low, high


def _spec(table: Any, place: _Place) -> _Spec:
    kind = table.get("kind") if isinstance(table, dict) else None
    if not isinstance(kind, str) or kind not in SPECS:
        found = "no kind" if kind is None else f"unknown kind {kind!r}"
        raise ScenarioError(f"{found}; expected one of {', '.join(SPECS)}", place.of("kind"))
    return convert(table, SPECS[kind], place.path, f"fault.{place.index}")


def _frame_fault(spec: SyncLossSpec, place: _Place) -> FrameFault:
    t0, t1 = place.span(spec.start, spec.end)
    a = b = 0.0
    if isinstance(spec, LateSpec | DuplicateSpec):
        a, b = place.between(spec.by)
    elif isinstance(spec, ReorderSpec):
        b = place.value("within", spec.within)
    messages = spec.message if isinstance(spec, DropSpec) else "SYNC"
    return FrameFault(
        index=place.index,
        kind=spec.kind,
        nodes=_tuple(spec.node),
        messages=messages if isinstance(messages, tuple) else (messages,),
        bus=spec.bus if isinstance(spec, DropSpec) else "",
        t0=t0,
        t1=t1,
        probability=place.value("probability", spec.probability, "1", 0, 1),
        count=spec.count if isinstance(spec, CountSpec) else 1,
        a=a,
        b=b,
    )


def _tuple(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else names


def _events(spec: _Spec, place: _Place) -> list[Event]:
    """What happens to the targets of a table, each on its own."""
    if isinstance(spec, BabbleSpec):
        t0, t1 = place.span(spec.start, spec.end)
        rate = place.value("rate", spec.rate, "1/s", 1e-3, 1e6)
        said = {"id": spec.id, "rate": rate, "length": spec.length}
        return _each(spec.bus, place, ("babble", t0, said), ("hush", t1, {}))
    if isinstance(spec, BusDownSpec):
        t = place.value("at", spec.at)
        end = t + place.value("for", spec.lasts)
        return _each(spec.bus, place, ("bus-down", t, {}), ("bus-up", end, {}))
    assert isinstance(spec, KillSpec)
    t = place.value("at", spec.at)
    if isinstance(spec, ClockJumpSpec):
        by = place.value("by", spec.by, low=-inf)
        return _each(spec.node, place, ("clock-jump", t, {"by": by}))
    if isinstance(spec, RestartSpec):
        end = t + place.value("for", spec.lasts)
        return _each(spec.node, place, ("kill", t, {}), ("start", end, {}))
    if isinstance(spec, FreezeSpec):
        end = t + place.value("for", spec.lasts)
        return _each(spec.node, place, ("freeze", t, {}), ("thaw", end, {}))
    return _each(spec.node, place, ("kill", t, {}))


def _each(names: Names, place: _Place, *done: tuple[Action, float, dict[str, Any]]) -> list[Event]:
    return [
        Event(t, action, target, place.index, **said)
        for target in _tuple(names)
        for action, t, said in done
        if t < inf
    ]
