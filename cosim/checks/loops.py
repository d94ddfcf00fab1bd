"""The sampled loop as a whole: its run from the start, and its poles where it rests.

The loop is linearized with its links cut (:mod:`cosim.linear.opened`), so that all delays of a link
are looked into. Closed forms of a law have no part in it; rules explain where a pole comes from by
what makes it go away: the component alone, the robots without links, the shortest delays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, isfinite, log, nan

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import CosimError
from cosim.base.names import listed
from cosim.checks import Finding, Severity
from cosim.checks.equilibria import Starts, against_walls, goals, heaviest, rest
from cosim.checks.laws import known_laws
from cosim.checks.nominal import SLOW, NominalRun, nominal_run
from cosim.linear.loop import KnownDerivatives
from cosim.linear.opened import OpenLoop, open_loop
from cosim.linear.scenario import observed
from cosim.predict.facts import DynamicFeedback
from cosim.predict.system import AnalyzedSystem
from cosim.schedule.plan import Plan

#: Growth that counts, 1/s: what grows less is not told from rest.
GROWTH = 0.003
#: Growth, 1/s, that a motion of 1 rad/s can feign.
FEIGNED = 3.0
#: Growth in a step from which on a component alone counts as unstable: far above rounding.
STIFF = 0.01
#: Distance (rad) and speed (rad/s) up to which an arm is at its place.
NEAR = 0.01
#: Change of a position (rad) or an estimate that moves a pole by less than :data:`GROWTH`.
SAME = 1e-6
#: Times, s, and the periods at the most, over which delays are drawn; growth, 1/s, that the first
#: of them does not tell.
DRAWN, PERIODS, UNSURE = (100.0, 400.0), 80_000, 0.05
#: Curvature of a step from which on it has no linear model.
EDGE = 0.05


class LoopDelays(Struct, frozen=True):
    """Constant delays that stand for those of the links, in base steps, one for each link.

    Equal to each other where all delays are constant. A step of `h` s; `held`: the mean time, s,
    for which a sample that is sent less often than looked at is older than its delay.
    """

    h: float
    least: tuple[int, ...]
    mean: tuple[int, ...]
    most: tuple[int, ...]
    held: tuple[float, ...]

    def ages(self, delays: Sequence[int]) -> list[float]:
        """The mean ages, s, of what receivers hold: the delays that a scenario states."""
        return [d * self.h + held for d, held in zip(delays, self.held, strict=True)]

    def longer(self, factor: float) -> list[int]:
        """The delays that make the longest ages `factor` times as long."""
        ages = zip(self.ages(self.most), self.held, strict=True)
        return [round((factor * age - held) / self.h) for age, held in ages]


class RestingLoop(Struct, frozen=True):
    """The loop where robots rest: `where` in words; `speed` (rad/s) that is left there."""

    where: str
    loop: OpenLoop
    speed: float = 0.0

    @property
    def growth(self) -> float:
        """The growth that counts here, 1/s."""
        return max(GROWTH, FEIGNED * self.speed)


class ComputedLoops(Struct, frozen=True):
    """The nominal run, and the loop of the linearized `plan`.

    `resting`: where the run ends, and where it starts if that is at rest at another place;
    `elsewhere`: in the heaviest posture with exact estimates, and against walls; `missing`: the
    reasons why there is no linear model; `failing`: postures in which nothing runs; `known`: all
    derivatives.
    """

    plan: Plan
    run: NominalRun
    delays: LoopDelays
    resting: tuple[RestingLoop, ...]
    elsewhere: tuple[RestingLoop, ...]
    missing: tuple[str, ...]
    failing: tuple[str, ...]
    known: KnownDerivatives


def computed(system: AnalyzedSystem) -> ComputedLoops:
    """All of it, once."""
    return system.once("loops", "", lambda: _computed(system))


def _computed(system: AnalyzedSystem) -> ComputedLoops:
    plan = observed(system.scenario, system.plan)
    run, missing = nominal_run(system, plan), list[str]()
    known: KnownDerivatives = {}
    failing: list[str] = []
    resting, elsewhere, postures = list[RestingLoop](), list[RestingLoop](), goals(system)
    if run.end is not None and (run.last_speed <= SLOW or not postures):
        resting += _smooth("where the run ends", plan, run, missing)
    if postures and (not resting or _starts_elsewhere(system, run, postures)):
        try:
            state = rest(system, plan, postures)
            where = "where it starts" if resting else "at rest"
            resting.append(RestingLoop(where, open_loop(state.plan, state.point, known=known)))
            missing.clear()
        except CosimError as error:
            missing[:] = missing or [str(error)]
    if not resting and not missing:
        missing.append("the run fails, and nothing says where the robots would rest")
    others = (("in the heaviest posture with exact estimates", heaviest, True),
              ("against the wall", against_walls, False))  # fmt: skip
    for where, states, exact in others if resting else ():
        if not (postures := states(system)):
            continue
        try:
            state = rest(system, plan, postures, exact=exact)
        except CosimError as error:
            failing.append(f"{where} not even one period can be run: {error}")
            continue
        try:
            loop = open_loop(state.plan, state.point, known=known)
            elsewhere.append(RestingLoop(where, loop))
        except CosimError as error:
            missing.append(f"{where}: {error}")
    return ComputedLoops(
        plan,
        run,
        _delays(system, plan),
        tuple(resting),
        tuple(elsewhere),
        tuple(missing),
        tuple(failing),
        known,
    )


def _smooth(where: str, plan: Plan, run: NominalRun, missing: list[str]) -> list[RestingLoop]:
    """The loop at the end of a run; none, and the reason, if it has no linear model there."""
    assert run.end is not None
    try:
        loop = open_loop(plan, run.end)
    except CosimError as error:
        missing.append(str(error))
        return []
    rough = [c.name for c in loop.components if c.error > EDGE]
    if rough:
        missing.append(f"{listed(rough)}: no linear model at an edge, such as that of a contact")
        return []
    return [RestingLoop(where, loop, run.last_speed)]


def _starts_elsewhere(system: AnalyzedSystem, run: NominalRun, postures: Starts) -> bool:
    """True if the arms start at rest where they would, and end elsewhere or estimate otherwise."""
    away = 0.0
    for name, arm in system.arms.items():
        place = postures.get(name, {}).get(arm.position)
        q, dq = (run.signals.get(f"{name}.{x}") for x in (arm.position, arm.rate))
        if place is None or q is None or dq is None or not len(q):
            return False
        if np.abs(q[0] - place).max() > NEAR or np.abs(dq[0]).max() > NEAR:
            return False
        away = max(away, float(np.abs(q[-1] - q[0]).max()))
    for name, law in system.with_facts(DynamicFeedback).items():
        estimate = run.signals.get(f"{name}.{law.estimate}")
        if estimate is not None:
            away = max(away, float(np.abs(estimate[-1] - estimate[0]).max()))
    return away > SAME


def _delays(system: AnalyzedSystem, plan: Plan) -> LoopDelays:
    least, mean, most, held = list[int](), list[int](), list[int](), list[float]()
    for link in plan.links:
        age = system.age(link)
        short, long = round(age.least / plan.h), round(age.most / plan.h)
        between = plan.component(link.source.component).period - 1  # ticks from sample to sample
        one = long - short <= between  # one delay, seen at several moments
        middle = short if one else round(age.mean / plan.h)
        long = short if one else long
        least.append(short)
        mean.append(middle)
        most.append(long)
        held.append(max(0.0, age.mean - middle * plan.h) if one else 0.0)
    return LoopDelays(plan.h, tuple(least), tuple(mean), tuple(most), tuple(held))


# ---- rules --------------------------------------------------------------------------------------


def nominal(system: AnalyzedSystem) -> Iterator[Finding]:
    """The run from the start: it fails, or what moves grows, or swings on and on."""
    found = computed(system)
    run = found.run
    outcome = "fails" if run.failed else "" if _driven(system) else run.outcome
    if not outcome:
        return
    reasons = {
        "fails": f"from this start the run fails at {run.time:.4g} s: {run.failed}",
        "grows": f"the speeds still grow when the run ends, at {run.time:.4g} s",
        "swings": f"when the run ends, at {run.time:.4g} s, the robots swing at"
        f" {run.last_speed:.3g} rad/s, no less than before",
    }
    small = _small(found) if found.resting else ""
    yield Finding(
        rule="run",
        severity="error",
        where="run",
        number=run.time,
        unit="s",
        reason=reasons[outcome] + small,
        advice="start nearer to the goal, lower gains, or sample faster"
        if "unstable" not in small else "",
    )  # fmt: skip


def _small(found: ComputedLoops) -> str:
    at = found.resting[-1]
    try:
        grows = at.loop.unstable(found.delays.mean, at.growth)
    except CosimError:
        return ""
    return f"; small motions {at.where} are {'un' if grows else ''}stable"


def saturation(system: AnalyzedSystem) -> Iterator[Finding]:
    """Torques that reach tau_max in the nominal run."""
    run = computed(system).run
    for name, law, _ in known_laws(system):
        tau = run.signals.get(f"{name}.{law.torque}")
        limits = np.resize(np.asarray(law.tau_max), tau.shape[1]) if tau is not None else None
        if tau is None or limits is None or not len(tau) or run.failed:
            continue
        share = (np.abs(tau) >= limits * (1.0 - 1e-9)).mean(axis=0)
        j = int(np.argmax(share))
        if not share[j]:
            continue
        yield Finding(
            rule="saturation",
            severity="warning",
            where=name,
            number=float(share[j]) * 100,
            unit="%",
            reason=f"joint {j} is at its tau_max of {limits[j]:g} N.m during {share[j] * 100:.2g} %"
            " of the nominal run, and adaptation stops meanwhile",
            advice="raise tau_max, or use smaller forces",
        )


def _driven(system: AnalyzedSystem) -> bool:
    """True if something moves the robots by itself: a table, an event, or a source of signals."""
    if system.plan.players or system.scenario.events:
        return True
    fed = {w.target.component for w in system.plan.wires}
    fed |= {x.target.component for x in system.plan.links}
    return any(c.name not in fed and c.name not in system.arms for c in system.plan.components)


def poles(system: AnalyzedSystem) -> Iterator[Finding]:
    """The poles of the loop where it rests, for the delays of its links."""
    found = computed(system)
    try:
        for at in found.resting:
            yield from _poles(found, at, "poles", "error")
        for at in found.elsewhere:
            yield from _poles(found, at, "posture", "warning")
    except CosimError as error:
        yield _missing(str(error))
    for reason in found.missing:
        yield _missing(reason)
    for reason in found.failing:
        yield Finding(
            rule="posture", severity="warning", where="run", number=inf, unit="1/s", reason=reason,
            advice="give the arm more substeps, or make stiffness and damping there less",
        )  # fmt: skip


def _missing(reason: str) -> Finding:
    return Finding(
        rule="not-computed",
        severity="note",
        where="run",
        number=float("nan"),
        unit="",
        reason=f"the poles were not computed: {reason}",
    )


def _poles(
    found: ComputedLoops, at: RestingLoop, rule: str, severity: Severity
) -> Iterator[Finding]:
    d = found.delays
    kinds = [("mean", d.mean)]
    kinds += [("longest", d.most), ("shortest", d.least)] if d.least != d.most else []
    bad = next(((k, x) for k, x in kinds if at.loop.unstable(x, at.growth)), None)
    if bad is None:
        return
    kind, delays = bad
    held = ""
    if d.least != d.most:
        drawn = _drawn(found, at)
        held = f" while the links have their {kind} delays"
        if drawn > at.growth:
            held += f", and grows by a factor of ten in {log(10) / drawn:.3g} s with those drawn"
        elif drawn < 0.0 or kind != "mean":
            rule, severity = "posture" if rule == "posture" else "delays", "warning"
    pole = growing_pole(at.loop, delays, at.growth)
    why, advice, where = _cause(found, at, delays, pole)
    if rule == "posture":
        yield Finding(
            rule="posture", severity=severity, where=where, number=pole.rate, unit="1/s",
            reason=f"{at.where} the loop is unstable{held}: {pole.sentence}; {why}",
            advice=advice,
        )  # fmt: skip
    elif rule == "delays":
        yield Finding(
            rule="delays", severity=severity, where=where, number=pole.rate, unit="1/s",
            reason=f"{at.where} the loop is unstable{held}: {pole.sentence}; {why}", advice=advice,
        )  # fmt: skip
    else:
        yield Finding(
            rule="poles", severity=severity, where=where, number=pole.rate, unit="1/s",
            reason=f"{at.where} the loop is unstable{held}: {pole.sentence}; {why}", advice=advice,
        )  # fmt: skip


def _drawn(found: ComputedLoops, at: RestingLoop) -> float:
    """The growth with the delays that the links draw, 1/s; nan if they draw too few."""
    growth = nan
    for time in DRAWN:
        try:
            rows = []
            for link, cut in zip(found.plan.links, at.loop.links, strict=True):
                looks = min(PERIODS, int(time / at.loop.period)) * len(cut.held)
                rows.append(link.table.stream(looks).rows(looks).astype(np.intp))
        except CosimError:  # a stored table, or a trace, that is shorter
            break
        growth = at.loop.drawn_growth(rows)
        if abs(growth) > UNSURE:
            break
    return growth


class GrowingPole(Struct, frozen=True):
    """The fastest growing pole: `rate` 1/s, `frequency` Hz (nan: not computed), its `state`."""

    rate: float
    frequency: float
    state: str

    @property
    def sentence(self) -> str:
        """The pole in words."""
        text = f"what moves grows by a factor of ten in {log(10) / self.rate:.3g} s"
        if isfinite(self.frequency):
            swings = f"at {self.frequency:.3g} Hz" if self.frequency > 0 else "without swinging"
            text += f", {swings}, mostly {self.state}"
        return text


def growing_pole(loop: OpenLoop, delays: Sequence[int], growth: float) -> GrowingPole:
    """The pole that grows the fastest, of a loop with one that grows faster than `growth`, 1/s."""
    pole, state = loop.fastest(delays, growth)
    return GrowingPole(pole.real, pole.imag / (2 * np.pi), state)


# ---- where a pole comes from --------------------------------------------------------------------


def _cause(
    found: ComputedLoops, at: RestingLoop, delays: Sequence[int], pole: GrowingPole
) -> tuple[str, str, str]:
    """The change that makes the pole go away, in words; a cure; and the place."""
    loop, plan = at.loop, found.plan
    for part in loop.components:
        h = plan.component(part.name).period * plan.h
        z = np.linalg.eigvals(part.A) if len(part.A) else np.zeros(0)
        rate = float(np.log(np.abs(z).max(initial=1.0))) / h
        if rate * h > STIFF and pole.rate > 0.5 * rate:
            return (
                f"{part.name} alone, its inputs held, is unstable in steps of {h:g} s: what damps"
                " it or stops it is too stiff for them",
                f"give {part.name} more substeps or a shorter period",
                part.name,
            )
    alone = _unstable_alone(loop, at.growth)
    if alone:
        return (
            f"{listed(alone)} {'are' if len(alone) > 1 else 'is'} unstable with all links cut,"
            f" sampled every {loop.period:g} s",
            "sample faster, or lower the gains",
            ", ".join(alone),
        )
    short = _shortest(plan)
    if not loop.unstable(short, at.growth):
        return _late(found, at, delays, short)
    names = sorted({x.target.component for x in plan.links})
    return (
        "with the shortest delays it is, too, but not without the links: the coupling is too strong"
        " for the period",
        "lower the weights or lambda, or sample faster",
        ", ".join(names),
    )


def _shortest(plan: Plan) -> list[int]:
    """The shortest delays that change no order of steps: one sample of each sender."""
    return [min(plan.component(x.source.component).period,
                max(x.table.minimum_delay_ticks, 1)) for x in plan.links]  # fmt: skip


def _unstable_alone(loop: OpenLoop, growth: float) -> list[str]:
    """The components whose states grow with all links cut."""
    if not len(loop.A):
        return []
    z, vectors = np.linalg.eig(loop.A)
    bad = np.abs(z) > np.exp(growth * loop.period)
    if not bad.any():
        return []
    v = np.abs(vectors[:, int(np.argmax(np.abs(z)))])
    names = [name.partition(".")[0] for (name, _), part in zip(loop.states, v, strict=True)
             if part > 0.01 * v.max()]  # fmt: skip
    return list(dict.fromkeys(names))


def _late(
    found: ComputedLoops, at: RestingLoop, delays: Sequence[int], short: Sequence[int]
) -> tuple[str, str, str]:
    """The links whose delay matters, and the delay up to which it is stable."""
    each = [
        i for i in range(len(delays))
        if not at.loop.unstable([short[i] if j == i else d for j, d in enumerate(delays)],
                                at.growth)
    ] if len(delays) > 1 else []  # fmt: skip
    blamed = each or range(len(delays))
    names = [f"links.{found.plan.links[i].name}" for i in blamed]
    low, high = 0.0, 1.0

    def mixed(share: float) -> list[int]:
        return [round(s + share * (d - s)) if i in blamed else d
                for i, (s, d) in enumerate(zip(short, delays, strict=True))]  # fmt: skip

    for _ in range(8):
        middle = (low + high) / 2
        low, high = (low, middle) if at.loop.unstable(mixed(middle), at.growth) else (middle, high)
    ages = (found.delays.ages(x) for x in (mixed(low), delays))
    limit, now = (max(each[i] for i in blamed) for each in ages)
    one = "delay" if len(names) == 1 else "delays"
    return (
        f"the {one} of {listed(names)}, {now:.3g} s, {'is' if one == 'delay' else 'are'} the cause:"
        f" stable up to about {limit:.2g} s",
        "shorten the delay, or lower the gains",
        ", ".join(names),
    )
