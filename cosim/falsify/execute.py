"""A whole falsification: the search, the shrinking, and the run of what is left, in a folder."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.base.processes import Opened
from cosim.engine.simulate import versions
from cosim.falsify.evaluation import Problem
from cosim.falsify.families import Space
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.part_search import search_part
from cosim.falsify.paths import Candidate
from cosim.falsify.problem import problem_of
from cosim.falsify.rounds import perform
from cosim.falsify.search import FAMILIES, Account, Budget, Found, search
from cosim.falsify.shrinking import Shrinking
from cosim.record.folder import SUMS, held_folder
from cosim.study import store as stores
from cosim.study.parts import StudyPart, missing, refuse_other_part, take_journals
from cosim.study.runner import claim

#: Runs of the shrinking, at most; more if the search had more.
SHRINKING = 1000


@dataclass(slots=True)
class Falsification:
    """The state of a search, during it and at its end.

    `found`: the candidate that violates a requirement, None: there is none so far; `shrinking`: the
    way from it to a small one; `nominal`: the outcome of the nominal network. `absent`: the parts
    that were not among those that were put together, as text.
    """

    problem: Problem
    account: Account = field(default_factory=Account)
    found: Found | None = None
    shrinking: Shrinking | None = None
    absent: str = ""

    @property
    def small(self) -> Candidate | None:
        """The smallest candidate that fails, so far."""
        shrinking = self.shrinking
        return None if shrinking is None else shrinking.trials.candidate(shrinking.now)

    @property
    def nominal(self) -> CandidateOutcome | None:
        """The outcome of the nominal network, once it is there."""
        return self.account.nominal

    def steps(
        self, space: Space, budget: Budget, part: StudyPart | None
    ) -> Generator[list[Candidate], list[CandidateOutcome]]:
        """The rounds of the search, and of the shrinking of what it finds; or those of a part."""
        if part is not None:
            self.found = yield from search_part(space, budget, self.account, part)
            return
        self.found = yield from search(space, budget, self.account)
        if self.found is not None:
            limit = max(SHRINKING, budget.runs)
            self.shrinking = Shrinking(self.problem, self.found, limit)
            yield from self.shrinking.shrink()


@dataclass(frozen=True, slots=True)
class Watcher:
    """Observer of a search: `begun` once, `noted` with numbers of runs, `stopping` after Ctrl-C."""

    begun: Callable[[Falsification], None] = lambda falsification: None
    noted: Callable[[int], None] = lambda n: None
    stopping: Callable[[], None] = lambda: None


@dataclass(frozen=True, slots=True)
class SearchExtent:
    """The candidates that a call runs: those that are not in its folder, or with `force` all.

    `part`: only those of this part; `taken`: folders of parts, whose candidates are not run again.
    """

    force: bool = False
    part: StudyPart | None = None
    taken: tuple[Path, ...] = ()


def falsify(
    path: Path, settings: Sequence[str], folder: Path, opened: Opened, budget: Budget,
    watcher: Watcher = Watcher(), extent: SearchExtent = SearchExtent(),
) -> Falsification:  # fmt: skip
    """Search the smallest network that breaks the scenario in a file.

    What was run stays in `folder`, so that the same call continues where it was. Raises
    ScenarioError for a scenario that cannot be searched, and a folder of something else; RunError
    if the folder cannot be written; KeyboardInterrupt once active runs have ended, after which
    `watcher` has what there is.
    """
    problem, given = problem_of(path, settings)
    families = budget.families or given.families
    for name in families:
        if name not in FAMILIES:
            raise ScenarioError(unknown(name, FAMILIES, "family"), f"{path} at falsify.families")
    budget = replace(budget, families=tuple(families))
    part, state = extent.part, Falsification(problem)
    same: dict[str, Any] = {"problem": problem.name[:12], "seed": budget.seed}
    divided = {**same, "runs": budget.runs}
    rows, parts = take_journals(extent.taken, divided)
    state.absent = missing(parts)
    with held_folder(folder):
        there = stores.read_state(folder)
        again = extent.force and bool(there)
        refuse_other_part(folder, there, part)
        facts = {"scenario": str(path), **(divided if part else same)}
        if again:
            (folder / stores.JOURNAL).unlink(missing_ok=True)
        if again or claim(folder, "falsification", facts):
            own = {"part": part.as_data()} if part else {}
            stores.write_state(folder, {**facts, **own, "versions": versions()})
        (folder / SUMS).unlink(missing_ok=True)  # of the files as they were
        _keep(folder / stores.JOURNAL, rows)
        watcher.begun(state)
        steps = state.steps(Space(problem, budget.seed), budget, part)
        perform(steps, problem, opened, folder / stores.JOURNAL, watcher.noted, watcher.stopping)
    return state


def _keep(journal: Path, rows: Mapping[str, stores.Record]) -> None:
    """Put rows of parts behind those of a journal. Raises RunError if it cannot be written."""
    if rows:
        kept = stores.ResultJournal(journal)
        try:
            for row in rows.values():
                kept.append(row)
        finally:
            kept.close()
