"""The families in order, until a candidate violates a requirement; then the candidate is shrunk.

A search is a generator: it yields rounds of candidates, and gets their outcomes in the same order.
So it depends neither on the number of workers nor on their speed, and an interrupted search is
repeated from the outcomes that are there (:mod:`cosim.falsify.rounds`).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, islice
from math import inf

import numpy as np

from cosim.base.errors import CosimError, ScenarioError
from cosim.falsify.families import ROUND, Family, Space, constant, draw, segment, single, wave
from cosim.falsify.greedy import greedy
from cosim.falsify.judge import CandidateOutcome, Margin, scales_of, score
from cosim.falsify.optimizer import optimizer
from cosim.falsify.paths import Candidate

#: Rounds of a family, which gets the scores of each.
Rounds = Generator[list[Candidate], Sequence[float], None]
Outcomes = Generator[list[Candidate], list[CandidateOutcome], "Found | None"]


def drawn(family: Family) -> Callable[[Space, int, int], Rounds]:
    """The rounds of a family that learns nothing."""

    def rounds(space: Space, turn: int, share: int) -> Rounds:
        candidates = islice(family(space, turn), share)
        while some := list(islice(candidates, ROUND)):
            yield some

    return rounds


#: Rounds of candidates in a pass, at most so many candidates; and the share of the runs.
SearchedFamily = tuple[Callable[[Space, int, int], Rounds], float]
#: The families in their order.
FAMILIES: dict[str, SearchedFamily] = {
    "constant": (drawn(constant), 0.1), "wave": (drawn(wave), 0.15), "draw": (drawn(draw), 0.1),
    "greedy": (drawn(greedy), 0.05), "segment": (drawn(segment), 0.2),
    "single": (drawn(single), 0.15), "optimizer": (optimizer, 0.25),
}  # fmt: skip
#: Runs of one pass through all families.
RUNS = 4000


@dataclass(frozen=True, slots=True)
class Found:
    """A candidate that violates `requirement`, and the family that found it.

    `scale`: the size of the requirement's nominal margin, in its unit.
    """

    family: str
    candidate: Candidate
    outcome: CandidateOutcome
    requirement: str
    scale: float = 1.0


@dataclass(slots=True)
class Account:
    """The account of a search.

    `least`: for each requirement its least margin, and the family and the candidate that had it.
    `runs`: candidates so far, by family; `best`: the least score, in sizes of the margins of the
    `nominal` run. `notes`: why a family had no candidates.
    """

    runs: dict[str, int] = field(default_factory=dict)
    least: dict[str, tuple[Margin, str, Candidate]] = field(default_factory=dict)
    best: float = inf
    notes: dict[str, str] = field(default_factory=dict)
    nominal: CandidateOutcome | None = None

    @property
    def total(self) -> int:
        """All candidates."""
        return sum(self.runs.values())

    def add(
        self, family: str, some: Sequence[tuple[Candidate, CandidateOutcome]],
        scales: dict[str, float], end: float,
    ) -> None:  # fmt: skip
        """Take a round. `scales`: sizes of the margins, in their units; `end`: of the run, s."""
        self.runs[family] = self.runs.get(family, 0) + len(some)
        for candidate, outcome in some:
            self.best = min(self.best, score(outcome, scales, end))
            for name, margin in outcome.margins.items():
                known = self.least.get(name)
                if known is None or margin.value < known[0].value:
                    self.least[name] = margin, family, candidate


@dataclass(frozen=True, slots=True)
class Budget:
    """The end of a search: after `runs` candidates, or once `over`, between two rounds.

    `passes`: passes of so many follow each other until it is over. `families`: those that are
    searched, in order, () for all; `seed`: of all that is drawn.
    """

    runs: int = RUNS
    passes: bool = False
    families: tuple[str, ...] = ()
    over: Callable[[], bool] = lambda: False
    seed: int = 0


def search(
    space: Space, budget: Budget, account: Account,
    families: Mapping[str, SearchedFamily] = FAMILIES,
) -> Outcomes:  # fmt: skip
    """The first candidate found that violates a requirement; None: there was none.

    Whatever runs the candidates, outcomes are sent in their order. Raises ScenarioError for a
    requirement that the nominal run leaves undecided.
    """
    problem = space.problem
    [nominal] = yield [problem.nominal]
    account.nominal, scales = nominal, scales_of(nominal)
    account.add("nominal", [(problem.nominal, nominal)], scales, 1.0)
    for name, margin in nominal.margins.items():
        if margin.value != margin.value:
            raise ScenarioError(
                f"require.{name} is undecided in a run of {space.ticks * problem.h:g} s with the "
                "nominal delays; expected a longer run, or an interval within it",
                str(problem.path),
            )
    if nominal.fails():
        return _found("nominal", [(problem.nominal, nominal)], scales, 1.0)
    names = budget.families or tuple(families)
    total = sum(families[name][1] for name in names)
    for turn in count() if budget.passes else range(1):
        before = account.total
        for name in names:
            family, part = families[name]
            rounds = family(space, turn, max(1, round(budget.runs * part / total)))
            found = yield from _family(name, rounds, space, budget, account)
            if found is not None or budget.over():
                return found
        if account.total == before:
            return None
    return None


def _family(name: str, rounds: Rounds, space: Space, budget: Budget, account: Account) -> Outcomes:
    """The candidate of a family that violates a requirement, if it has one."""
    assert account.nominal is not None
    scales, end = scales_of(account.nominal), space.ticks * space.problem.h
    scores: list[float] | None = None
    while not budget.over():
        try:
            some = next(rounds) if scores is None else rounds.send(scores)
        except StopIteration:
            return None
        except (CosimError, np.linalg.LinAlgError) as error:
            account.notes[name] = str(error)
            return None
        outcomes = yield some
        pairs = list(zip(some, outcomes, strict=True))
        account.add(name, pairs, scales, end)
        if any(outcome.fails() for outcome in outcomes):
            return _found(name, pairs, scales, end)
        scores = [score(outcome, scales, end) for outcome in outcomes]
    return None


def _found(
    family: str,
    pairs: Sequence[tuple[Candidate, CandidateOutcome]],
    scales: dict[str, float],
    end: float,
) -> Found:
    """The simplest of those that fail: the fewest pieces, then the least score."""

    def order(i: int) -> tuple[int, float, int]:
        candidate, outcome = pairs[i]
        pieces = sum(len(path.edges) for path in candidate.paths)
        return pieces, score(outcome, scales, end), i

    failing = [i for i, (_, outcome) in enumerate(pairs) if outcome.fails()]
    candidate, outcome = pairs[min(failing, key=order)]
    worst = {n: m.value / scales[n] for n, m in outcome.margins.items() if m.value < 0}
    name = min(worst, key=lambda n: worst[n]) if worst else next(iter(scales), "")
    return Found(family, candidate, outcome, name, scales.get(name, 1.0))
