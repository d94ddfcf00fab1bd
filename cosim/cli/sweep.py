"""``cosim sweep``: many runs of one scenario, on all cores or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.cli.options import Json, Plot, Quiet, Strict, write_json

if TYPE_CHECKING:
    from cosim.base.processes import Opened
    from cosim.study.run_point import StudyRow
    from cosim.study.runner import PlannedRuns

#: Seconds between two lines of progress where there is no terminal.
_EVERY = 10.0


def sweep(
    study: Annotated[Path, typer.Argument(help="Study file (.toml).")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results.", show_default="runs/STUDY")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of parallel runs.")] = os.cpu_count()
    or 1,
    workers: Annotated[
        str, typer.Option(help="Kind of local workers: processes or threads.")
    ] = "processes",
    scheduler: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Use the workers of this Dask scheduler.")
    ] = "",
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the study in the folder.")
    ] = False,
    retry: Annotated[bool, typer.Option("--retry", help="Resume and repeat failed runs.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Resume even if the scenario has changed.")
    ] = False,
    limit: Annotated[
        int | None, typer.Option(min=0, help="Maximum number of runs for this call.")
    ] = None,
    plot: Plot = True,
    strict: Strict = False,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a parameter study: simulate every point; write a table and figures. Resumable."""
    from cosim.cli.check import report_unconnected_inputs
    from cosim.cli.summary import this_command
    from cosim.record import seal
    from cosim.study import boundary, boundary_figure, execute, figures, page, summary
    from cosim.study.study import load_study

    loaded = load_study(study)
    folder = out or Path("runs") / loaded.path.stem
    opened = _workers(workers, jobs, scheduler)

    def say(text: str) -> None:
        if not quiet:
            typer.echo(text)

    with progress_of(quiet) as progress:
        try:
            table = execute.sweep(
                loaded, folder, opened, resume=resume, retry=retry, force=force, limit=limit,
                checked=lambda plan: report_unconnected_inputs([plan], strict=strict, quiet=quiet),
                begun=lambda b: progress.begin(b, loaded.title), done=progress.done,
                stopping=stopping,
            )  # fmt: skip
        except KeyboardInterrupt:
            raise interrupted(progress, folder, "--resume") from None
    for line in summary.lines(table):
        say(line)
    for line in boundary.lines(loaded, table):
        say(line)
    for path in summary.write(table, folder):
        say(f"{'table':<16} {path}")
    if (places := boundary.write(loaded, table, folder)) is not None:
        say(f"{'boundary':<16} {places}")
    if plot:
        say(f"{'report':<16} {page.write(table, loaded, folder, this_command())}")
        for path in [
            *boundary_figure.draw_boundary(loaded, table, folder),
            *figures.draw_all(loaded, table, folder),
        ]:
            say(f"{'figure':<16} {path}")
    seal(folder, anew=True)
    if json is not None:
        write_json(json, {"folder": str(folder), **summary.as_data(table)})
    summary.refuse_lost_runs(table)


def stopping() -> None:
    """Report that the first Ctrl-C was received."""
    typer.echo("stopping after the current runs (press Ctrl-C again to stop at once)", err=True)


def interrupted(progress: Progress, folder: Path, how: str) -> typer.Exit:
    """Report the finished runs and `how` to continue, at the end of the command."""
    from cosim.base.interrupts import exit_code

    done = f"{progress.count} more runs are in {folder}"
    typer.echo(f"interrupted; {done}; continue with {how}", err=True)
    return typer.Exit(exit_code())


def _workers(kind: str, jobs: int, scheduler: str) -> Opened:
    from functools import partial

    from cosim.base.errors import ScenarioError
    from cosim.base.processes import processes
    from cosim.study import workers

    if scheduler:
        return partial(workers.cluster, scheduler)
    if kind not in ("processes", "threads"):
        raise ScenarioError(f"--workers {kind!r}: expected processes or threads")
    return partial(processes if kind == "processes" else workers.threads, jobs)


class Progress:
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

    def begin(self, begun: PlannedRuns, title: str, noun: str = "points") -> None:
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

    def done(self, row: StudyRow) -> None:
        """Count a row."""
        self.count += 1
        self._failed += bool(row.reason)
        self._show(self.count, self._all, self._watch(), self._failed)


@contextmanager
def progress_of(quiet: bool) -> Iterator[Progress]:
    """A bar on a terminal's standard error; a line now and then elsewhere; nothing when quiet."""
    import sys

    if quiet:
        yield Progress(lambda *_: None, quiet)
        return
    if not sys.stderr.isatty():
        yield Progress(_Lines(), quiet)
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
        yield Progress(show, quiet, bar.start)
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
