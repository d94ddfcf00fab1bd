"""A step of continuous components done again in parts, from the state it began in.

For :mod:`cosim.estimate.local_error`. Components of one period are tried together: wires among
them are carried before every part, as a plan with a finer step would; all their other inputs are
held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError, RunError
from cosim.engine.engine import Engine
from cosim.fmi.components import free_state
from cosim.fmi.failures import sentence
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan

Vector = NDArray[np.float64]


@dataclass(slots=True)
class StepGroup:
    """Components of one period (ticks) that are tried together, in the order they step in.

    `values`: a row for each of `ticks`; in it for each component its outputs after the step whole,
    in halves and in quarters.
    """

    period: int
    steps: list[Step] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)
    values: list[tuple[Vector, ...]] = field(default_factory=list)


def step_in_parts(behind: Engine, group: StepGroup, used: Vector, tick: int, parts: int) -> Vector:
    """Return the signals (n_signals,) after the group's step from `tick` in `parts` parts.

    The components are then restored. `used`: signals (n_signals,) after the whole step, with the
    inputs that were held. Raises RunError if a part fails.
    """
    plan, signals = behind.plan, behind.signals.copy()
    for step in group.steps:
        for slot in step.inputs:
            signals[slot_slice(slot)] = used[slot_slice(slot)]
    saved = [_save(step) for step in group.steps]
    length = group.period * plan.h / parts
    try:
        for part in range(parts):
            _part(plan, group, signals, plan.time(tick) + part * length, length, part)
    finally:
        for step, state in zip(group.steps, saved, strict=True):
            step.component.set_state(state)
            free_state(step.component, state)
    return signals


def _part(
    plan: Plan, group: StepGroup, signals: Vector, t: float, length: float, part: int
) -> None:
    """One part of a step, all components; Gauss-Seidel's wires are carried in between."""
    newest = plan.algorithm == "gauss-seidel"
    names = [step.name for step in group.steps]
    if part and not newest:
        for name in names:
            _carry(plan, name, names, signals)
    for i, step in enumerate(group.steps):
        if newest:
            _carry(plan, step.name, names if part else names[:i], signals)
        u = {s.port: signals[slot_slice(s)].reshape(s.shape) for s in step.inputs}
        try:
            y = step.component.step(t, length, u)
            for slot in step.outputs:
                signals[slot_slice(slot)] = np.reshape(y[slot.port], -1)
        except (Exception, SystemExit) as error:
            said = sentence(error, step.name)
            raise RunError(
                f"{step.name}: a part of a step ({length:g} s) at t = {t:.6g} s failed: {said}",
                component=step.name,
                time=t,
            ) from error


def _carry(plan: Plan, name: str, sources: Sequence[str], signals: Vector) -> None:
    for w in plan.wires:
        if w.target.component == name and w.source.component in sources:
            signals[slot_slice(w.target)] = w.gain * signals[slot_slice(w.source)] + w.offset


def _save(step: Step) -> object:
    try:
        return step.component.get_state()
    except CosimError as error:
        raise RunError(f"{step.name}: {sentence(error, step.name)}", component=step.name) from error


def slot_slice(slot: Slot) -> slice:
    """The slice of a slot in the signal vector."""
    return slice(slot.start, slot.start + slot.size)


def outputs(signals: Vector, step: Step) -> Vector:
    """Return all outputs of a component, (scalars,), in the units of its ports."""
    return np.concatenate([np.zeros(0), *(signals[slot_slice(s)] for s in step.outputs)])
