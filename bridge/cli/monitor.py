"""``cosim monitor``: look at a rehearsal while it runs, or after it; hand it to plotting tools."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.text import Text

    from bridge.export import Feed
    from bridge.monitor import Snapshot
    from bridge.watched import Watched

#: s between two looks, and between two lines where there is no terminal.
REFRESH, LINE = 0.2, 1.0


def monitor(
    run: Annotated[
        Path | None,
        typer.Argument(help="Run folder; the newest in runs/ that goes on if not given."),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="Say how it is now, and end.")] = False,
    mcap: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write an MCAP file (Foxglove, PlotJuggler)."),
    ] = None,
    foxglove: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve Foxglove, like 127.0.0.1:8765.")
    ] = None,
    plotjuggler: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Send JSON by UDP, like 127.0.0.1:9870."),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw positions, torques, ages, lateness.")
    ] = None,
    scenario: Annotated[
        Path | None, typer.Option(help="Scenario, where the folder does not say it.")
    ] = None,
    deploy: Annotated[
        str | None, typer.Option(help="Deployment, where the folder does not say it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Look at a rehearsal that runs, without disturbing it, or at one that has ended.

    Reads the files its nodes write. Ctrl-C ends the view, not the run.
    """
    from bridge.watched import Watched, find_run, goes_on

    folder = run or find_run(Path("runs"))
    if sys.platform != "win32" and goes_on(folder):
        os.nice(10)  # behind the nodes, also where they have no real-time priority
    with ExitStack() as stack:
        watched = stack.enter_context(Watched.open(folder, scenario, deploy))
        feed = _feed(stack, watched, mcap, foxglove, plotjuggler, force)
        try:
            _look(watched, feed, once)
        except KeyboardInterrupt:
            typer.echo("left; the run goes on" if watched.running else "left", err=True)
        if plot is not None:
            from bridge.figure import draw

            typer.echo(f"figure           {draw(watched, plot)}")
    if mcap is not None:
        typer.echo(f"MCAP             {mcap}")


def _feed(
    stack: ExitStack,
    watched: Watched,
    mcap: Path | None,
    foxglove: str | None,
    plotjuggler: str | None,
    force: bool,
) -> Feed:
    from bridge.export import Feed, Sink
    from bridge.sinks import Foxglove, Mcap, Udp

    sinks: list[Sink] = []
    if mcap is not None:
        sinks.append(stack.enter_context(Mcap(mcap, replace=force)))
    if foxglove is not None:
        sinks.append(stack.enter_context(Foxglove(foxglove)))
        typer.echo(f"Foxglove         ws://{foxglove}", err=True)
    if plotjuggler is not None:
        sinks.append(stack.enter_context(Udp(plotjuggler)))
    return Feed(watched, sinks)


def _look(watched: Watched, feed: Feed, once: bool) -> None:
    """Until the run has ended, or once; then what has not been fed yet."""
    from bridge.monitor import snapshot
    from cosim.clock import monotonic_ns, sleep

    if watched.running and not once:
        with _display() as show:
            while watched.running:
                now = monotonic_ns()
                show(snapshot(watched, now), now)
                feed.new()
                sleep(REFRESH - (monotonic_ns() - now) * 1e-9)
    feed.new()
    for text, marked in _lines(snapshot(watched, monotonic_ns())):
        typer.secho(text, fg="red" if marked else None)


@contextmanager
def _display() -> Iterator[Callable[[Snapshot, int], None]]:
    """Shows snapshots: tables on a terminal, elsewhere a line a second."""
    from bridge.shown import line

    if sys.stdout.isatty():
        from rich.console import Console
        from rich.live import Live

        with Live(console=Console(), auto_refresh=False, screen=True) as live:
            yield lambda found, now: live.update(_text(found), refresh=True)
        return
    said = 0

    def say(found: Snapshot, now: int) -> None:
        nonlocal said
        if now >= said + round(LINE * 1e9):
            said = now
            typer.echo(line(found))

    yield say


def _lines(found: Snapshot) -> Iterator[tuple[str, bool]]:
    """Lines of text, and whether they want attention."""
    from bridge.shown import aligned, tables

    yield (
        f"t = {found.t:.2f} of {found.length:g} s; {'runs' if found.running else 'has ended'}",
        False,
    )
    for table in tables(found):
        yield "", False
        yield from aligned(table)


def _text(found: Snapshot) -> Text:
    """The same for a terminal; made of one text, which costs a tenth of tables of rich."""
    from rich.text import Text

    return Text("\n", no_wrap=True).join(
        Text(text, style="bold red" if marked else "") for text, marked in _lines(found)
    )
