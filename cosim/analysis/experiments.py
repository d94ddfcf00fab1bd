"""Experiments at the port: the scenario's own components at rest, with an additional test force.

All arms start at one position, at rest, without operators. If the law has an estimate, it adapts as
in the scenario, or stays at the true value (M_hat = M). Links do not change. Models without facts
start as in the scenario; their motion without a test force is subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import exp, inf, log, sqrt

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.engine.memory_run import Change, SignalTrace, changed, trace
from cosim.predict.facts import Arm, Array, DynamicFeedback, Vector
from cosim.predict.frequency import MultiSine, PortGain
from cosim.predict.inputs import is_driven
from cosim.predict.network import RobotNetwork, network
from cosim.predict.port import PortSignals
from cosim.predict.system import AnalyzedSystem

#: Frequencies of the port, rad/s.
LOWEST, HIGHEST = 0.03, 60.0
#: Amplitude of test forces, N.m (N): so small that what is measured is the linear behaviour.
FORCE = 1e-6
#: Time for what the start sets off to die away; what rests exactly for so long stays there, s.
SETTLE, STILL = 40.0, 5.0
#: Uncertainty of one period, as a share of |G|, from which on several are averaged; how many of
#: slow and of fast forces.
DISTURBED, SLOW_PERIODS, FAST_PERIODS = 0.05, 4, 6
#: How far a grip or a wall is away from where the arm is, rad.
APART = 0.3
#: Beyond this an arm has run away, rad.
FAR = 100.0
#: h ω of the fastest oscillation that the integrator inside an arm still follows well.
RESOLVED = 0.5


@dataclass(frozen=True, slots=True)
class Bench:
    """The port of a system, put on the bench at position `q` (m,).

    `known`: M_hat = M in every controller, and not adapted; `held`: further values by component,
    such as an environment at the far arm.
    """

    system: AnalyzedSystem
    port: PortSignals
    q: Vector
    known: bool = False
    held: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)

    @property
    def arm(self) -> Arm | None:
        """Facts of the arm at the port, if it has any."""
        return self.system.arms.get(self.port.arm)

    @property
    def network(self) -> RobotNetwork | None:
        """The robots under dynamic feedback around the arm, if it is a position that responds."""
        if not self.system.is_position(self.port.response):
            return None
        return network(self.system, self.port.arm)

    @property
    def size(self) -> int:
        """Entries of the force."""
        return self.system.plan.slots()[self.port.inject].size

    @property
    def units(self) -> dict[str, str]:
        """Units of felt inertia, damping and stiffness: of a joint, or of what moves along a line.

        From the units of the test force and of the response.
        """
        slots = self.system.plan.slots()
        force, length = slots[self.port.inject].unit, slots[self.port.response].unit
        inertia = "kg" if (force, length) == ("N", "m") else "kg.m2"
        return {
            "inertia": inertia,
            "damping": f"{force}.s/{length}",
            "stiffness": f"{force}/{length}",
        }

    @property
    def every(self) -> int:
        """Ticks of a step of the component at the port."""
        return self.system.plan.component(self.port.inject.split(".")[0]).period

    @property
    def h(self) -> float:
        """Its step, s."""
        return self.every * self.system.plan.h

    def at_rest(self, seconds: float) -> Change:
        """All arms at `q`, at rest and without operators, including operator components."""
        change = Change(seconds, forces=self._silenced())
        for name, arm in self.system.arms.items():
            m = len(arm.q)
            q = self.q if len(self.q) == m else arm.q
            k_p, k_d, _ = arm.grip.names
            k_w, b_w, _ = arm.wall.names
            still = {arm.position: q, arm.rate: (0.0,) * m}
            free = {k_p: (0.0,), k_d: (0.0,), k_w: (0.0,), b_w: (0.0,)}
            change = change.merged(**{name: {**still, **free}})
        for name, law in self.system.with_facts(DynamicFeedback).items():
            given: dict[str, Sequence[float]] = {"z": (0.0,)}
            if self.known and law.estimate:
                given |= {law.estimate: self._true(name, law)}
                given |= dict.fromkeys(law.adaptation, (0.0,))
            change = change.merged(**{name: given})
        return change.merged(**self.held)

    def _silenced(self) -> dict[str, Array]:
        """No torque on every arm's external input that anything feeds, by its name."""
        plan = self.system.plan
        slots = plan.slots()
        names = [f"{name}.{arm.external}" for name, arm in self.system.arms.items()]
        return {name: np.zeros((1, slots[name].size)) for name in names if is_driven(plan, name)}

    def _true(self, name: str, law: DynamicFeedback) -> Vector:
        """The true parameters, which the estimate of a law should reach."""
        arm = self.system.arms.get(self.system.arm_of(name) or "")
        if arm is None:
            raise ScenarioError(f"{name} controls no arm whose inertia is known")
        true = (*arm.parameters, *arm.gravity)[: len(law.theta_hat)]
        if len(true) < len(law.theta_hat):
            raise ScenarioError(
                f"{name} estimates {len(law.theta_hat)} parameters, its arm has {len(true)} others"
            )
        return true

    def run(self, change: Change, signals: Sequence[str]) -> SignalTrace:
        """The result of a change. Raises RunError if the run must stop."""
        found = trace(changed(self.system.plan, change), signals, self.every)
        if found.stopped:
            raise RunError(found.stopped)
        return found

    def push(self, seconds: float, force: float = FORCE) -> SignalTrace:
        """The motion that a constant push on every joint for so many seconds adds, from rest.

        `force` is in N.m (N for a port in space). Force and response are recorded. Raises
        ScenarioError if the port has no input for a test force, RunError if the run stops.
        """
        if not self.port.inject:
            raise ScenarioError("no input for a test force; name it in [analysis] as inject")
        names = (self.port.inject, self.port.response, *self.port.members)
        run = self.run(self._fed(seconds, np.full((1, self.size), force)), names)
        still = np.zeros((1, self.size))
        if self.run(self._fed(min(seconds, STILL), still), names[1:]).constant:
            return run
        return run.less(self.run(self._fed(seconds, still), names[1:]))

    def gain(self, sines: MultiSine, periods: int = 1) -> PortGain:
        """G(jω): one run with the force on each joint, one without. Raises RunError, ScenarioError.

        The mean of the last `periods` is transformed: what jumps and switches averages out. Before
        the first of them there is time for what the start set off to die away.
        Steps of the response are transformed, not the response: what is left of a slow decay, or of
        a drift, hardly leaks into other frequencies then.
        """
        if not self.port.inject:
            raise ScenarioError("no input for a test force; name it in [analysis] as inject")
        settle = max(-(-sines.n // 4), round(SETTLE / sines.h))
        seconds = (settle + periods * sines.n) * sines.h
        wave, response = sines.values(), (self.port.response,)
        f = sines.transform(np.roll(wave, -settle)[:, None])
        step = np.exp(1j * sines.omega * sines.h)[:, None] - 1
        before = self.run(self._fed(seconds, np.zeros((1, self.size))), response)
        columns, deviations, astray = [], [], 0.0
        for j in range(self.size):
            force = np.zeros((sines.n, self.size))
            force[:, j] = wave
            after = self.run(self._fed(seconds, force), response)
            moved = np.diff(after.array(response[0]) - before.array(response[0]), axis=0)
            each = moved[-periods * sines.n :].reshape(periods, sines.n, -1)
            mean = each.mean(axis=0)
            columns.append(sines.transform(mean) / step / f)
            deviations.append(sines.deviation(each) / np.abs(step * f))
            astray = max(astray, sines.off_frequency_share(mean))
        sd = np.stack(deviations, axis=2)
        return PortGain(sines.omega, np.stack(columns, axis=2), sines.h, astray, sd)

    def bands(self, lowest: float, highest: float) -> PortGain:
        """G(jω) from `lowest` to `highest`, rad/s, with separate runs for slow and for fast forces.

        A link with a jumping delay turns fast signals into noise, which would disturb the slow
        ones.
        """
        below, beyond = self._waves(lowest, highest)
        slow = self.averaged(below, SLOW_PERIODS)
        if beyond is None:
            return slow
        fast = self.averaged(beyond, FAST_PERIODS)
        above = fast.omega > slow.omega[-1] * (1 + 1e-9)
        omega = np.concatenate([slow.omega, fast.omega[above]])
        G = np.concatenate([slow.G, fast.G[above]])
        assert slow.sd is not None and fast.sd is not None
        sd = np.concatenate([slow.sd, fast.sd[above]])
        share = max(slow.off_frequency_share, fast.off_frequency_share)
        return PortGain(omega, G, self.h, share, sd)

    def frequencies(self, lowest: float, highest: float = HIGHEST) -> Array:
        """The frequencies of :meth:`bands`, (k,), rad/s."""
        below, beyond = self._waves(lowest, highest)
        slow, fast = below.omega, beyond.omega if beyond is not None else np.empty(0)
        return np.concatenate([slow, fast[fast > slow[-1] * (1 + 1e-9)]])

    def _waves(self, lowest: float, highest: float) -> tuple[MultiSine, MultiSine | None]:
        """The slow and the fast forces of :meth:`bands`."""
        middle = min(max(1.0, 8 * lowest), highest)
        slow = MultiSine.spread(lowest, middle, self.h, 9, FORCE)
        if middle >= highest:
            return slow, None
        return slow, MultiSine.spread(middle / 8, highest, self.h, 24, FORCE)

    def averaged(self, sines: MultiSine, periods: int) -> PortGain:
        """G(jω) of one period, or the mean of `periods` where that one is disturbed."""
        once = self.gain(sines)
        return self.gain(sines, periods) if once.error.max() > DISTURBED else once

    def _fed(self, seconds: float, force: Array) -> Change:
        change = self.at_rest(seconds)
        return replace(change, forces={**change.forces, self.port.inject: force})

    # ---- grips and walls -------------------------------------------------------------------------

    def grip(self, k_p: float, k_d: float, apart: float, seconds: float) -> Change:
        """The arm at the port gripped by a hand that is `apart` (rad) from where it is."""
        arm = self._arm()
        place = tuple(x + apart for x in self.q)
        names = dict(zip(arm.grip.names, ((k_p,), (k_d,), place), strict=True))
        return self.at_rest(seconds).merged(**{self.port.arm: names})

    def wall(self, k_w: float, seconds: float) -> Change:
        """The far arm in front of a wall, and the arm at the port pulled towards it by its grip.

        The grip is the scenario's hand, or 10 N.m/rad and 5 N.m.s/rad if the scenario has none.
        `k_w` is the stiffness of the wall, N.m/rad. Raises ScenarioError if there is no far arm.
        """
        arm, far = self._arm(), self.system.arms.get(self.port.far)
        if far is None:
            raise ScenarioError("there is no far arm whose wall could be set")
        own = self.system.hand(self.port.arm)
        k_p, k_d = (own.stiffness, own.damping) if own is not None else ((10.0,), (5.0,))
        hand = tuple(x + 4 * APART for x in self.q)
        grip = dict(zip(arm.grip.names, (k_p, k_d, hand), strict=True))
        wall = dict(zip(far.wall.names, ((k_w,), far.wall.damping, self._away()), strict=True))
        return self.at_rest(seconds).merged(**{self.port.arm: grip, self.port.far: wall})

    def _away(self) -> Vector:
        return tuple(x + APART for x in self.q)

    def _arm(self) -> Arm:
        if self.arm is None:
            raise ScenarioError(f"{self.port.arm} has no grip or wall that is known")
        return self.arm

    def decays(self, change: Change, rates: Sequence[str]) -> bool:
        """True if motion dies away: velocities swing less in the last quarter than before it."""
        swings = self._swings(change, rates)
        return swings is not None and (swings[3] < 0.98 * swings[2] or swings[3] < 1e-9)

    def does_not_grow(self, change: Change, rates: Sequence[str]) -> bool:
        """True if motion does not grow: no more swing in the last quarter than in the second.

        Up to a fifth: what hardly decays may beat.
        """
        swings = self._swings(change, rates)
        return swings is not None and swings[3] < 1.2 * swings[1] + 1e-9

    def _swings(self, change: Change, rates: Sequence[str]) -> list[float] | None:
        """Root mean square of velocities in each quarter of a run; None where it had to stop."""
        found = trace(changed(self.system.plan, change), rates, self.every)
        if found.stopped:
            return None
        x = np.hstack([found.array(name) for name in rates])
        quarter = len(x) // 4
        return [sqrt(float((x[i * quarter : (i + 1) * quarter] ** 2).mean())) for i in range(4)]

    def greatest_stiffness(self, name: str) -> float:
        """The stiffest spring that the integrator of an arm follows, N.m/rad."""
        arm = self.system.arms[name]
        h = self.system.period(name) * arm.h_max
        return arm.inertia_range[0] * (RESOLVED / h) ** 2


def stiffest(accepted: Callable[[float], bool], most: float, least: float = 1.0) -> float:
    """The greatest stiffness that passes, to 5 %, by factors of three from `least`, then bisection.

    The search goes upwards, because a greater stiffness may pass again after one that fails.
    Returns inf if all stiffnesses up to `most` pass, and 0 if `least` does not.
    """
    if not accepted(least):
        return 0.0
    low, high = log(least), log(least)
    while high < log(most):
        low, high = high, min(high + log(3.0), log(most))
        if not accepted(exp(high)):
            break
    else:
        return inf
    while high - low > 0.05:
        middle = (low + high) / 2
        low, high = (middle, high) if accepted(exp(middle)) else (low, middle)
    return exp(low)


def rest_position(system: AnalyzedSystem, port: PortSignals, response: Array) -> Vector:
    """The position of the arms in the test: the last one of the port's arm, or its start position.

    `response` (n, m): as recorded; not used if it is not a position or has diverged.
    """
    if system.is_position(port.response) and len(response):
        last = response[-1]
        if np.isfinite(last).all() and np.abs(last).max() < FAR:
            return tuple(float(x) for x in last)
    arm = system.arms.get(port.arm)
    return arm.q if arm is not None else ()
