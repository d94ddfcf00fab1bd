"""A recorded run again, offline: every node computes its slots, from what its journal says it held.

Nothing but the sequence numbers held and the events of the life cycle is taken from the recording
(and, for messages whose sender was not recorded, their values): so every signal of every node comes
out the same to the last bit, or something was altered.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.journal import Journal
from bridge.lives import ByLife, Life, files
from bridge.native import node as native
from bridge.native.safety import State
from bridge.sending import Forwarding
from bridge.system import System, make_system
from bridge.wiring import Rows, Wired
from cosim.errors import RunError, ScenarioError


@dataclass(frozen=True, slots=True)
class Difference:
    """The first place where a replay is not its recording: `found` here, `recorded` there."""

    life: Life
    slot: int
    t: float
    signal: str
    recorded: float
    found: float

    def __str__(self) -> str:
        return (
            f"{self.life}, slot {self.slot} (t = {self.t:.6g} s): {self.signal} = "
            f"{self.found!r}, recorded {self.recorded!r}"
        )


@dataclass(frozen=True, slots=True)
class Replay:
    """What a replay found: slots by life, the greatest difference, and the first one if any."""

    slots: Mapping[Life, int]
    greatest: float
    first: Difference | None
    alone: tuple[str, ...]  # messages some of whose samples nobody's journal tells: as recorded


def replay(system: System, recorded: Mapping[Life, Rows], folder: Path) -> Replay:
    """Compute the recorded lives again, into journals in `folder`, and compare every bit.

    Gateways compute nothing: what they forwarded is what its first sender computes.

    `recorded`: rows by life. Raises ScenarioError where rows are not those of this system, RunError
    where the replay cannot go on.
    """
    lives = {life: r for life, r in recorded.items() if system.nodes[life.node].plan.components}
    histories = _histories(system, lives)
    with ExitStack() as stack:
        wired = {
            life: _wire(stack, _fresh(system, life), life, rows, histories, folder)
            for life, rows in lives.items()
        }
        _run(wired)
        found = {life: w.journal.rows for life, w in wired.items()}
        differences = [
            d for life in lives for d in _compare(system, life, lives[life], found[life])
        ]
        greatest = max((_greatest(lives[life], found[life]) for life in lives), default=0.0)
        found.clear()
    first = min(differences, key=lambda d: d.t, default=None)
    alone = {m for life, rows in lives.items() for m in _unknown(system, life, rows, histories)}
    return Replay(
        ByLife({life: len(rows) for life, rows in lives.items()}),
        greatest,
        first,
        tuple(sorted(alone)),
    )


def load(folder: Path) -> ByLife[Rows]:
    """The journals of a run folder by life. Raises ScenarioError where there are none."""
    found = {life: Journal.open(path) for life, path in files(folder, "journal").items()}
    if not found:
        raise ScenarioError("no journals (*.journal) of nodes", str(folder))
    return ByLife({life: rows for life, rows in found.items() if len(rows)})


# ---- histories: what was sent, by sequence number -------------------------------------------


class History:
    """Memory for all samples of one message."""

    def __init__(self, width: int, capacity: int) -> None:
        self.values = np.zeros((capacity, width))
        self.there = np.full(capacity, native.UNKNOWN, np.uint8)
        self.struct = native.History(
            first=0,
            capacity=capacity,
            width=width,
            values=self.values.ctypes.data,
            there=self.there.ctypes.data,
        )

    def knows(self, held: NDArray[np.int64]) -> bool:
        """Whether all these samples were computed."""
        return bool(held.max() < self.there.size and (self.there[held] == native.THERE).all())


def _histories(system: System, lives: Mapping[Life, Rows]) -> dict[str, History]:
    """By message of the nodes recorded; awaited is what was sent in the slots of a life."""
    found: dict[str, History] = {}
    for life, rows in lives.items():
        node = system.nodes[life.node]
        ticks = rows["slot"] * node.ticks
        for outlet in node.outlets:
            if not system.messages[outlet.message].encoding.message.e2e:
                continue  # no counter: which sample was held is known by its time only, so nearly
            sent = ticks[ticks % outlet.ticks == 0] // outlet.ticks
            capacity = system.plan.ticks // outlet.ticks + 8
            for made in (outlet, *(m.outlet for m in system.forwards_of(outlet.message))):
                history = found.setdefault(made.message, History(made.width, capacity))
                history.there[sent] = native.AWAITED
    return found


def _unknown(
    system: System, life: Life, rows: Rows, histories: Mapping[str, History]
) -> Iterator[str]:
    """Messages of which this life held samples that nobody's journal tells."""
    for i, inlet in enumerate(system.nodes[life.node].inlets):
        held = rows["inlets"]["held"][:, i]
        held = held[held >= 0]
        history = histories.get(inlet.message)
        if held.size and (history is None or not history.knows(held)):
            yield inlet.message


def _fresh(system: System, life: Life) -> System:
    """Each life of a node has its own components."""
    return system if life.boot == 1 else make_system(system.scenario, system.deployment)


def _wire(
    stack: ExitStack,
    system: System,
    life: Life,
    rows: Rows,
    histories: Mapping[str, History],
    folder: Path,
) -> Wired:
    node = Wired(system, life.node, {}, folder / life.file("journal"), native.REPLAY)
    if rows.dtype != node.journal.rows.dtype:
        node.journal.close()
        raise ScenarioError(
            f"{life} was recorded with other signals than this scenario and deployment have",
            str(system.deployment.path),
        )
    stack.enter_context(node)
    _check_slots(rows, f"{system.deployment.path}: {life}")
    s = node.struct
    s.replayed, s.replayed_rows = rows.ctypes.data, len(rows)
    s.slot = s.first = int(rows["slot"][0])
    s.life.state, s.life.armed = State.ACTIVE, 1
    for message, reception in node.receiving.receptions.items():
        if message in histories:
            reception.history = c.pointer(histories[message].struct)
    for outlet, entry in zip(node.plan.outlets, node.sending.outlets, strict=False):
        if outlet.message in histories:
            _remember(node, outlet.message, entry, histories)
    _begin(node, rows)
    native.functions().node_enable(c.byref(s), s.slot * s.h_ns)
    return node


def _remember(
    node: Wired, message: str, outlet: native.Outlet, histories: Mapping[str, History]
) -> None:
    """What an outlet sends, and what gateways make of it, is kept for its receivers."""
    outlet.history = c.pointer(histories[message].struct)
    forwarded = Forwarding(node.system.forwards_of(message))
    for made in node.system.forwards_of(message):
        assert made.forward is not None
        entry = forwarded.made[made.name]
        entry.of = c.pointer(histories[made.forward.of].struct)
        entry.to = c.pointer(histories[made.name].struct)
    forwarded.bind(outlet)
    node.sending.keep(forwarded)


def _check_slots(rows: Rows, place: str) -> None:
    """A slot a row, none left out. Raises ScenarioError."""
    gaps = np.flatnonzero(np.diff(rows["slot"]) != 1)
    if gaps.size:
        before, after = rows["slot"][gaps[0] : gaps[0] + 2]
        text = f"slot {after} comes after slot {before}; rows of its journal are missing"
        raise ScenarioError(text, place)


def _begin(node: Wired, rows: Rows) -> None:
    """Inputs from other nodes hold at the start what they held when it was recorded."""
    signals: NDArray[np.float64] = rows["signals"][0]
    for i, inlet in enumerate(node.plan.inlets):
        entry = node.receiving.inlets[i]
        entry.heard_ns = node.struct.slot * node.struct.h_ns
        if not entry.drive:
            part = slice(inlet.target.start, inlet.target.start + inlet.target.size)
            node.engine.signals[part] = signals[part]


def _run(wired: Mapping[Life, Wired]) -> None:
    nodes = list(wired.values())
    pointers = (c.c_void_p * len(nodes))(*(c.addressof(w.struct) for w in nodes))
    stuck = c.c_int32(-1)
    result = native.functions().nodes_replay(pointers, len(nodes), c.byref(stuck))
    if not result:
        return
    life, node = list(wired.items())[stuck.value]
    if result > 0:
        error = node.engine.failure(result)
        error.add_note(f"in the replay of {life}")
        raise error
    raise RunError(
        f"replay: {life} waits at slot {node.struct.slot} for a sample that nobody sent; "
        "a journal is missing or was altered"
    )


# ---- comparison -----------------------------------------------------------------------------


def _columns(system: System, node: str) -> list[tuple[str, str, int]]:
    """(name, field, index) of everything that is compared."""
    plan = system.nodes[node]
    signals = [
        (name, "signals", s.start + i)
        for step in plan.plan.components
        for s in (*step.inputs, *step.outputs)
        for i, name in enumerate(s.scalars())
    ]
    sent = [name for o in plan.outlets for p in o.parts for name in p.scalars()]
    return [*signals, *((f"sent {name}", "sent", i) for i, name in enumerate(sent))]


def _compare(system: System, life: Life, recorded: Rows, found: Rows) -> list[Difference]:
    """The first difference of a life, if there is one."""
    n = min(len(recorded), len(found))
    first: tuple[int, Difference] | None = None
    h = system.nodes[life.node].h
    for name, field, i in _columns(system, life.node):
        a, b = recorded[field][:n, i], found[field][:n, i]
        other = np.flatnonzero(_bits(a) != _bits(b))
        if other.size and (first is None or other[0] < first[0]):
            k = int(other[0])
            slot = int(recorded["slot"][k])
            d = Difference(life, slot, slot * h, name, float(a[k]), float(b[k]))
            first = (k, d)
    return [] if first is None else [first[1]]


def _bits(values: NDArray[Any]) -> NDArray[np.int64]:
    found: NDArray[np.int64] = np.ascontiguousarray(values).view(np.int64)
    return found


def _greatest(recorded: Rows, found: Rows) -> float:
    n = min(len(recorded), len(found))
    parts: Sequence[float] = [
        float(np.nanmax(np.abs(recorded[f][:n] - found[f][:n]), initial=0.0))
        for f in ("signals", "sent")
    ]
    return max(parts)
