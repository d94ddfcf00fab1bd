"""The greedy adversary: at each sample the delay that injects most energy into the linear model.

The links of the model are cut (:mod:`cosim.linear.opened`), x+ = A x + B u, and a receiver may
hold any sample u that the bounds of its channel allow. Of these the adversary takes the one whose
power is greatest: x' P B u, or that of the change of x. P is the identity, or the Lyapunov matrix
of the loop without links. The model begins with the state of the scenario at its start, as a
deviation from where it is at its end.

Source: own construction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.evaluation import Problem, document_of
from cosim.falsify.families import Space
from cosim.falsify.paths import Candidate, DelayPath
from cosim.linear.component import Matrix
from cosim.linear.opened import OpenLoop
from cosim.linear.scenario import opened
from cosim.links.laws import IntArray
from cosim.links.semantics import SignalSemantics
from cosim.links.table import DrawnTable
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

#: Times before, s, since which the change of a state is taken; 0: the state itself.
BACK = (0.0, 1e-6, 0.05, 0.2)
#: The factor that keeps the energy of a loop without damping finite.
DAMPED = 0.999
#: Delays of a channel to choose from at most.
OPTIONS = 128
#: States at which the model is scaled down again.
FAR = 1e9


@dataclass(frozen=True, slots=True)
class _Choices:
    """The delays of a channel to choose from: `ticks` (o,), and what a receiver holds with each.

    `places` (w,): inputs of the model; `which` (o, w): outputs, `before` (o, w) periods ago.
    """

    ticks: IntArray
    places: IntArray
    which: IntArray
    before: IntArray


def greedy(space: Space, turn: int) -> Iterator[Candidate]:
    """One candidate for each aim. Raises RunError where there is no linear model."""
    problem = space.problem
    if turn or not problem.channels:
        return
    packets = _packets(problem)
    for loop, start in _loops(problem):
        delays, says = _adversary(problem, loop, start)
        for chosen, text in zip(delays, says, strict=True):
            each = zip(problem.channels, chosen, packets, strict=True)
            paths = [_path(channel, d, loop, late) for channel, d, late in each]
            yield space.candidate(paths, f"the greedy adversary, {text}")


def _loops(problem: Problem) -> list[tuple[OpenLoop, Matrix]]:
    """The model at the end of the nominal run, and its states at the start. Raises CosimError."""
    scenario = build(document_of(problem, ()), problem.path)
    loop, begin = opened(scenario), opened(scenario, float(assemble(scenario).start))
    now, then = _values(loop), _values(begin)
    start = [then.get(name, 0.0) - now.get(name, 0.0) for name, _ in loop.states]
    return [(loop, np.array(start))]


def _values(loop: OpenLoop) -> dict[str, float]:
    """The states of all components by name."""
    found: dict[str, float] = {}
    for part in loop.components:
        names = [name for slot in part.states for name in slot.scalars()]
        found |= dict(zip(names, part.x0.tolist(), strict=True))
    return found


def _packets(problem: Problem) -> list[bool]:
    """True for each channel whose delays count at sending."""
    plan = assemble(build(document_of(problem, ()), problem.path))
    tables = [plan.links[c.places[0]].table for c in problem.channels]
    return [isinstance(t, DrawnTable) and not isinstance(t.rule, SignalSemantics) for t in tables]


def _choices(problem: Problem, channel: MovingChannel, loop: OpenLoop) -> _Choices:
    mine = {problem.links[i] for i in channel.places}
    nominal = [round(c.nominal / loop.h) for c in problem.channels for _ in c.places]
    by_link = {problem.links[i]: n for (c, n) in zip(
        [c for c in problem.channels for _ in c.places], nominal, strict=True)
        for i in c.places}  # fmt: skip
    low, high = round(channel.low / loop.h), round(channel.high / loop.h)
    every = max(channel.step, -(-(high - low) // OPTIONS // channel.step) * channel.step)
    ticks = np.unique(np.append(np.arange(low, high + 1, every), high))
    places = np.concatenate([x.held.reshape(-1) for x in loop.links if x.name in mine])
    which, before = [], []
    for d in ticks.tolist():
        delays = [d if x.name in mine else by_link.get(x.name, 0) for x in loop.links]
        w, b = loop.sources(delays)
        which.append(w[places])
        before.append(np.maximum(b[places], 1))
    return _Choices(ticks, places, np.array(which), np.array(before))


def _adversary(
    problem: Problem, loop: OpenLoop, start: Matrix
) -> tuple[list[list[IntArray]], list[str]]:
    """The delays (periods,), ticks, of each channel, for each aim; and the aims in words."""
    channels = [_choices(problem, c, loop) for c in problem.channels]
    m, p = loop.held, loop.sent
    A, B, C, D = loop.A, loop.B[:, :m], loop.C[:p], loop.D[:p, :m]
    aims = _aims(A, B, C, loop.period)
    n, periods = len(aims), -(-problem.ticks // loop.ticks)
    deepest = max(int(c.before.max()) for c in channels)
    longest = max(aim.back for aim in aims)
    x = np.tile(start, (n, longest + 1, 1))  # (aims, times: the last is now, states)
    y, u = np.zeros((n, deepest + periods, p)), np.zeros((n, m))
    y[:, :deepest] = (x[:, -1] @ C.T)[:, None, :]
    for c in channels:
        u[:, c.places] = y[:, deepest - c.before[0], c.which[0]]
    chosen = [np.zeros((n, periods), np.int64) for _ in channels]
    power, rows = np.stack([aim.power for aim in aims]), np.arange(n)
    back = np.array([aim.back for aim in aims])
    for k in range(periods):
        moves = x[:, -1] - np.where(back[:, None] > 0, x[rows, longest - back], 0.0)
        gain = np.einsum("cn,cnm->cm", moves, power)
        for c, mine in zip(channels, chosen, strict=True):
            held = y[:, deepest + k - c.before, c.which]  # (aims, options, inputs)
            best = np.einsum("cow,cw->co", held, gain[:, c.places]).argmax(1)
            mine[:, k], u[:, c.places] = c.ticks[best], held[rows, best]
        y[:, deepest + k] = x[:, -1] @ C.T + u @ D.T
        x = np.concatenate([x[:, 1:], (x[:, -1] @ A.T + u @ B.T)[:, None]], axis=1)
        size = np.abs(x).max(axis=(1, 2))
        for i in np.flatnonzero((size > FAR) | (size < 1.0 / FAR) & (size > 0.0)):
            with np.errstate(over="ignore"):  # of what was long before
                x[i], y[i], u[i] = x[i] / size[i], y[i] / size[i], u[i] / size[i]
    return [[mine[i] for mine in chosen] for i in range(n)], [aim.says for aim in aims]


@dataclass(frozen=True, slots=True)
class _Aim:
    """An aim: the samples u that are held make z' `power` u large, `power` (n, m).

    z is the state, or its change since `back` periods before.
    """

    power: Matrix
    back: int
    says: str


def _aims(A: Matrix, B: Matrix, C: Matrix, period: float) -> list[_Aim]:
    radius = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    inside = A * min(1.0, DAMPED / max(radius, 1e-12))
    weights = {
        "of states": np.eye(len(A)),
        "kept by states": _lyapunov(inside, np.eye(len(A))),
        "kept by outputs": _lyapunov(inside, C.T @ C),
    }
    found = []
    for what, P in weights.items():
        for held in BACK:
            back = max(1, round(held / period)) if held else 0
            says = f"the energy {what}"
            says += f", by their change in {back * period:.3g} s" if back else ""
            found.append(_Aim(P @ B, back, says))
    return found


def _lyapunov(A: Matrix, Q: Matrix) -> Matrix:
    """P = Q + A' P A, by doubling."""
    P, power = Q.copy(), A.copy()
    for _ in range(40):
        more = power.T @ P @ power
        P = P + more
        power = power @ power
        if np.abs(more).max() <= 1e-12 * np.abs(P).max():
            break
    return P


def _path(channel: MovingChannel, delays: IntArray, loop: OpenLoop, packets: bool) -> DelayPath:
    """The path with which a receiver holds, in each period, a sample of this age (ticks)."""
    begins = loop.ticks * np.arange(len(delays), dtype=np.int64)
    if not packets:
        return DelayPath.of(begins, delays * loop.h)
    sent = np.maximum((begins - delays) // channel.step, 0)
    values = np.full(int(begins[-1]) // channel.step + 1, channel.high)
    for j, d in zip(sent[::-1].tolist(), delays[::-1].tolist(), strict=True):
        values[j] = d * loop.h
    return DelayPath.sampled(values, channel.step)
