"""``cosim falsify``: the smallest network that breaks a controller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct, field
from cosim.cli.options import (
    PROCESSORS,
    Folders,
    Jobs,
    PartOptions,
    ResultOptions,
    wall_seconds,
)

if TYPE_CHECKING:
    from cosim.falsify.execute import Falsification, Watcher
    from cosim.falsify.search import Budget

#: Seconds between two lines of progress where there is no terminal.
_EVERY = 10.0


class FalsifyOptions(Struct, frozen=True):
    """Options of the search: its length, its workers, its folder."""

    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
    ] = field(default_factory=list)
    time: Annotated[
        str, typer.Option(metavar="TIME", help='Search so long, e.g. "5 min"; then shrink.')
    ] = ""
    runs: Annotated[
        int | None, typer.Option(min=1, help="Runs of the search.", show_default="4000")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="Seed of all that is drawn.")] = 0
    jobs: Jobs = PROCESSORS
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the result.", show_default="runs/SCENARIO-falsified"),
    ] = None
    force: Annotated[
        bool, typer.Option("--force", help="Begin again, instead of continuing in the folder.")
    ] = False

    def budget(self, *, divided: bool = False) -> Budget:
        """The end of the search, `divided` into parts or not. Raises ScenarioError."""
        from cosim.base.clock import stopwatch
        from cosim.base.errors import ScenarioError
        from cosim.falsify.search import RUNS, Budget

        if not self.time:
            return Budget(self.runs or RUNS, seed=self.seed)
        if divided:
            raise ScenarioError(
                "found --time with parts, whose candidates do not depend on time; expected --runs",
                "cosim falsify",
            )
        seconds, watch = wall_seconds(self.time, "--time"), stopwatch()
        if not seconds > 0:
            raise ScenarioError(f"found {self.time}; expected a time of more than 0", "--time")
        return Budget(
            self.runs or RUNS, self.runs is None, (), lambda: watch() > seconds, self.seed
        )


def falsify(
    scenario: Annotated[Path, typer.Argument(help="Scenario (.toml) with requirements.")],
    options: FalsifyOptions,
    parts: PartOptions,
    result: ResultOptions,
    folders: Folders = None,
) -> None:
    """Search the smallest network that breaks a requirement; exit code 1: found, 0: none found.

    Within the bounds of [falsify], or of the links' own laws. The folder gets a scenario that
    stands alone, a report, commands for a real network, and a test. The same command continues
    where an earlier one was interrupted.
    """
    from functools import partial

    from cosim.base.interrupts import exit_code
    from cosim.base.processes import processes
    from cosim.falsify.execute import SearchExtent
    from cosim.falsify.execute import falsify as search
    from cosim.record import seal
    from cosim.study.parts import folder_of

    part = parts.asked("cosim falsify", folders or [])
    folder = Path("runs") / f"{scenario.stem}-falsified"
    folder = options.out or (folder_of(part, folder) if part else folder)
    budget = options.budget(divided=bool(part or parts.merge))
    extent = SearchExtent(options.force, part, tuple(folders or ()))
    with _watched(result.quiet) as (watcher, states):
        try:
            state = search(
                scenario, options.set_, folder, partial(processes, options.jobs), budget,
                watcher, extent,
            )  # fmt: skip
        except KeyboardInterrupt:
            if states and not part:
                _finish(states[0], scenario, folder, options, result, folders or [])
            typer.echo(f"interrupted; the same command continues in {folder}", err=True)
            raise typer.Exit(exit_code()) from None
    if part:
        seal(folder, anew=True)
        found = "no candidate" if state.found is None else f"{state.found.family} has one that"
        result.say(f"{part}: {found} fails; {folder}")
        result.save("falsify", {"folder": str(folder), "part": str(part)})
        return
    if state.absent:
        names = f"part{'s' * (',' in state.absent)} {state.absent}"
        typer.echo(f"{names} not found; the candidates were run now", err=True)
    _finish(state, scenario, folder, options, result, folders or [])
    if state.found is not None:
        raise typer.Exit(1)


def _finish(
    state: Falsification,
    scenario: Path,
    folder: Path,
    options: FalsifyOptions,
    result: ResultOptions,
    merged: Sequence[Path],
) -> None:
    """Print the result, and write its files."""
    from cosim.cli.options import write_json
    from cosim.cli.summary import this_command
    from cosim.falsify import artifacts, words
    from cosim.falsify.problem import document_of

    for what, text in words.lines(state):
        result.say(f"{what:<16} {text}")
    data = words.as_data(state)
    write_json(folder / "falsify.json", "falsify", data)
    if state.found is not None:
        document = document_of(scenario, options.set_)
        for what, path in artifacts.write(state, document, folder, this_command(merged)):
            result.say(f"{what:<16} {path}")
    result.save("falsify", {"folder": str(folder), **data})


# ---- progress -----------------------------------------------------------------------------------


@contextmanager
def _watched(quiet: bool) -> Iterator[tuple[Watcher, list[Falsification]]]:
    """An observer of the search, and what it has come to."""
    from cosim.falsify.execute import Watcher

    states: list[Falsification] = []
    with _shown(quiet) as show:
        yield Watcher(states.append, lambda n: show(states[0], n), _stopping), states


def _stopping() -> None:
    typer.echo("stopping after the current runs (press Ctrl-C again to stop at once)", err=True)


@contextmanager
def _shown(quiet: bool) -> Iterator[Callable[[Falsification, int], None]]:
    """Shows a line of progress: on a terminal's standard error, or now and then elsewhere."""
    import sys

    from cosim.base.clock import stopwatch

    watch, last, done = stopwatch(), [0.0], [0]
    if quiet:
        yield lambda state, n: None
        return
    if sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status("searching") as status:

            def update(state: Falsification, n: int) -> None:
                done[0] += n
                status.update(_progress(state, done[0], watch()))

            yield update
        return

    def line(state: Falsification, n: int) -> None:
        done[0] += n
        if watch() - last[0] >= _EVERY:
            last[0] = watch()
            typer.echo(_progress(state, done[0], last[0]), err=True)

    yield line


def _progress(state: Falsification, done: int, seconds: float) -> str:
    rate = f"{done / seconds:.3g} runs/s" if seconds > 0 else ""
    if state.shrinking is not None:
        n = len(state.shrinking.now.pieces)
        return f"{done} runs, {rate}, shrinking: {n} segment{'s' * (n != 1)}"
    family = next(reversed(state.account.runs), "nominal")
    least = f", least margin {100 * state.account.best:.3g} % of the nominal one"
    return f"{done} runs, {rate}, {family}{least if state.account.runs else ''}"
