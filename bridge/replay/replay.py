"""Replay of a recorded run: every node computes its slots from its journals.

Only the received samples, the sequence numbers held and the events of the life cycle are taken from
the recording. Every signal of every node must therefore be equal to the last bit, independently of
its peers; otherwise something was altered. :mod:`bridge.replay.received_and_sent` checks whether
the received samples are those that were sent.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.system import System, make_system
from bridge.native import node as native
from bridge.native.journal import Journal
from bridge.native.safety import LifeState
from bridge.records.node_lives import ByLife, Life, files
from bridge.replay import received_and_sent
from bridge.replay.received_and_sent import AlteredSamples, History
from bridge.wiring.beginning import begin_active, begin_cold
from bridge.wiring.outlets import Forwarding
from bridge.wiring.wiring import HEARD, Rows, WiredNode, heard_dtype
from cosim.base.errors import ScenarioError

#: Rows that are compared at once.
_ROWS = 1 << 13


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
class ReplayReport:
    """The result of a replay: slots by life, the greatest difference, and the first one, if any.

    `altered`: samples that differ from those of their sender; `alone`: messages with samples that
    could not be compared, because their sender was not recorded or has no counter, or because the
    journal of received samples was full: their inputs are taken as recorded.
    """

    slots: Mapping[Life, int]
    greatest: float
    first: Difference | None
    alone: tuple[str, ...] = ()
    altered: tuple[AlteredSamples, ...] = ()


def replay(
    system: System, recorded: Mapping[Life, Rows], heard: Mapping[Life, Rows], folder: Path
) -> ReplayReport:
    """Compute the recorded lives again, into journals in `folder`, and compare every bit.

    Each life receives its recorded samples, from any sender, so no other node is needed. These
    samples are then compared with those that the sender computed, if it was recorded. Gateways
    compute nothing.

    `recorded`: rows (slots,) by life; `heard`: result of :func:`received_by_life`. Raises
    ScenarioError if they do not belong to this system.
    """
    lives = {life: r for life, r in recorded.items() if system.nodes[life.node].plan.components}
    there = {life: rows for life, rows in heard.items() if life in recorded}
    sent = received_and_sent.sent_histories(system, lives)
    unheard: set[str] = set()
    with ExitStack() as stack:
        found: dict[Life, Rows] = {}
        histories = {}  # C reads them until the end
        for life, rows in lives.items():
            node = _wire(stack, _new_components(system, life), life, rows, folder)
            histories[life] = _hear(node, life, there, sent)
            unheard.update(
                received_and_sent.missing_in_journal(system, life, rows, histories[life])
            )
            _run(node, life)
            found[life] = node.journal.rows
        differences = [d for x, rows in lives.items() for d in _compare(system, x, rows, found[x])]
        greatest = max((_greatest(lives[life], found[life]) for life in lives), default=0.0)
        found.clear()
    first = min(differences, key=lambda d: d.t, default=None)
    slots = ByLife({life: len(rows) for life, rows in lives.items()})
    altered, alone = received_and_sent.compare_with_senders(system, lives, there, sent)
    return ReplayReport(slots, greatest, first, tuple(sorted(alone | unheard)), altered)


def load(folder: Path) -> ByLife[Rows]:
    """Return the rows (slots,) of a folder by life. Raises ScenarioError without journals."""
    found = {life: Journal.open(path) for life, path in files(folder, "journal").items()}
    if not found:
        raise ScenarioError("no journals (*.journal) of nodes", str(folder))
    return ByLife({life: rows for life, rows in found.items() if len(rows)})


def received_by_life(folder: Path) -> ByLife[Rows]:
    """Return the received samples (n,) of each life (:func:`bridge.wiring.wiring.heard_dtype`)."""
    return ByLife({life: Journal.open(path) for life, path in files(folder, HEARD).items()})


def _new_components(system: System, life: Life) -> System:
    """Each life of a node has its own components."""
    return system if life.boot == 1 else make_system(system.scenario, system.deployment)


def _wire(stack: ExitStack, system: System, life: Life, rows: Rows, folder: Path) -> WiredNode:
    node = WiredNode(system, life.node, {}, folder / life.file("journal"), native.REPLAY)
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
    if s.slot > 0:
        node.begin(s.slot)
    _begin(node, rows)
    (begin_cold if _was_cold(rows) else begin_active)(node)
    return node


def _was_cold(rows: Rows) -> bool:
    """True if a life waited for commands in its first slot: none of that slot made it INACTIVE."""
    return bool(rows["state"][0] == LifeState.INACTIVE and not rows["commands"][0])


def _hear(
    node: WiredNode, life: Life, heard: Mapping[Life, Rows], sent: Mapping[str, History]
) -> dict[str, History]:
    """Give the recorded samples of each message to its reception; forwarded ones go to `sent`."""
    rows = heard.get(life)
    if rows is None or rows.dtype != heard_dtype(node.system, life.node):
        found = "no samples" if rows is None else "samples of other messages"
        raise ScenarioError(
            f"{found} recorded for {life}; expected its received samples, {life.file(HEARD)}",
            str(node.system.deployment.path),
        )
    histories: dict[str, History] = {}
    for number, (message, reception) in enumerate(node.inlet_bindings.receptions.items()):
        mine, carried = rows[rows["message"] == number], node.system.messages[message]
        history = received_and_sent.received_history(mine, carried, node.system.plan)
        reception.history = c.pointer(history.struct)
        histories[message] = history
    for outlet, entry in zip(node.plan.outlets, node.outlet_bindings.outlets, strict=False):
        if outlet.message in sent:
            _remember(node, outlet.message, entry, sent)
    return histories


def _remember(
    node: WiredNode, message: str, outlet: native.OutletStruct, histories: Mapping[str, History]
) -> None:
    """Keep the samples that an outlet and its gateways send, for their receivers."""
    outlet.history = c.pointer(histories[message].struct)
    forwarded = Forwarding(node.system.forwards_of(message))
    for made in node.system.forwards_of(message):
        assert made.forward is not None
        entry = forwarded.made[made.name]
        entry.of = c.pointer(histories[made.forward.of].struct)
        entry.to = c.pointer(histories[made.name].struct)
    forwarded.bind(outlet)
    node.outlet_bindings.keep(forwarded)


def _check_slots(rows: Rows, place: str) -> None:
    """A slot a row, none left out. Raises ScenarioError."""
    gaps = np.flatnonzero(np.diff(rows["slot"]) != 1)
    if gaps.size:
        before, after = rows["slot"][gaps[0] : gaps[0] + 2]
        text = f"slot {after} comes after slot {before}; rows of its journal are missing"
        raise ScenarioError(text, place)


def _begin(node: WiredNode, rows: Rows) -> None:
    """Inputs from other nodes hold at the start what they held when it was recorded."""
    signals: NDArray[np.float64] = rows["signals"][0]
    for i, inlet in enumerate(node.plan.inlets):
        entry = node.inlet_bindings.inlets[i]
        entry.heard_ns = node.struct.slot * node.struct.h_ns
        if not entry.drive:
            part = slice(inlet.target.start, inlet.target.start + inlet.target.size)
            node.engine.signals[part] = signals[part]


def _run(node: WiredNode, life: Life) -> None:
    result = native.functions().node_replay(c.byref(node.struct))
    if result:
        error = node.engine.failure(result)
        error.add_note(f"in the replay of {life}")
        raise error


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
    n, most = min(len(recorded), len(found)), 0.0
    for field, first in product(("signals", "sent"), range(0, n, _ROWS)):
        rows = slice(first, min(n, first + _ROWS))
        change = np.abs(recorded[field][rows] - found[field][rows])
        most = max(most, float(np.nanmax(change, initial=0.0)))
    return most
