"""``cosim sweep``: many runs of one scenario, on all cores or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.convert import Struct
from cosim.cli.options import (
    PROCESSORS,
    Folders,
    Jobs,
    PartOptions,
    Plot,
    Png,
    ResultOptions,
    Strict,
)

if TYPE_CHECKING:
    from cosim.base.processes import Opened
    from cosim.study.runner import Observer, PlannedRuns
    from cosim.study.study import Study
    from cosim.study.table import SweepTable

#: Seconds between two lines of progress where there is no terminal.
_EVERY = 10.0


class SweepOptions(Struct, frozen=True):
    """The runs that are made now, their workers, and what is made of the table."""

    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="runs/STUDY")
    ] = None
    jobs: Jobs = PROCESSORS
    workers: Annotated[str, typer.Option(help="Kind of local workers: processes or threads.")] = (
        "processes"
    )
    scheduler: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Use the workers of this Dask scheduler.")
    ] = ""
    resume: Annotated[bool, typer.Option("--resume", help="Continue the study in the folder.")] = (
        False
    )
    retry: Annotated[bool, typer.Option("--retry", help="Resume and repeat failed runs.")] = False
    force: Annotated[
        bool, typer.Option("--force", help="Resume even if the scenario has changed.")
    ] = False
    limit: Annotated[
        int | None, typer.Option(min=0, help="Maximum number of runs for this call.")
    ] = None
    plot: Plot = True
    png: Png = False
    strict: Strict = False

    def opened(self) -> Opened:
        """The workers. Raises ScenarioError for a kind that there is not."""
        from functools import partial

        from cosim.base.errors import ScenarioError
        from cosim.base.processes import processes
        from cosim.study import workers

        if self.scheduler:
            return partial(workers.cluster, self.scheduler)
        if self.workers not in ("processes", "threads"):
            raise ScenarioError(f"--workers {self.workers!r}: expected processes or threads")
        return partial(processes if self.workers == "processes" else workers.threads, self.jobs)


def sweep(
    study: Annotated[Path, typer.Argument(help="Study file (.toml).")],
    options: SweepOptions,
    parts: PartOptions,
    result: ResultOptions,
    folders: Folders = None,
) -> None:
    """Run a parameter study: simulate every point; write a table and a report. Resumable."""
    from cosim.cli.check import report_unconnected_inputs
    from cosim.record import seal
    from cosim.study import execute, summary
    from cosim.study.parts import folder_of
    from cosim.study.study import load_study

    part = parts.asked("cosim sweep", folders or [])
    loaded = load_study(study)
    folder = options.out or Path("runs") / loaded.path.stem
    if part and options.out is None:
        folder = folder_of(part, folder)
    if parts.merge:
        _merge(loaded, folders or [], folder, options, result)
        return
    opened, strict = options.opened(), options.strict
    with watched(result.quiet, folder, loaded.title) as observer:
        table = execute.sweep(
            loaded,
            folder,
            opened,
            execute.Extent(options.resume, options.retry, options.force, options.limit, part),
            observer,
            lambda p: report_unconnected_inputs([p], strict=strict, quiet=result.quiet),
        )
    for line in _written(loaded, table, folder, options):
        result.say(line)
    seal(folder, anew=True)
    result.save("sweep", {"folder": str(folder), **summary.as_data(table)})
    summary.refuse_lost_runs(table)


def _merge(
    study: Study, folders: list[Path], folder: Path, options: SweepOptions, result: ResultOptions
) -> None:
    """Put parts together; the exit code is 1 if runs are missing."""
    from cosim.cli.check import report_unconnected_inputs
    from cosim.record import seal
    from cosim.study import execute, summary
    from cosim.study.parts import missing_runs

    table, missing = execute.merge(
        study, folders, folder, execute.Extent(resume=options.resume, force=options.force),
        lambda p: report_unconnected_inputs([p], strict=options.strict, quiet=result.quiet),
    )  # fmt: skip
    for line in _written(study, table, folder, options):
        result.say(line)
    seal(folder, anew=True)
    result.save("sweep", {"folder": str(folder), **summary.as_data(table)})
    summary.refuse_lost_runs(table)
    if left := table.points - len(table.records):
        typer.echo(missing_runs(left, missing), err=True)
        raise typer.Exit(1)


def _written(study: Study, table: SweepTable, folder: Path, wanted: SweepOptions) -> Iterator[str]:
    """Write table, report and figures; the result in lines, with the path of each file."""
    from cosim.cli.summary import this_command
    from cosim.measure.metric_result import summary_line
    from cosim.study import boundary, page, summary

    yield from summary.lines(table)
    yield from boundary.lines(study, table)
    for path in summary.write(table, folder):
        yield summary_line("table", str(path))
    if (places := boundary.write(study, table, folder)) is not None:
        yield summary_line("boundary", str(places))
    if wanted.plot:
        yield summary_line("report", str(page.write(table, study, folder, this_command())))
    if wanted.png:
        from cosim.study import boundary_figure, figures

        for path in (
            *boundary_figure.draw_boundary(study, table, folder),
            *figures.draw_all(study, table, folder),
        ):
            yield summary_line("figure", str(path))


# ---- the progress of many runs ------------------------------------------------------------------


@contextmanager
def watched(
    quiet: bool, folder: Path, title: str, noun: str = "points", again: str = "--resume"
) -> Iterator[Observer]:
    """An observer that shows how many runs in `folder` are done; `noun`: what they are called.

    Where they are interrupted, the command ends with the number of the finished ones, and `again`:
    how to continue.
    """
    from cosim.base.interrupts import exit_code
    from cosim.study.runner import Observer

    with _progress(quiet) as progress:
        try:
            yield Observer(lambda b: progress.begin(b, title, noun), progress.done, _stopping)
        except KeyboardInterrupt:
            done = f"{progress.count} more runs are in {folder}"
            typer.echo(f"interrupted; {done}; continue with {again}", err=True)
            raise typer.Exit(exit_code()) from None


def _stopping() -> None:
    """Report that the first Ctrl-C was received."""
    typer.echo("stopping after the current runs (press Ctrl-C again to stop at once)", err=True)


class _Progress:
    """Counts rows, and passes (done, all, seconds since the start, failed) to `show`.

    `start` is called when the first row may arrive, after all other output before it.
    """

    def __init__(
        self,
        show: Callable[[int, int, float, int], None],
        quiet: bool,
        start: Callable[[], None] = lambda: None,
    ) -> None:
        from cosim.base.clock import stopwatch

        self.count, self._failed, self._all, self._quiet = 0, 0, 0, quiet
        self._show, self._watch, self._start = show, stopwatch(), start

    def begin(self, begun: PlannedRuns, title: str, noun: str) -> None:
        """Print the planned work; `noun`: the name of its items."""
        from cosim.base.clock import stopwatch

        self._all, self._watch = begun.to_run, stopwatch()
        if self._quiet:
            return
        typer.echo(title)
        same = begun.points - begun.runs
        text = f"{begun.points} {noun}" + (f", {same} of them twice" if same else "")
        text += f"; {begun.found} there already" if begun.found else ""
        text += f", {begun.retried} of them failed" if begun.retried else ""
        typer.echo(f"{text}; {begun.to_run} to run")
        if begun.changed:
            typer.echo(
                f"the study has changed: {begun.foreign_rows} rows in this folder are no longer "
                "part of it"
            )
        self._start()

    def done(self, row: Any) -> None:
        """Count a row."""
        self.count += 1
        self._failed += bool(row.reason)
        self._show(self.count, self._all, self._watch(), self._failed)


@contextmanager
def _progress(quiet: bool) -> Iterator[_Progress]:
    """A bar on a terminal's standard error; a line now and then elsewhere; nothing when quiet."""
    import sys

    if quiet:
        yield _Progress(lambda *_: None, quiet)
        return
    if not sys.stderr.isatty():
        yield _Progress(_Lines(), quiet)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    text = TextColumn("{task.fields[rate]}")
    columns = (BarColumn(), MofNCompleteColumn(), text, TimeElapsedColumn(), TimeRemainingColumn())
    bar = Bar(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("runs", rate="", total=None)

    def show(n: int, all_: int, seconds: float, failed: int) -> None:
        bar.update(task, completed=n, total=all_, rate=_rate(n, seconds, failed))

    try:
        yield _Progress(show, quiet, bar.start)
    finally:
        bar.stop()


class _Lines:
    """A line every ten seconds, and at the end."""

    def __init__(self) -> None:
        self._last = 0.0

    def __call__(self, n: int, all_: int, seconds: float, failed: int) -> None:
        if n < all_ and seconds - self._last < _EVERY:
            return
        self._last = seconds
        left = f", {seconds / n * (all_ - n):.0f} s to go" if n < all_ else f" in {seconds:.0f} s"
        typer.echo(f"{n}/{all_} runs{left}, {_rate(n, seconds, failed)}", err=True)


def _rate(n: int, seconds: float, failed: int) -> str:
    rate = f"{n / seconds:.3g} runs/s" if seconds > 0 else ""
    return rate + (f", {failed} failed" if failed else "")
