"""A comparison in parts: its runs divided among independent calls, and put together.

A result is a function of its task, so parts are made in any order, anywhere, and again
(:mod:`cosim.study.parts`). Part k of n has every n-th task from the k-th on; its results stay in
the journal of its folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TypeAlias

from cosim.base.errors import RunError
from cosim.comparison.comparison import perform
from cosim.comparison.kept import KeptResults
from cosim.comparison.measure import Task
from cosim.comparison.port_columns import PortTask
from cosim.study import store as stores
from cosim.study.parts import StudyPart, missing, missing_runs, take_journals
from cosim.study.runner import Observer

#: All tasks of a comparison by the names of their results, which are kept there.
Listed: TypeAlias = Callable[[KeptResults], dict[str, Task | PortTask]]


def run_part(
    listed: Listed, part: StudyPart, folder: Path, kept: KeptResults, jobs: int, observer: Observer
) -> int:
    """Run the tasks of a part, but for those whose results are `kept`; the number of its tasks.

    `folder`: where it is noted which part this is. Raises RunError if it cannot be written.
    """
    made = listed(kept)
    stores.write_state(folder, {**_facts(made), "part": part.as_data()})
    names = part.of_runs(list(made))
    perform({name: task for name, task in made.items() if name in names}, kept, jobs, observer)
    return len(names)


def merged(listed: Listed, same: str, folders: Sequence[Path]) -> KeptResults:
    """The results of parts, in memory.

    `same`: as of :class:`KeptResults`. Raises ScenarioError for folders that are no parts of this
    comparison, RunError with the missing parts if there are runs without a result.
    """
    kept = KeptResults(None, same)
    made = listed(kept)
    rows, parts = take_journals(folders, _facts(made))
    kept.take(rows, folders)
    if left := len(made.keys() - kept.done):
        raise RunError(missing_runs(left, missing(parts)))
    return kept


def _facts(names: Iterable[str]) -> dict[str, str]:
    """A name for the comparison of all these results, by which its parts are known."""
    return {"comparison": sha256(" ".join(names).encode()).hexdigest()[:12]}
