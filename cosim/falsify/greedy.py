"""The greedy adversary of the linear model (:mod:`cosim.linear.adversary`) as a family.

The model begins with the state of the scenario at its start, as a deviation from where it is at
its end; the receivers choose among the delays within the bounds of each channel.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.evaluation import Problem, document_of
from cosim.falsify.families import Space
from cosim.falsify.paths import Candidate, DelayPath
from cosim.linear.adversary import SampleChoices, attacks
from cosim.linear.component import Matrix
from cosim.linear.opened import OpenLoop
from cosim.linear.scenario import opened
from cosim.links.laws import IntArray
from cosim.links.semantics import SignalSemantics
from cosim.links.table import DrawnTable
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

#: Delays of a channel to choose from at most.
OPTIONS = 128


def greedy(space: Space, turn: int) -> Iterator[Candidate]:
    """One candidate for each aim. Raises RunError where there is no linear model."""
    problem = space.problem
    if turn or not problem.channels:
        return
    packets = _packets(problem)
    loop, start = _loop(problem)
    known = [_choices(problem, channel, loop) for channel in problem.channels]
    m, p = loop.held, loop.sent
    model = loop.A, loop.B[:, :m], loop.C[:p], loop.D[:p, :m]
    periods = -(-problem.ticks // loop.ticks)
    for attack in attacks(model, [c for _, c in known], start, periods, loop.period):
        delays = [ticks[mine] for (ticks, _), mine in zip(known, attack.chosen, strict=True)]
        each = zip(problem.channels, delays, packets, strict=True)
        paths = [_path(channel, d, loop, late) for channel, d, late in each]
        yield space.candidate(paths, f"the greedy adversary, {attack.says}")


def _loop(problem: Problem) -> tuple[OpenLoop, Matrix]:
    """The model at the end of the nominal run, and its states at the start. Raises CosimError."""
    scenario = build(document_of(problem, ()), problem.path)
    loop, begin = opened(scenario), opened(scenario, float(assemble(scenario).start))
    now, then = _values(loop), _values(begin)
    return loop, np.array([then.get(name, 0.0) - now.get(name, 0.0) for name, _ in loop.states])


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


def _choices(
    problem: Problem, channel: MovingChannel, loop: OpenLoop
) -> tuple[IntArray, SampleChoices]:
    """The delays of a channel to choose from, ticks, and what its receivers hold with each."""
    mine = {problem.links[i] for i in channel.places}
    usual = {
        problem.links[i]: round(c.nominal / loop.h) for c in problem.channels for i in c.places
    }
    low, high = round(channel.low / loop.h), round(channel.high / loop.h)
    every = max(channel.step, -(-(high - low) // OPTIONS // channel.step) * channel.step)
    ticks = np.unique(np.append(np.arange(low, high + 1, every), high))
    places = np.concatenate([x.held.reshape(-1) for x in loop.links if x.name in mine])
    which, before = [], []
    for d in ticks.tolist():
        delays = [d if x.name in mine else usual.get(x.name, 0) for x in loop.links]
        w, b = loop.sources(delays)
        which.append(w[places])
        before.append(np.maximum(b[places], 1))
    return ticks, SampleChoices(places, np.array(which), np.array(before))


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
