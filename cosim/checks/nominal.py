"""The nominal run: the scenario from its own start, in memory, and where it ends.

Poles tell of small motions. A start far away, wrong estimates and limits are told by a run only, of
the network that the seed of the scenario draws.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, lcm

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.linear.loop import OperatingPoint
from cosim.predict.facts import Array, DynamicFeedback, SpringDamper
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.parts import Slot
from cosim.schedule.plan import Plan

#: Steps of components at the most; a longer run is not made to its end. Rows, and values at once.
STEPS, ROWS, _VALUES = 3_000_000, 4000, 1 << 19
#: A speed (rad/s) beyond which a robot has run away, and one up to which
#: it is as good as at rest.
RUNAWAY, SLOW = 1e3, 0.02
#: The ratio of the speeds in the last quarter and in the one before, from which a motion grows, in
#: a run of at least so many seconds: before, all robots are faster and faster.
GROWS, LONG = 1.1, 4.9
#: That ratio below which a motion decays, and changes of direction that make it a swing.
DECAYS, SWINGS = 0.95, 8


class NominalRun(Struct, frozen=True):
    """A run up to `time` (s); `failed` is the reason why it stopped early, or "".

    `t` (n,) s; `signals`: of the arms and laws that are known, or of all plants, (n, m) each;
    `rates` (n, m): of all joints, or numbers, and `speed` (n,) the greatest of them, rad/s. `end`:
    the last period, None if it failed; `whole`: True if it reached the end of the scenario.
    """

    time: float
    failed: str
    t: Array
    signals: Mapping[str, Array]
    speed: Array
    rates: Array
    end: OperatingPoint | None
    whole: bool

    @property
    def last_speed(self) -> float:
        """The greatest speed in the last hundredth of the run, rad/s; inf if it failed."""
        return inf if self.failed else float(self.speed[-max(1, len(self.speed) // 100) :].max())

    @property
    def outcome(self) -> str:
        """The last quarter: "grows" if its speeds exceed those before, "swings" if they are the
        same, to and fro; else "". Small ones do not count: poles tell of them.
        """
        n = len(self.speed)
        last, before = self.speed[3 * n // 4 :], self.speed[n // 2 : 3 * n // 4]
        if self.failed or self.t[-1] - self.t[0] < LONG or last.max() < SLOW:
            return ""
        ratio = np.sqrt((last**2).mean() / (before**2).mean())
        rates = self.rates[3 * n // 4 :]
        fastest = rates[:, int(np.argmax(np.abs(rates).max(axis=0)))]
        swings = np.count_nonzero(np.diff(np.sign(fastest))) >= SWINGS
        return "grows" if ratio > GROWS else "swings" if ratio > DECAYS and swings else ""


def nominal_run(system: AnalyzedSystem, plan: Plan) -> NominalRun:
    """Run `plan` from its start; also a failure is a result."""
    period = lcm(*(c.period for c in plan.components))
    steps = sum(plan.ticks / c.period for c in plan.components)
    ticks = plan.ticks if steps <= STEPS else int(plan.ticks * STEPS / steps)
    begin = max(0, (ticks - 1) // period) * period
    watched = _watched(system, plan)
    at = np.concatenate([np.arange(s.start, s.start + s.size) for s in watched.values()])
    every = max(1, begin // ROWS)
    rows = every * max(1, min(_VALUES // len(at), 16384) // every)
    buffer, kept, failed = np.empty((rows, len(at))), [], ""
    end = None
    with Engine(plan, columns=at.tolist(), every=every) as engine:
        engine.initialize()
        while engine.tick < begin and not failed:
            try:
                n = engine.run(min(rows, begin - engine.tick), buffer)
            except RunError as error:
                failed, n = str(error), engine.rows
            kept.append(buffer[:n:every].copy())
            failed = failed or str(engine.ended or "") or _runaway(system, watched, kept[-1])
        time = plan.time(engine.tick)
        if not failed:
            try:
                end = _last_period(engine, period)
            except RunError as error:
                failed = str(error)
    x = np.concatenate([np.zeros((0, len(at))), *kept])
    t = plan.start + plan.h * every * np.arange(len(x), dtype=np.float64)
    found, first = {}, 0
    for name, slot in watched.items():
        found[name] = x[:, first : first + slot.size]
        first += slot.size
    rates = _moved(system, t, found)
    speed = np.abs(rates).max(axis=1, initial=0.0)
    return NominalRun(time, failed, t, found, speed, rates, end, ticks == plan.ticks)


def _last_period(engine: Engine, period: int) -> OperatingPoint:
    begin, signals = engine.tick, []
    for _ in range(period):
        signals.append(engine.signals.copy())
        engine.run(1)
    signals.append(engine.signals.copy())
    return OperatingPoint(begin, period, np.array(signals), {})


def _watched(system: AnalyzedSystem, plan: Plan) -> dict[str, Slot]:
    """Positions and velocities of known arms, torques and estimates; else outputs of plants."""
    slots, names = plan.slots(), list[str]()
    for name, arm in system.arms.items():
        names += [f"{name}.{arm.position}", f"{name}.{arm.rate}"]
    for name, law in system.facts.items():
        if isinstance(law, DynamicFeedback | SpringDamper):
            names.append(f"{name}.{law.torque}")
        if isinstance(law, DynamicFeedback) and law.estimate:
            names.append(f"{name}.{law.estimate}")
    found = {name: slots[name] for name in names if name in slots}
    if system.arms and found:
        return found
    plants = [c for c in plan.components if c.kind == "continuous"] or plan.components
    return {s.name: s for c in plants for s in c.outputs} or {
        s.name: s for c in plan.components for s in (*c.outputs, *c.inputs)
    }


def _rates(system: AnalyzedSystem) -> list[str]:
    return [f"{name}.{arm.rate}" for name, arm in system.arms.items()]


def _runaway(system: AnalyzedSystem, watched: Mapping[str, Slot], rows: Array) -> str:
    first = 0
    for name, slot in watched.items():
        part = rows[:, first : first + slot.size]
        first += slot.size
        if name in _rates(system) and len(part) and np.abs(part).max() > RUNAWAY:
            return f"{name} exceeds {RUNAWAY:g} rad/s"
    return ""


def _moved(system: AnalyzedSystem, t: Array, signals: Mapping[str, Array]) -> Array:
    rates = [signals[name] for name in _rates(system) if name in signals]
    if rates:
        return np.hstack(rates)
    every = np.hstack(list(signals.values()))
    if len(t) < 2:
        return np.zeros_like(every)
    moved = np.diff(every, axis=0) / np.diff(t)[:, None]
    return np.vstack([moved, moved[-1:]])
