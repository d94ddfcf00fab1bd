"""A bound plan, taken back to tick 0 for a plan that differs from it in numbers only."""

from __future__ import annotations

import ctypes as c
from typing import TYPE_CHECKING

import numpy as np

from cosim.fmi.components import start_is_exact
from cosim.native import structs

if TYPE_CHECKING:
    from cosim.engine.binding import Binding
    from cosim.schedule.plan import Plan

#: Of an operation: what may differ between engines that run together.
_NUMBERS = ("gain", "offset")


def can_rewind(bound: Binding) -> bool:
    """True if :func:`rewind` leaves nothing of the last run: all components are FMUs of our own."""
    if bound.exact is None:
        bound.exact = (
            bound.partition is None
            and not bound.plan.gates
            and not bound.plan.groups
            and all(unit.values for unit in bound.units)
            and all(start_is_exact(step.component) for step in bound.plan.components)
        )
    return bound.exact


def rewind(bound: Binding, plan: Plan) -> None:
    """Restore the state after binding `plan` at tick 0, once its components have started."""
    bound.plan, state = plan, bound.state
    c.memmove(bound.segments.ctypes.data, bound.first_due, len(bound.first_due))
    for link, sender, held in zip(plan.links, bound.senders, bound.links, strict=True):
        sender.sent = held.row = held.rows = 0
        held.held = -1
        first = bound.signals[link.target.start :].ctypes.data
        c.memmove(held.initial, first, c.sizeof(c.c_double) * link.source.size)
    for player in bound.players:
        player.row = player.rows = 0
    state.tick = state.row = state.stop = 0
    state.failed_tick = state.failed_index = state.failed_status = state.failed_signal = 0
    bound.keep_last()


def leave_out_constant_inputs(bound: Binding) -> None:
    """Do not write inputs in each step that nothing feeds: their values are in the FMUs already.

    For a plan that :func:`can_rewind`, whose signals nothing else changes. Such inputs are left out
    where they are the last ones of an FMU.
    """
    fed = np.zeros(bound.plan.n_signals, dtype=bool)
    for op in bound.plan.operations:
        fed[op.target : op.target + max(1, op.count)] = True
    for unit in bound.units:
        used = np.flatnonzero(fed[unit.input : unit.input + unit.input_count])
        unit.n_inputs = int(used[-1]) + 1 if len(used) else 0


def structure(bound: Binding) -> bytes:
    """The structure that engines must share to run together (``batch.c``)."""
    names = [name for name, _ in structs.OperationStruct._fields_ if name not in _NUMBERS]
    units = [(u.kind, u.lag, u.period, u.h, u.steps or 0) for u in bound.units]
    numbers = repr(
        (bound.plan.h, bound.plan.start, bound.plan.ticks, units, tuple(bound.columns))
    ).encode()
    return bound.operations[names].tobytes() + bound.first_due + numbers
