"""The smallest candidate that still fails: fewer segments, fewer links, a shorter run, values that
are nearer to the nominal ones, and simple numbers.

Segments are removed by delta debugging (A. Zeller, R. Hildebrandt, "Simplifying and Isolating
Failure-Inducing Input", IEEE Transactions on Software Engineering 28(2), 2002), then joined,
shortened and rounded. What is left also has to fail if every delay is changed at random by up to
:data:`cosim.falsify.trials.JITTER`; if that cannot be had, it is fragile.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from cosim.base.copies import replace
from cosim.base.random_numbers import generator
from cosim.falsify.evaluation import Problem
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.paths import Candidate
from cosim.falsify.search import Found
from cosim.falsify.trials import Trial, Trials

#: The part of the nominal margin by which a requirement stays violated.
SLACK = 0.1
#: Networks with jitter for each step of the way, and at the end.
SOME, MANY = 6, 24
#: Rounds of joining and removing.
TURNS = 12
#: Rounds of an evolution, and its candidates in each.
GENERATIONS, BROOD = 8, 48
#: Candidates of one round at most.
WIDE = 128

Tests = Generator[list[Candidate], list[CandidateOutcome], list[bool]]
Steps = Generator[list[Candidate], list[CandidateOutcome], "Trial"]


@dataclass(slots=True)
class Shrinking:
    """The way from a found candidate to a small one; `now`: the smallest so far.

    `slack`: by which a requirement has to be violated, in its unit, so that little jitter does not
    matter. `runs`: the number of candidates, until there are more than `limit`; at the end
    `outcome` is that of the small one, and `failing` how many of :data:`MANY` networks with jitter
    fail.
    """

    problem: Problem
    found: Found
    limit: int
    runs: int = 0
    robust: bool = False
    slack: float = 0.0
    failing: int = -1
    outcome: CandidateOutcome | None = None
    trials: Trials = field(init=False)
    now: Trial = field(init=False)

    def __post_init__(self) -> None:
        """Begin with what was found."""
        self.trials = Trials(self.problem)
        self.now = self.trials.of(self.found.candidate)
        if not self.found.outcome.reason:
            violated = -self.found.outcome.margins[self.found.requirement].value
            self.slack = min(SLACK * self.found.scale, 0.5 * violated)

    def _fails(self, outcome: CandidateOutcome) -> bool:
        """True if the requirement is violated by more than the slack."""
        if outcome.reason:
            return True
        return outcome.margins[self.found.requirement].value < -self.slack

    # ---- tests ----------------------------------------------------------------------------------

    def fails(self, trials: Sequence[Trial], jitter: int = 0) -> Tests:
        """True for each of these that fails, also with `jitter` networks with jitter."""
        found: list[bool] = []
        each = WIDE // (1 + jitter) or 1
        for first in range(0, len(trials), each):
            some = trials[first : first + each]
            candidates = [c for t in some for c in self.trials.with_jitter(t, jitter)]
            self.runs += len(candidates)
            outcomes = yield candidates
            failed = [self._fails(x) for x in outcomes]
            n = 1 + jitter
            found += [all(failed[i * n : (i + 1) * n]) for i in range(len(some))]
        return found

    def first(self, trials: Iterable[Trial], jitter: int = 0) -> Generator[
        list[Candidate], list[CandidateOutcome], Trial | None
    ]:  # fmt: skip
        """The first of these that fails; it is the smallest so far."""
        listed = list(trials)
        if not listed or self.exhausted:
            return None
        failed = yield from self.fails(listed, jitter)
        for trial, one in zip(listed, failed, strict=True):
            if one:
                self.now = trial
                return trial
        return None

    @property
    def exhausted(self) -> bool:
        """True if there are no more runs."""
        return self.runs > self.limit

    # ---- steps ----------------------------------------------------------------------------------

    def shrink(self) -> Steps:
        """The smallest trial that fails."""
        start = self.now
        start = yield from self._axes(start)
        if self.found.outcome.reason:
            start = yield from self._stop(start)
        small = yield from self._fewer(start, 0)
        self.robust = (yield from self.fails([small], SOME))[0]
        if not self.robust and (yield from self.fails([start], SOME))[0]:
            self.robust, small = True, (yield from self._fewer(start, SOME))
        jitter = SOME if self.robust else 0
        small = yield from self._nearer(small, jitter)
        small = yield from self._stop(small)
        small = yield from self._simpler(small, jitter)
        small = self.now = self.trials.within_bounds(small)
        outcomes = yield self.trials.with_jitter(small, MANY)
        self.outcome, *others = outcomes
        self.failing = sum(x.fails(self.found.requirement) for x in others)
        return small

    def _axes(self, trial: Trial) -> Steps:
        """Values as the scenario has them, as far as they can be."""
        none = (None,) * len(trial.axes)
        moved = [i for i, u in enumerate(trial.axes) if u is not None]
        if not moved:
            return trial
        trials = [replace(trial, axes=none)] if trial.pieces else []
        for i in moved:
            only = tuple(u if j == i else None for j, u in enumerate(trial.axes))
            trials.append(replace(trial, axes=only))
        trial = (yield from self.first(trials)) or trial
        for i in moved:
            if trial.axes[i] is not None:
                axes = tuple(None if j == i else u for j, u in enumerate(trial.axes))
                if trial.pieces or any(u is not None for u in axes):
                    trial = (yield from self.first([replace(trial, axes=axes)])) or trial
        return trial

    def _stop(self, trial: Trial) -> Steps:
        """The shortest run in which it fails and the nominal one does not."""
        h, lengths = self.problem.h, list[int]()
        [outcome] = yield [self.trials.candidate(trial)]
        margin = outcome.margins.get(self.found.requirement)
        at = outcome.stopped_at if margin is None else margin.time
        last = max([p.begin for _, p in trial.pieces if p.begin < trial.ticks], default=0)
        least = max(last * h, at if at == at else 0.0)
        for more in (1.0, 1.05, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0):
            ticks = _round_up(least * more, h)
            if 0 < ticks < trial.ticks and ticks not in lengths:
                lengths.append(ticks)
        trials = [replace(trial, ticks=ticks) for ticks in lengths]
        for first in range(0, len(trials), 4):
            some = trials[first : first + 4]
            nominal = [replace(self.problem.nominal, ticks=t.ticks) for t in some]
            outcomes = yield [*(self.trials.candidate(t) for t in some), *nominal]
            for t, mine, others in zip(some, outcomes, outcomes[len(some) :], strict=False):
                if self._fails(mine) and others.passes:
                    self.now = t.cut(None, None)
                    return self.now
        return trial

    def _fewer(self, trial: Trial, jitter: int) -> Steps:
        """Fewer channels, a shorter part of the run, fewer pieces."""
        for channel in sorted(trial.channels):
            if len(trial.channels) > 1:
                rest = trial.having(p for p in trial.pieces if p[0] != channel)
                trial = (yield from self.first([rest], jitter)) or trial
        trial = yield from self._window(trial, jitter)
        trial = (yield from self.first(self.trials.coarser(trial), jitter)) or trial
        trial = yield from self._delta(trial, jitter)
        for _ in range(TURNS):
            before = len(trial.pieces)
            trial = yield from self._joined(trial, jitter)
            trial = yield from self._delta(trial, jitter)
            if len(trial.pieces) == before or self.exhausted:
                break
        return (yield from self._evolved(trial))

    def _window(self, trial: Trial, jitter: int) -> Steps:
        """Pieces of a part of the run only: none before, and none after a time."""
        for late in (True, False):
            low, high = 0, trial.ticks  # between them is the time to be found
            while high - low > max(1, trial.ticks // 256) and not self.exhausted:
                cuts = sorted({low + (high - low) * k // 8 for k in range(1, 8)})
                trials = [trial.cut(None if late else c, c if late else None) for c in cuts]
                if not late:
                    cuts, trials = cuts[::-1], trials[::-1]
                failed = yield from self.fails(trials, jitter)
                if True not in failed:
                    low, high = (cuts[-1], high) if late else (low, cuts[-1])
                    continue
                i = failed.index(True)
                trial = self.now = trials[i]
                before = cuts[i - 1] if i else (low if late else high)
                low, high = (before, cuts[i]) if late else (cuts[i], before)
        return trial

    def _delta(self, trial: Trial, jitter: int) -> Steps:
        """Delta debugging over pieces: none can be left out alone."""
        n = 2
        while len(trial.pieces) > 1 and not self.exhausted:
            parts = np.array_split(np.arange(len(trial.pieces)), min(n, len(trial.pieces)))
            every = set(range(len(trial.pieces)))
            trials = [trial.without(every - set(part.tolist())) for part in parts]
            trials += [trial.without(part.tolist()) for part in parts] if len(parts) > 2 else []
            smaller = yield from self.first(trials, jitter)
            if smaller is not None:
                n = 2 if len(smaller.pieces) <= len(parts[0]) else max(2, n - 1)
                trial = smaller
            elif len(parts) == len(trial.pieces):
                break
            else:
                n = min(2 * n, len(trial.pieces))
        return trial

    def _joined(self, trial: Trial, jitter: int) -> Steps:
        """Two neighbours of a channel as one, as long as that fails."""
        while not self.exhausted:
            smaller = yield from self.first(self.trials.joints(trial), jitter)
            if smaller is None:
                return trial
            trial = smaller
        return trial

    def _evolved(self, trial: Trial) -> Steps:
        """One piece less, where the others may change: an evolution with a generation a round."""
        random = generator(len(trial.pieces), "falsify:evolution")
        while len(trial.pieces) > 1 and not self.exhausted:
            base, least = trial, float("inf")
            some = [trial.without([i]) for i in range(len(trial.pieces))]
            smaller = None
            for _ in range(GENERATIONS):
                scores = yield from self._scores(some)
                best = min(range(len(some)), key=lambda i: scores[i])
                if scores[best] < -self.slack:
                    smaller = some[best]
                    break
                if scores[best] < least:
                    base, least = some[best], scores[best]
                some = [self.trials.mutant(base, random) for _ in range(BROOD)]
            if smaller is None:
                break
            trial = self.now = smaller
        return trial

    def _scores(self, trials: Sequence[Trial]) -> Generator[
        list[Candidate], list[CandidateOutcome], list[float]
    ]:  # fmt: skip
        """The margin of each trial, in its unit."""
        self.runs += len(trials)
        outcomes = yield [self.trials.candidate(trial) for trial in trials]
        name = self.found.requirement
        return [-1e300 if x.reason else x.margins[name].value for x in outcomes]

    def _nearer(self, trial: Trial, jitter: int) -> Steps:
        """Shorter pieces, with values nearer to the nominal delay."""
        for _ in range(3):
            before = trial
            for i in range(len(trial.pieces)):
                for changes in (self.trials.later, self.trials.sooner, self.trials.milder):
                    for _ in range(4):
                        smaller = yield from self.first(changes(trial, i), jitter)
                        if smaller is None:
                            break
                        trial = smaller
            if trial == before or self.exhausted:
                break
        return trial

    def _simpler(self, trial: Trial, jitter: int) -> Steps:
        """Times and delays of few digits."""
        for i in range(len(trial.pieces)):
            trial = (yield from self.first(self.trials.rounded(trial, i), jitter)) or trial
            trial = (yield from self.first(self.trials.rounded_value(trial, i), jitter)) or trial
        return trial


def _round_up(seconds: float, h: float) -> int:
    """A length of at least this, in ticks, that is a simple number of seconds."""
    unit = 0.1 if seconds < 5 else 0.5 if seconds < 20 else 1.0
    return round(max(unit, ceil(round(seconds / unit, 6)) * unit) / h)
