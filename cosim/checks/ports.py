"""Ports of the computed loop: passivity, the time that a hand takes, and delays to spare."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cosim.base.errors import CosimError
from cosim.checks import Finding
from cosim.checks.equilibria import heaviest, rest
from cosim.checks.loops import ComputedLoops, computed
from cosim.linear.opened import OpenLoop, open_loop
from cosim.predict.network import network
from cosim.predict.passivity import passive_range, worst_posture
from cosim.predict.system import AnalyzedSystem

#: A real part of the admittance that is no more than rounding, as a share of it.
ROUNDING = 1e-6
#: Frequencies at which a port is looked into, evenly on a logarithmic scale, and from which on.
COUNT, LOWEST = 100, 0.02
#: The distance to a hand's place that counts as there, rad.
WITHIN = 0.05
#: The times to settle with other seeds, as shares of that of the nominal run.
EARLIER, LATER = 0.75, 1.35
#: Times the delays up to which they are looked into.
SPARE = 8.0
#: Slow poles of interest, 1/s.
SLOWEST, FASTEST = 0.01, 10.0


def passivity(system: AnalyzedSystem) -> Iterator[Finding]:
    """Ports that are not passive in the heaviest posture, the hand taken away, estimates exact.

    Y(z) = (z - 1)/T G(z), the mean velocity of a period over the force held in it: the sampled port
    is passive if and only if the least eigenvalue of Y + Yᴴ is nowhere below 0 on the circle.
    """
    found = computed(system)
    postures = heaviest(system)
    for port in system.held() if found.resting and postures else ():
        arm = system.arms[port]
        slots = found.plan.slots()
        force, place = (slots.get(f"{port}.{name}") for name in (arm.external, arm.position))
        if force is None or place is None or port not in postures:
            continue
        free = {name: {**given, **_free(system, name)} for name, given in postures.items()}
        try:
            state = rest(system, found.plan, free, exact=True)
            loop = open_loop(state.plan, state.point, [force], [place], found.known)
            share, omega = least_real_part(loop, found.delays.mean)
        except CosimError:
            continue
        if share >= -ROUNDING:
            continue
        yield Finding(
            rule="passivity",
            severity="note",
            where=port,
            number=share,
            unit="1",
            reason=f"the port is not passive in the heaviest posture with exact estimates: Re Y is"
            f" {share:.2g} |Y| at {omega:.3g} rad/s{_limit(system, port)}; a stiffer grip or a"
            " contact can make oscillations grow",
        )


def _free(system: AnalyzedSystem, name: str) -> dict[str, Sequence[float]]:
    """The grip of an arm without stiffness and damping."""
    grip = system.arms[name].grip
    return {key: (0.0,) for key in grip.names[:2]} if grip.is_present else {}


def least_real_part(loop: OpenLoop, delays: Sequence[int]) -> tuple[float, float]:
    """The least eigenvalue of (Y + Yᴴ)/2 over |Y|, no unit, and where it is, rad/s."""
    T = loop.period
    longest = max((d * loop.h for d in delays), default=0.0)
    omega = np.geomspace(min(LOWEST, 1.0 / (1.0 + longest)), np.pi / T, COUNT)[:-1]
    if longest:
        omega = np.sort(np.concatenate([omega, np.arange(1, COUNT) * 0.2 / longest]))
        omega = omega[omega < np.pi / T]
    z = np.exp(1j * omega * T)
    Y = ((z - 1.0) / T)[:, None, None] * loop.response(delays, z)
    least = np.linalg.eigvalsh((Y + np.conj(np.swapaxes(Y, 1, 2))) / 2)[:, 0]
    share = least / np.linalg.norm(Y, 2, axis=(1, 2))
    i = int(np.argmin(share))
    return float(share[i]), float(omega[i])


def _limit(system: AnalyzedSystem, port: str) -> str:
    """The lambda_M up to which the continuous closed form is passive, in words."""
    net = network(system, port)
    if net is None or net.law.lambda_c or net.law.beyond:
        return ""
    limit = passive_range(net, worst_posture(net)[0]).limit
    if limit >= net.law.lambda_M:
        return ""
    return f"; it would be up to lambda_M = {limit:.3g} 1/s in place of {net.law.lambda_M:g}"


def settling(system: AnalyzedSystem) -> Iterator[Finding]:
    """The time until a hand has its arm where it wants it, or the slowest pole."""
    found = computed(system)
    for port in system.held():
        hand, arm = system.hand(port), system.arms[port]
        q = found.run.signals.get(f"{port}.{arm.position}")
        if hand is None or q is None or found.run.failed or not len(q):
            continue
        away = np.abs(q - np.asarray(hand.place)).max(axis=1) > WITHIN
        last = int(np.flatnonzero(away)[-1]) + 1 if away.any() else 0
        if last < len(q):
            time = float(found.run.t[last])
            text = f"every joint stays within {WITHIN:g} rad of the hand from {time:.3g} s on, in"
            text += f" the nominal run (seed {system.scenario.run.seed})"
            if found.delays.least != found.delays.most:
                text += f"; from {time * EARLIER:.2g} to {time * LATER:.2g} s on with other delays"
                text += " that the links draw"
        else:
            time = float("nan")
            text = f"the hand has not reached its place within the {found.run.time:.4g} s of the"
            rate = slowest(found)
            text += " nominal run"
            text += "" if rate is None else f"; the slowest pole is about {-rate:.2g} 1/s"
        yield Finding(
            rule="settling", severity="note", where=port, number=time, unit="s", reason=text
        )


def delays_to_spare(system: AnalyzedSystem) -> Iterator[Finding]:
    """The factor by which all delays could be longer, where the robots rest."""
    found = computed(system)
    longest = max(found.delays.most, default=0)
    if not found.resting or not longest:
        return
    at = found.resting[0]

    def stable(factor: float) -> bool:
        return not at.loop.unstable(found.delays.longer(factor), at.growth)

    try:
        if not stable(1.0):
            return  # the rule of the poles tells
        low = high = 1.0
        for factor in SPARE ** (np.arange(1, 4) / 3.0):  # it may be stable again beyond a limit
            high = float(factor)
            if not stable(high):
                break
            low = high
        while high > 1.1 * low:
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if stable(middle) else (low, middle)
    except CosimError:
        return
    now = max(found.delays.ages(found.delays.most))
    more = "at least" if low >= SPARE else "about"
    yield Finding(
        rule="delay-margin",
        severity="note",
        where=", ".join(f"links.{x.name}" for x in found.plan.links),
        number=low,
        unit="1",
        reason=f"small motions stay stable while constant delays are up to {more} {low:.2g} times"
        f" the longest that occur ({now:.3g} s)",
    )


def slowest(found: ComputedLoops) -> float | None:
    """The decay of the slowest pole that is not neutral, 1/s; None if it cannot be told."""
    if not found.resting:
        return None
    loop, delays = found.resting[0].loop, found.delays.mean
    try:
        neutral = loop.unstable(delays, -SLOWEST)
        low, high = SLOWEST, FASTEST
        if loop.unstable(delays, -high) == neutral:
            return None
        while high > 1.15 * low:
            middle = float(np.sqrt(low * high))
            same = loop.unstable(delays, -middle) == neutral
            low, high = (middle, high) if same else (low, middle)
    except CosimError:
        return None
    return low
