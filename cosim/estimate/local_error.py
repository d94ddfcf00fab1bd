"""Estimate of the local error of a step, by repetition with smaller steps, and the step it advises.

At some t_k every continuous component is reset to its state there and repeats its step of length H
in two halves and in four quarters. Wires between components of one period transfer values before
every part; all other inputs (of sampled components, links, weights, other periods) are held. The
result is the error of a component's own solver and of holding its neighbors' outputs over a step,
without that of sampling, which is part of the system. With a local error C H^(p+1) (Richardson;
Hairer, Norsett, Wanner, Solving ODEs I, II.4)::

    d1 = y_H - y_H/2        d2 = y_H/2 - y_H/4        p = log2(rms d1 / rms d2)
    error of the step = d1 / (1 - 2^-p)
    advised H = H min(10, 0.9 (tolerance / relative error)^(1 / (p+1)))

An FMU must not be reset to a time before one for which the importer has set
noSetFMUStatePriorToCurrentPoint (FMI 2.0.5 section 4.2.2), and the engine sets it. Therefore two
additional runs are made: one ahead, which provides the inputs, and one that follows, stops, repeats
steps and continues. The second run must equal the first bit for bit; a component that differs has
more state than it saved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import floor, isfinite, lcm, log2, log10, nan

import numpy as np

from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.estimate.halving import StepGroup, Vector, outputs, slot_slice, step_in_parts
from cosim.fmi.components import reason_not_repeatable
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan

#: Differences below this many rounding errors of the largest value say nothing.
ROUNDING = 64 * float(np.finfo(np.float64).eps)
#: An error seen at one step says nothing of one this many times as long.
FARTHEST = 10.0
#: Parts of a step in the two repetitions.
PARTS = (2, 4)


@dataclass(frozen=True, slots=True)
class SignalError:
    """Local error of one scalar output over its component's steps, in its unit.

    `largest` was found at `time` (s), `scale` is the largest value itself; `order` is p, nan where
    the differences are rounding errors.
    """

    name: str
    unit: str
    largest: float
    rms: float
    time: float
    scale: float
    order: float

    @property
    def relative(self) -> float:
        """Largest error over largest value; 0 for a signal that stays 0."""
        return self.largest / self.scale if self.scale else 0.0


@dataclass(frozen=True, slots=True)
class ComponentError:
    """`worst`: the output of the greatest relative error; `step`, `advised`: s, inf: any."""

    name: str
    step: float
    worst: SignalError
    signals: tuple[SignalError, ...]
    advised: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimate from `samples` points; `left_out`: components by name, and why.

    `advised`: base step (s) that keeps every component's relative local error below `tolerance`,
    rounded down to 1, 2 or 5 times a power of ten; inf where no error was seen.
    """

    h: float
    tolerance: float
    samples: int
    components: tuple[ComponentError, ...]
    left_out: Mapping[str, str]
    advised: float


def estimate(make: Callable[[], Plan], samples: int = 40, tolerance: float = 1e-4) -> Estimate:
    """Estimate local errors at up to `samples` points spread over a run of ``make()``.

    `make` gives the same plan anew at every call; `tolerance` is relative to the largest value of a
    signal. Raises RunError unless both numbers are positive, and CosimError as a run does.
    """
    if samples < 1 or not tolerance > 0.0:
        raise RunError(f"{samples} samples and tolerance {tolerance}: expected positive numbers")
    with ExitStack() as stack:
        ahead, behind = (stack.enter_context(Engine(make())) for _ in range(2))
        ahead.initialize()
        behind.initialize()
        left_out = _not_repeatable(behind.plan)
        groups = _groups(behind.plan, left_out)
        done = 0
        for tick in _points(ahead.plan, groups, samples):
            if not (_advance_to(ahead, tick) and _advance_to(behind, tick)):
                break
            changed = _first_changed(behind.plan, ahead.signals, behind.signals)
            if changed:
                left_out[changed] = "does not continue as before from a state that it saved"
                groups = [_group_without(g, changed) for g in groups]
                break
            if not _try(ahead, behind, groups, tick):
                break
            done += 1
        found = [c for g in groups for c in _results(g, behind.plan.h, tolerance)]
    h = behind.plan.h
    steps = [c.advised / c.step * h for c in found]
    advised = _rounded(min(steps, default=float("inf")))
    components = tuple(sorted(found, key=lambda c: c.name))
    return Estimate(h, tolerance, done, components, left_out, advised)


# ---- who, and when ----------------------------------------------------------------------------


def _not_repeatable(plan: Plan) -> dict[str, str]:
    """Continuous components that cannot do a step again, and why."""
    continuous = (s for s in plan.components if s.kind == "continuous")
    reasons = ((s.name, _reason(s)) for s in continuous)
    coupled = {plan.components[i].name for group in plan.groups for i in group.components}
    own = "is stepped with an estimate of its own (macro steps)"
    reasons = ((name, own if name in coupled else reason) for name, reason in reasons)
    return {name: reason for name, reason in reasons if reason}


def _reason(step: Step) -> str:
    if step.extrapolate:
        return "its inputs are extrapolated over a step: in halves it would be given others"
    return reason_not_repeatable(step.component)


def _groups(plan: Plan, left_out: Mapping[str, str]) -> list[StepGroup]:
    groups: dict[int, StepGroup] = {}
    for name in plan.later:
        step = plan.component(name)
        if step.kind == "continuous" and name not in left_out:
            groups.setdefault(step.period, StepGroup(step.period)).steps.append(step)
    return [groups[period] for period in sorted(groups)]


def _group_without(group: StepGroup, name: str) -> StepGroup:
    """The group with nothing found for one component."""
    kept = [i for i, s in enumerate(group.steps) if s.name != name]
    values = [tuple(v for i, v in enumerate(row) if i // 3 in kept) for row in group.values]
    return StepGroup(group.period, [group.steps[i] for i in kept], group.ticks, values)


def _points(plan: Plan, groups: Sequence[StepGroup], samples: int) -> Iterator[int]:
    """Ticks at which every group begins a step, spread evenly."""
    if not groups:
        return
    common = lcm(*(g.period for g in groups))
    n = plan.ticks // common
    yield from (common * i for i in sorted({i * n // samples for i in range(samples)}) if i < n)


def _advance_to(engine: Engine, tick: int) -> bool:
    """True if it gets there: an FMU may end the simulation before."""
    if tick > engine.tick:
        engine.run(tick - engine.tick)
    return engine.ended is None


def _first_changed(plan: Plan, expected: Vector, found: Vector) -> str:
    """The first component whose outputs differ from those without a reset, or ""."""
    for step in plan.components:
        for slot in step.outputs:
            if expected[slot_slice(slot)].tobytes() != found[slot_slice(slot)].tobytes():
                return step.name
    return ""


def _try(ahead: Engine, behind: Engine, groups: Sequence[StepGroup], tick: int) -> bool:
    """All groups at one point; `ahead` is some ticks further afterwards, `behind` as it was.

    Returns whether `ahead` got there.
    """
    for group in groups:
        if not _advance_to(ahead, tick + group.period):
            return False
        after = ahead.signals
        tried = [step_in_parts(behind, group, after, tick, parts) for parts in PARTS]
        group.ticks.append(tick)
        group.values.append(
            tuple(outputs(signals, step) for step in group.steps for signals in (after, *tried))
        )
    return True


# ---- what it comes to -------------------------------------------------------------------------


def _results(group: StepGroup, h: float, tolerance: float) -> list[ComponentError]:
    found = []
    times = h * np.array(group.ticks)
    step = group.period * h
    for i, c in enumerate(group.steps):
        names = [(name, s.unit) for s in c.outputs for name in s.scalars()]
        if not names or not group.values:
            continue
        rows = [np.array([row[3 * i + j] for row in group.values]) for j in range(3)]
        signals = tuple(
            _signal(name, unit, times, *(r[:, column] for r in rows))
            for column, (name, unit) in enumerate(names)
        )
        worst = max(signals, key=lambda s: s.relative)
        advised = min(_advised_step(s, step, tolerance) for s in signals)
        found.append(ComponentError(c.name, step, worst, signals, advised))
    return found


def _signal(
    name: str, unit: str, times: Vector, whole: Vector, halves: Vector, quarters: Vector
) -> SignalError:
    scale = float(np.abs(whole).max())
    d1, d2 = np.abs(whole - halves), np.abs(halves - quarters)
    rms1, rms2 = (float(np.sqrt(np.mean(d * d))) for d in (d1, d2))
    order = log2(rms1 / rms2) if min(rms1, rms2) > ROUNDING * scale else nan
    error = d1 / (1.0 - 2.0**-order) if isfinite(order) and order > 0.0 else d1
    at = int(error.argmax())
    rms = float(np.sqrt(np.mean(error * error)))
    return SignalError(name, unit, float(error[at]), rms, float(times[at]), scale, order)


def _advised_step(signal: SignalError, step: float, tolerance: float) -> float:
    """The step for a tolerance; where the order is not known, it is taken to be 1."""
    if signal.relative <= ROUNDING:
        return float("inf")
    order = signal.order if isfinite(signal.order) and signal.order > 0.0 else 1.0
    factor = float(0.9 * (tolerance / signal.relative) ** (1.0 / (order + 1.0)))
    return step * min(factor, FARTHEST)


def _rounded(step: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that is not above `step`."""
    if not isfinite(step):
        return step
    power = 10.0 ** floor(log10(step))
    return max(m * power for m in (1.0, 2.0, 5.0) if m == 1.0 or m * power <= step)
