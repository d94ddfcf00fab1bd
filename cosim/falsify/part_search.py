"""A search in parts: the candidates of families that learn nothing, divided among calls.

Such candidates follow from the problem, the seed and the number of runs. Part k of n runs blocks of
them, in their order, and stops after the round in which one of its own fails: the whole search ends
there, or before. What learns from outcomes, the optimizer and the shrinking, is run by the call
that puts the parts together. It is the whole search, over the outcomes of all parts, so its result
is that of one call, also if a part is missing or was made with another number of parts.
"""

from __future__ import annotations

from collections.abc import Generator

from cosim.base.copies import replace
from cosim.falsify.families import Space
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.paths import Candidate
from cosim.falsify.search import FAMILIES, Account, Budget, Found, Outcomes, Rounds, search
from cosim.study.batch import PLACES
from cosim.study.parts import StudyPart

#: Families whose candidates follow from the outcomes of others.
ADAPTIVE = ("optimizer",)


def search_part(space: Space, budget: Budget, account: Account, part: StudyPart) -> Outcomes:
    """The first candidate of a part that violates a requirement; None: it has none.

    The nominal one belongs to every part. Raises ScenarioError as :func:`search` does.
    """
    families = {
        name: (_none if name in ADAPTIVE else rounds, share)
        for name, (rounds, share) in FAMILIES.items()
    }
    return _own(search(space, budget, account, families), part)


def _none(space: Space, turn: int, share: int) -> Rounds:
    """No candidates."""
    yield from ()


def _own(
    steps: Outcomes, part: StudyPart
) -> Generator[list[Candidate], list[CandidateOutcome], Found | None]:
    """The rounds of a part: of each round its blocks. The others count as the nominal one."""
    outcomes = yield next(steps)
    [nominal] = outcomes
    first = 0
    while True:
        try:
            some = steps.send(outcomes)
        except StopIteration as end:
            found: Found | None = end.value
            return found
        own = [i for i in range(len(some)) if _block(first + i) % part.of == part.number - 1]
        first += len(some)
        outcomes = [replace(nominal, key=candidate.key) for candidate in some]
        measured = yield [some[i] for i in own]
        for i, outcome in zip(own, measured, strict=True):
            outcomes[i] = outcome


def _block(candidate: int) -> int:
    """The number of the block of a candidate: those that run together in lanes."""
    return candidate // PLACES
