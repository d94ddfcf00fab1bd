"""Rounds of candidates, spread over workers; their outcomes kept, so that a search is resumable.

A search (:mod:`cosim.falsify.search`) yields rounds. Candidates whose outcome is in the journal are
not run again, so a search that was killed begins again and soon is where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar, final

from cosim.base.copies import asdict
from cosim.base.errors import RunError
from cosim.base.processes import NOTHING_YET, Opened, Pool, spread
from cosim.falsify.evaluation import Problem, run_candidates
from cosim.falsify.judge import CandidateOutcome, Margin
from cosim.falsify.paths import Candidate
from cosim.study.batch import PLACES
from cosim.study.runner import interruptible
from cosim.study.store import Record, ResultJournal
from cosim.study.tasks import MOST, SECONDS

T = TypeVar("T")
#: What yields rounds of candidates, gets their outcomes, and has a result.
Search = Generator[list[Candidate], list[CandidateOutcome], T]


@final
class Rounds(Generic[T], Iterator[tuple[Candidate, ...]]):
    """The rounds of a search, in tasks; empty while results are awaited.

    `known`: outcomes that are there already; `over`: the search has come to its end, with `result`.
    """

    def __init__(self, search: Search[T], known: dict[str, CandidateOutcome]) -> None:
        self._search, self._known = search, known
        self._pool: Pool | None = None
        self._wanted = PLACES
        self._queue: list[Candidate] = []
        self._round: list[Candidate] = []
        self.result: T | None = None
        self.over = False
        self._advance(begun=False)

    def use(self, pool: Pool) -> None:
        """Tasks are for these workers."""
        self._pool = pool

    def note(self, outcomes: Sequence[CandidateOutcome]) -> None:
        """Take the results of a task."""
        mean = sum(x.wall for x in outcomes) / len(outcomes)
        self._wanted = max(PLACES, min(MOST, int(SECONDS / mean)) if mean > 0 else MOST)
        for outcome in outcomes:
            self._known[outcome.key] = outcome

    def __next__(self) -> tuple[Candidate, ...]:
        if not self._queue and not self.over:
            if not all(c.key in self._known for c in self._round):
                return NOTHING_YET
            self._advance(begun=True)
        if self.over:
            raise StopIteration
        slots = self._pool.slots if self._pool else 1
        size = max(1, min(self._wanted, -(-len(self._queue) // slots)))
        task, self._queue = tuple(self._queue[:size]), self._queue[size:]
        return task

    def _advance(self, *, begun: bool) -> None:
        """Go on with rounds, as long as all their results are there."""
        try:
            while not self._queue:
                if begun:
                    self._round = self._search.send([self._known[c.key] for c in self._round])
                else:
                    self._round, begun = next(self._search), True
                missing = {c.key: c for c in self._round if c.key not in self._known}
                self._queue = list(missing.values())
        except StopIteration as end:
            self.result, self.over, self._round = end.value, True, []


def perform(
    search: Search[T],
    problem: Problem,
    opened: Opened,
    journal: Path,
    noted: Callable[[int], None] = lambda n: None,
    stopping: Callable[[], None] = lambda: None,
) -> T:
    """The result of a search whose outcomes stay in `journal`; `noted` gets how many were run.

    `opened` opens the workers. Raises KeyboardInterrupt once active runs have ended, RunError if
    the journal cannot be written, and what a candidate raises that cannot be.
    """
    kept = ResultJournal(journal, lambda row: row.get("problem") == problem.name)
    try:
        rounds = Rounds(search, {key: _outcome(row) for key, row in kept.rows.items()})
        if not rounds.over:
            with interruptible(stopping) as stopped:
                for outcomes in _outcomes(rounds, problem, opened, stopped):
                    for outcome in outcomes:
                        kept.append(_record(outcome, problem))
                    rounds.note(outcomes)
                    noted(len(outcomes))
    finally:
        kept.close()
    if not rounds.over:
        raise RunError("the workers ended before the search")
    return rounds.result  # type: ignore[return-value]


def _outcomes(
    rounds: Rounds[T], problem: Problem, opened: Opened, stopped: Callable[[], bool]
) -> Iterator[Sequence[CandidateOutcome]]:
    """The outcomes of tasks; candidates of one that ends its worker are repeated one by one."""

    @contextmanager
    def known() -> Iterator[Pool]:
        with opened() as pool:
            rounds.use(pool)
            yield pool

    run = partial(run_candidates, problem)
    for task, result in spread(known, run, rounds, stopped):
        if not isinstance(result, str):
            yield result
            continue
        for candidate in task:
            for _, alone in spread(opened, run, [(candidate,)], stopped):
                died = [CandidateOutcome(candidate.key, {}, str(alone))]
                yield died if isinstance(alone, str) else alone


def _record(outcome: CandidateOutcome, problem: Problem) -> Record:
    found: dict[str, Any] = asdict(outcome)
    return {"run": found.pop("key"), "problem": problem.name, **found}


def _outcome(row: Record) -> CandidateOutcome:
    margins = {name: Margin(**margin) for name, margin in row["margins"].items()}
    return CandidateOutcome(row["run"], margins, row["reason"], row["stopped_at"], row["wall"])
