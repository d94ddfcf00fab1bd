"""Execution of a study: check the file, open the folder, run the missing points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.files import write_file
from cosim.base.names import unknown
from cosim.base.processes import Opened, Pool, spread
from cosim.engine.simulate import versions
from cosim.native import shared
from cosim.record.folder import SUMS, held_folder
from cosim.schedule.plan import Plan
from cosim.study import figures
from cosim.study import store as stores
from cosim.study.axes import Listed
from cosim.study.design import Point, count, points
from cosim.study.parts import STUDY, StudyPart, missing, refuse_other_part, take
from cosim.study.run_point import StudyRow, StudySetup, job, preview, run_points
from cosim.study.runner import (
    UNOBSERVED,
    Observer,
    PlannedRuns,
    fingerprint_of,
    interruptible,
    refuse_others,
)
from cosim.study.search import Search, record_side
from cosim.study.store import Store
from cosim.study.study import Study
from cosim.study.table import SweepTable
from cosim.study.tasks import Tasks

RUNS = "runs"


@dataclass(frozen=True, slots=True)
class Extent:
    """The runs of a study that are made now, at most `limit`.

    `resume`: those that the folder does not contain; `retry`: also those that failed there;
    `force`: even if the scenario has changed since. `part`: only those of this part.
    """

    resume: bool = False
    retry: bool = False
    force: bool = False
    limit: int | None = None
    part: StudyPart | None = None


def sweep(
    study: Study,
    folder: str | Path,
    opened: Opened,
    extent: Extent = Extent(),
    observer: Observer = UNOBSERVED,
    checked: Callable[[Plan], None] = lambda plan: None,
) -> SweepTable:
    """Execute the runs that `folder` does not contain; return the complete table.

    `opened` opens the workers (see :mod:`cosim.base.processes`). `checked` is called with the plan
    of the first run before the folder exists, and may raise CosimError. After a first Ctrl-C,
    KeyboardInterrupt is raised when the active runs have ended; after a second one, immediately.
    Raises CosimError for a study that cannot be run, and for a folder that contains runs, or whose
    scenario has changed, unless the extent allows it; never for a run that fails.
    """
    folder = Path(folder)
    total = count(study)
    shared.library()  # what is wrong with the installation is wrong with no run
    common = job(study, folder.resolve() / RUNS if study.keep == "trajectories" else None)
    plan, units = check(study, common)
    checked(plan)
    figures.check(study, [axis.name for axis in study.axes], units)
    fingerprint = fingerprint_of(study.scenario.read_bytes(), [plan])
    with held_folder(folder):
        changed = _claim(study, folder, fingerprint, extent)
        with Store(folder, units) as store:
            choose = _searched if study.boundary else _planned
            planned, tasks = choose(study, folder, fingerprint, store, extent)
            observer.begun(replace(planned, changed=changed))
            _run(opened, common, tasks, store, observer)
        every = tasks.asked if isinstance(tasks, Search) else points(study, fingerprint)
        return _table(study, folder, every, units, total)


def merge(
    study: Study,
    folders: Sequence[Path],
    folder: str | Path,
    extent: Extent = Extent(),
    checked: Callable[[Plan], None] = lambda plan: None,
) -> tuple[SweepTable, str]:
    """Put the rows of parts together in `folder`; return the table, and which parts are missing.

    The table has the bytes of that of one call. Nothing is run. Raises CosimError as
    :func:`sweep` does, and for folders that are no parts of this study.
    """
    folder = Path(folder)
    plan, units = check(study, job(study, None))
    checked(plan)
    fingerprint = fingerprint_of(study.scenario.read_bytes(), [plan])
    with held_folder(folder):
        _claim(study, folder, fingerprint, extent)
        parts = take(folders, folder, study.text, fingerprint)
        table = _table(study, folder, points(study, fingerprint), units, count(study))
    return table, missing(parts)


def _planned(
    study: Study, folder: Path, fingerprint: str, store: Store, extent: Extent
) -> tuple[PlannedRuns, Tasks]:
    """The points that are missing."""
    runs = dict.fromkeys(point.run for point in points(study, fingerprint))
    wanted = set(runs) if extent.part is None else extent.part.of_runs(list(runs))
    again = store.failed & wanted if extent.retry else set[str]()
    found = len(store.done & wanted)
    missing = wanted - (store.done - again)
    todo = len(missing) if extent.limit is None else min(extent.limit, len(missing))
    planned = PlannedRuns(
        count(study), len(wanted), found, todo, False, len(store.done) - found, len(again)
    )
    return planned, Tasks(islice(_missing(study, fingerprint, missing), todo), todo)


def _searched(
    study: Study, folder: Path, fingerprint: str, store: Store, extent: Extent
) -> tuple[PlannedRuns, Tasks]:
    """The points that follow from those that are there. Raises ScenarioError for a part of them."""
    assert study.boundary is not None
    if extent.part is not None:
        raise ScenarioError(
            "found [boundary], whose points follow from the results of others; expected a study "
            "whose points are known: this one runs on several hosts with --scheduler",
            study.place("boundary"),
        )
    store.flush()
    again = set(store.failed) if extent.retry else set[str]()
    known = {
        run: record_side(study.boundary, row)
        for run, row in stores.rows(folder).items()
        if run not in again
    }
    search = Search(study, fingerprint, known, extent.limit)
    others = len(store.done) - search.found - len(again)
    found = search.found + len(again)
    todo = search.left
    planned = PlannedRuns(search.total, search.total, found, todo, False, others, len(again))
    return planned, search


def _missing(study: Study, fingerprint: str, missing: set[str]) -> Iterator[Point]:
    """The points whose runs are missing, each once; they are taken out of the set."""
    for point in points(study, fingerprint):
        if point.run in missing:
            missing.remove(point.run)
            yield point


def _run(
    opened: Opened, common: StudySetup, tasks: Tasks, store: Store, observer: Observer
) -> None:
    if not tasks.left:
        return
    with interruptible(observer.stopping) as stopped:
        for row in _rows(opened, partial(run_points, common), tasks, stopped):
            store.append(row)
            tasks.note(row)
            observer.done(row)


def _rows(
    opened: Opened,
    run: Callable[[Sequence[Point]], Sequence[StudyRow]],
    tasks: Tasks,
    stopped: Callable[[], bool],
) -> Iterator[StudyRow]:
    """The rows of points, several in one call of `run`; a row without measures if a worker died.

    If a call ends its process, its points are repeated one by one.
    """

    @contextmanager
    def known() -> Iterator[Pool]:
        with opened() as pool:
            tasks.use(pool)
            yield pool

    for some, result in spread(known, run, tasks, stopped):
        if not isinstance(result, str):
            tasks.took(result)
            yield from result
        elif len(some) > 1:
            yield from _rows(opened, run, Tasks(some, len(some), alone=True), stopped)
        else:
            yield StudyRow(some[0].run, some[0].cells, some[0].settings, False, result)


def _table(
    study: Study, folder: Path, every: Iterable[Point], units: Mapping[str, str], total: int
) -> SweepTable:
    axes = tuple(axis.name for axis in study.axes)
    return SweepTable(axes, units, stores.records(folder, every, axes, list(units)), total)


# ---- before the first run -----------------------------------------------------------------------


def check(study: Study, common: StudySetup) -> tuple[Plan, dict[str, str]]:
    """The plan of the first run, and the unit of each measure.

    The first run is assembled, and one for each choice that is not just another number. Raises
    CosimError, ScenarioError with the place in the study.
    """
    first = next(points(study))
    said = ", ".join(f"{name} = {cell}" for name, cell in first.cells.items())
    with _at(f"{study.path} (first run: {said or 'the scenario as it is'})"):
        found = preview(common, first)
    if study.boundary is not None and study.boundary.of not in ("stable", *found[1]):
        known = ["stable", *found[1]]
        raise ScenarioError(
            unknown(study.boundary.of, known, "measure"), study.place("boundary.of")
        )
    for axis in study.axes:
        if isinstance(axis, Listed):
            for choice in axis.choices[1:]:
                if not isinstance(choice.cell, int | float) or isinstance(choice.cell, bool):
                    one = replace(axis, choices=(choice,))
                    axes = tuple(one if a is axis else a for a in study.axes)
                    with _at(f"{study.place('vary', axis.name)} ({choice.cell})"):
                        preview(common, next(points(replace(study, axes=axes))))
    return found


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Prefix errors in the block with the place."""
    try:
        yield
    except CosimError as error:
        raise ScenarioError(str(error), place) from error


def _claim(study: Study, folder: Path, fingerprint: str, extent: Extent) -> bool:
    """Take the folder: whether the study it was begun with was another. Raises ScenarioError."""
    state = stores.read_state(folder)
    refuse_others(folder, "sweep", state)
    refuse_other_part(folder, state, extent.part)
    if state and not (extent.resume or extent.retry):
        raise ScenarioError(
            "the folder already contains a sweep; use --resume to continue it", str(folder)
        )
    if state and state.get("fingerprint") != fingerprint and not extent.force:
        raise ScenarioError(
            f"{study.scenario}, or an FMU of it, has changed since the runs in this folder; "
            "choose another folder, or use --force to run it again (the old rows remain)",
            str(folder),
        )
    changed = bool(state) and _text(folder / STUDY) != study.text
    (folder / SUMS).unlink(missing_ok=True)  # of the files as they were
    write_file(folder / STUDY, study.text.encode())
    stores.write_state(
        folder,
        {
            "title": study.title,
            "scenario": str(study.scenario),
            "fingerprint": fingerprint,
            "versions": versions(),
            **({"part": extent.part.as_data()} if extent.part else {}),
        },
    )
    return changed


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
