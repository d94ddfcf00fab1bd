"""The memory of the C engine that changes during a run, in pieces that can be saved.

What a plan is in memory follows from the plan; so another process that binds the same plan has the
same pieces at other addresses.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator

from cosim.engine.arrays import rows_of
from cosim.engine.engine import Engine
from cosim.native import structs
from cosim.native.memory import Piece, array, numbers, restore, save, unit_pieces, whole

__all__ = ["Piece", "array", "pieces", "restore", "save", "whole"]


def pieces(engine: Engine) -> Iterator[Piece]:
    """All pieces of an engine that has been initialised, in an order that the plan determines."""
    bound = engine.bound
    yield whole("signals", bound.signals.ctypes.data, bound.signals.nbytes)
    yield numbers("segments", structs.SegmentStruct, bound.segments)
    if len(bound.links):
        yield numbers("links", structs.LinkStruct, rows_of(bound.links))
        senders = rows_of(bound.senders)
        yield numbers("senders", structs.SenderStruct, senders)
        size = int((senders["capacity"] * senders["width"]).sum())
        yield whole("samples", int(senders["history"][0]), 8 * size)
    if len(bound.players):
        yield numbers("players", structs.PlayerStruct, rows_of(bound.players))
    if bound.divided is not None:
        parts = bound.divided.parts
        yield "parts", parts, ("tick",)  # the number of spans depends on addresses
        first, n = int(parts["segments"][0]), int(parts["n_segments"].sum())
        yield array("parts.segments", structs.SegmentStruct, first, n)
    for step, unit in zip(engine.plan.components, bound.units, strict=True):
        yield from unit_pieces(step.name, unit)
    for i, macro in enumerate(engine.macros or ()):
        yield from _macro(f"groups.{i}", macro)


def _macro(name: str, x: structs.MacroStruct) -> Iterator[Piece]:
    """A group with macro steps. What it saves of its components is saved anew in each period."""
    yield array(name, structs.MacroStruct, c.addressof(x), 1)
    size = max(1, 2 * x.n_inputs + 5 * x.n_outputs)
    yield whole(f"{name}.memory", x.memory, 8 * size)
    if x.n_bonds:
        yield array(f"{name}.bonds", structs.BondStruct, x.bonds, x.n_bonds)
    if x.n_loops:
        yield array(f"{name}.loops", structs.LoopStruct, x.loops, x.n_loops)
        for i, loop in enumerate((structs.LoopStruct * x.n_loops).from_address(x.loops)):
            n, fed = loop.n_outputs, loop.n_fed_back
            size = 4 * n + 2 * fed + loop.n_kept * (n + fed + 1)
            yield whole(f"{name}.loops.{i}", loop.memory, 8 * size)
