"""Reading of fault scripts: TOML decoded into frozen structs.

An unknown key of a fault is an error; every error names the file and the place in it.
docs/faults.md describes the kinds of faults, :mod:`bridge.faults.script` executes a script.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

from bridge.faults.script import Action, DriveFault, FaultEvent, FaultScript, FrameFault
from bridge.faults.spec import (
    SPECS,
    AbsurdSpec,
    BabbleSpec,
    BusDownSpec,
    ClockJumpSpec,
    CountSpec,
    DriveFaultSpec,
    DropSpec,
    DuplicateSpec,
    FloodSpec,
    ForgeSpec,
    FreezeSpec,
    KillSpec,
    LateSpec,
    Names,
    NetDelaySpec,
    NetDownSpec,
    NetLossSpec,
    NetRateSpec,
    NoiseSpec,
    Range,
    ReorderSpec,
    RestartSpec,
    Spec,
    SyncLossSpec,
)
from bridge.native.vendor import VendorFault
from cosim.base import toml
from cosim.base.convert import Number, convert, number
from cosim.base.errors import ScenarioError

#: s between two draws of a network's delay.
HOLD = 0.03


def load(path: str | Path) -> FaultScript:
    """Read a script. Raises ScenarioError that names the file and the place in it."""
    path = Path(path)
    return build(toml.read(Path(path)), path)


def build(document: Mapping[str, Any], path: Path) -> FaultScript:
    """A script from an already parsed document. Raises ScenarioError."""
    for key in document:
        if key not in ("title", "seed", "fault"):
            raise ScenarioError(f"unknown key {key!r}; expected title, seed or fault", f"{path}")
    tables = document.get("fault", [])
    if not isinstance(tables, list):
        raise ScenarioError("expected an array of tables, [[fault]]", f"{path} at fault")
    frames: list[FrameFault] = []
    events: list[FaultEvent] = []
    drives: list[DriveFault] = []
    for index, table in enumerate(tables):
        place = _Place(path, index)
        spec = _spec(table, place)
        if isinstance(spec, DriveFaultSpec):
            drives += _drive_faults(spec, place)
        elif isinstance(spec, SyncLossSpec):
            frames.append(_frame_fault(spec, place))
        else:
            events += _events(spec, place)
    return FaultScript(
        path=path,
        title=convert(document.get("title", path.stem), str, path, "title"),
        seed=convert(document.get("seed", 0), int, path, "seed"),
        frames=tuple(frames),
        events=tuple(sorted(events, key=lambda e: (e.t, e.index))),
        drives=tuple(sorted(drives, key=lambda e: (e.t, e.index))),
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

    def between(self, by: Range, unit: str = "s", least: float = 0.0) -> tuple[float, float]:
        a, b = by if isinstance(by, tuple) else (by, by)
        low, high = self.value("by", a, unit, least), self.value("by", b, unit, least)
        if high < low:
            raise ScenarioError(
                f"is {low:g} to {high:g} {unit}; expected [least, greatest]", self.of("by")
            )
        return low, high


def _spec(table: Any, place: _Place) -> Spec:
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
    elif isinstance(spec, ForgeSpec | AbsurdSpec):
        a, b = place.between(spec.by, "1", -inf)
    elif isinstance(spec, FloodSpec):
        a = 1 / place.value("rate", spec.rate, "1/s", 1.0, 1e6)
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


def _drive_faults(spec: DriveFaultSpec, place: _Place) -> list[DriveFault]:
    """The fault of each drive of a table, and its end where it has one."""
    t, fault = place.value("at", spec.at), VendorFault[spec.does.upper().replace("-", "_")]
    code = round(place.value("by", spec.by, "s", 0, 2) * 1e9) if spec.does == "late" else spec.code
    code = code - (1 << 32) if code >= 1 << 31 else code
    after = VendorFault.PLUG if fault is VendorFault.UNPLUG else fault
    ends = spec.lasts is not None and spec.does not in ("trip", "reboot")
    if spec.lasts is not None and not ends:
        raise ScenarioError(
            f"{spec.does!r} has no end of its own; expected no for", place.of("for")
        )
    end = t + place.value("for", spec.lasts) if spec.lasts is not None else inf
    found = []
    for bus in _tuple(spec.bus):
        for drive in (spec.drive,) if isinstance(spec.drive, int) else spec.drive:
            found.append(DriveFault(place.index, t, bus, drive, fault, code))
            if ends:
                found.append(DriveFault(place.index, end, bus, drive, after, 0))
    return found


def _tuple(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else names


def _events(spec: Spec, place: _Place) -> list[FaultEvent]:
    """The faults of the targets of a table, each on its own."""
    if isinstance(spec, BabbleSpec):
        t0, t1 = place.span(spec.start, spec.end)
        rate = place.value("rate", spec.rate, "1/s", 1e-3, 1e6)
        said = {"id": spec.id, "rate": rate, "length": spec.length}
        return _event_faults(spec.bus, place, ("babble", t0, said), ("hush", t1, {}))
    if isinstance(spec, BusDownSpec):
        t = place.value("at", spec.at)
        end = t + place.value("for", spec.lasts)
        return _event_faults(spec.bus, place, ("bus-down", t, {}), ("bus-up", end, {}))
    if isinstance(spec, NetDownSpec):
        return _on_network(spec, place)
    assert isinstance(spec, KillSpec)
    t = place.value("at", spec.at)
    if isinstance(spec, ClockJumpSpec):
        by = place.value("by", spec.by, low=-inf)
        return _event_faults(spec.node, place, ("clock-jump", t, {"by": by}))
    if isinstance(spec, RestartSpec):
        end = t + place.value("for", spec.lasts)
        return _event_faults(spec.node, place, ("kill", t, {}), ("start", end, {}))
    if isinstance(spec, FreezeSpec):
        end = t + place.value("for", spec.lasts)
        return _event_faults(spec.node, place, ("freeze", t, {}), ("thaw", end, {}))
    if isinstance(spec, NoiseSpec):
        return _event_faults(spec.node, place, ("noise", t, {"length": spec.count}))
    return _event_faults(spec.node, place, ("kill", t, {}))


def _on_network(spec: NetDownSpec, place: _Place) -> list[FaultEvent]:
    """A link as a table of :class:`bridge.relay.impairment.RelayLinkSpec`, and its end."""
    source, _, target = spec.link.partition(">")
    if spec.link != "*" and not (source and target):
        raise ScenarioError(f'is {spec.link!r}; expected "FROM>TO" or "*"', place.of("link"))
    t = place.value("at", spec.at)
    end = t + place.value("for", spec.lasts)
    action, table = _impaired(spec, place)
    return _event_faults(spec.link, place, (action, t, {"spec": table}), ("net-over", end, {}))


def _impaired(spec: NetDownSpec, place: _Place) -> tuple[Action, dict[str, Any]]:
    if isinstance(spec, NetDelaySpec):
        low, high = place.between(spec.by)
        law = {"law": "uniform", "low": low, "high": high, "hold": HOLD}
        if low == high:
            law = {"law": "constant", "delay": low}
        return "net-delay", {"delay": law, "ordered": spec.ordered}
    if isinstance(spec, NetLossSpec):
        p = place.value("probability", spec.probability, "1", 0, 1)
        r = 1 / place.value("burst", spec.burst, "1", 1)
        if r == 1 or p == 1:
            return "net-loss", {"loss": {"law": "independent", "p": p}}
        bad = min(1.0, r * p / (1 - p))  # so that the share of packets lost is p
        return "net-loss", {"loss": {"law": "gilbert-elliott", "p": bad, "r": r}}
    if isinstance(spec, NetRateSpec):
        return "net-rate", {"rate": place.value("rate", spec.rate, "bit/s", 1e3, 1e12)}
    return "net-down", {"down": True}


def _event_faults(
    names: Names, place: _Place, *done: tuple[Action, float, dict[str, Any]]
) -> list[FaultEvent]:
    return [
        FaultEvent(t, action, target, place.index, **said)
        for target in _tuple(names)
        for action, t, said in done
        if t < inf
    ]
