"""``cosim monitor``: show a running or finished rehearsal, and export it to plotting tools."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import BusOptions
from cosim.base.convert import Struct, field
from cosim.base.interrupts import acknowledge, until_signal
from cosim.cli.options import drawn

if TYPE_CHECKING:
    from rich.text import Text

    from bridge.deployment.system import System
    from bridge.monitor.topics import Feed
    from bridge.monitor.view import View
    from bridge.recording.live_run import LiveRun

#: s between two views, two lines where there is no terminal, and two looks at a bus.
REFRESH, LINE, DRAIN = 0.2, 1.0, 0.05


class ViewOptions(Struct, frozen=True):
    """Views, files and servers of the files of a run."""

    once: Annotated[
        bool, typer.Option("--once", help="Print the current status once and exit.")
    ] = False
    mcap: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write an MCAP file (Foxglove, PlotJuggler)."),
    ] = None
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Serve Foxglove at this address, such as 127.0.0.1:8765."
        ),
    ] = None
    web: Annotated[
        int | None,
        typer.Option(
            metavar="PORT",
            min=0,
            max=65535,
            help="Serve a page for a browser of this machine at this port; 0: any free one.",
        ),
    ] = None
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", callback=drawn, help="Draw positions, torques, ages, lateness."
        ),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False


class ListenOptions(BusOptions, frozen=True):
    """The deployment of a run, and how to listen on its buses."""

    scenario: Annotated[
        Path | None, typer.Option(help="Scenario file. Default: the one recorded in the folder.")
    ] = None
    deploy: Annotated[
        str | None, typer.Option(help="Deployment. Default: the one recorded in the folder.")
    ] = None
    listen: Annotated[
        bool,
        typer.Option(
            "--listen",
            help="Listen on the buses of --scenario and --deploy instead of reading files.",
        ),
    ] = False
    connect: Annotated[
        list[str],
        typer.Option(
            metavar="ENDPOINT", help="Zenoh endpoint for --listen. Default: the deployment's."
        ),
    ] = field(default_factory=list)
    bus: Annotated[
        list[str],
        typer.Option(metavar="NAME", help="Bus to listen to (default: all). Requires --listen."),
    ] = field(default_factory=list)
    as_: Annotated[
        str, typer.Option("--as", help="Certificate to use for --listen, if TLS is enabled.")
    ] = "monitor"
    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="PATH=VALUE", help="Change a value, with --listen."),
    ] = field(default_factory=list)


def monitor(
    view: ViewOptions,
    listen: ListenOptions,
    run: Annotated[
        Path | None,
        typer.Argument(help="Run folder. Default: the most recent active run in runs/."),
    ] = None,
) -> None:
    """Show the status of a running or finished rehearsal (read-only).

    It reads the files that the nodes write, or with --listen, on any machine, the buses.
    Ctrl-C ends the view, not the run.
    """
    from bridge.recording.live_run import LiveRun, find_run, is_live

    if listen.listen:
        files = {f"--{key}": getattr(view, key) for key in ("mcap", "foxglove", "plot", "web")}
        _reject_file_options({**files, "a run folder": run})
        _listen(_system(listen), view.once, listen)
        return
    folder = run or find_run(Path("runs"))
    if is_live(folder):
        _behind()
    with ExitStack() as stack:
        watched = stack.enter_context(LiveRun.open(folder, listen.scenario, listen.deploy))
        feed = _feed(stack, watched, view)
        try:
            if view.web is None:
                _look(watched, feed, view.once)
            else:
                from bridge.monitor.web import serve

                serve(watched, view.web, lambda address: typer.echo(f"page             {address}"))
        except KeyboardInterrupt:
            acknowledge()
            typer.echo(
                "monitor closed; the run continues" if watched.running else "monitor closed",
                err=True,
            )
        if view.plot is not None:
            from bridge.monitor.figure import draw

            typer.echo(f"figure           {draw(watched, view.plot)}")
    if view.mcap is not None:
        typer.echo(f"MCAP             {view.mcap}")


def _feed(stack: ExitStack, watched: LiveRun, wanted: ViewOptions) -> Feed:
    from bridge.monitor.sinks import Foxglove, Mcap
    from bridge.monitor.topics import Feed, Sink

    sinks: list[Sink] = []
    if wanted.mcap is not None:
        sinks.append(stack.enter_context(Mcap(wanted.mcap, replace=wanted.force)))
    if wanted.foxglove is not None:
        sinks.append(stack.enter_context(Foxglove(wanted.foxglove)))
        typer.echo(f"Foxglove         ws://{wanted.foxglove}", err=True)
    return Feed(watched, sinks)


def _look(watched: LiveRun, feed: Feed, once: bool) -> None:
    """Until the run has ended, or once; then what has not been fed yet."""
    from bridge.monitor.snapshot import snapshot
    from bridge.monitor.view import view
    from cosim.base.clock import monotonic_ns, sleep

    if watched.running and not once:
        with _display() as show:
            while watched.running:
                now = monotonic_ns()
                show(view(snapshot(watched, now)), now)
                feed.new()
                sleep(REFRESH - (monotonic_ns() - now) * 1e-9)
    feed.new()
    _print(view(snapshot(watched, monotonic_ns())))


def _behind(*, wakes: bool = False) -> None:
    """Behind the nodes, also where they have no real-time priority.

    `wakes`: with every sample; no thread of theirs is interrupted for that (SCHED_BATCH).
    """
    if wakes and sys.platform == "linux":
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(10)


def _listen(system: System, once: bool, options: ListenOptions) -> None:
    """Listen on the buses until Ctrl-C; with `once`, for about a second after the last new node."""
    from bridge.monitor.listener import Listener
    from bridge.monitor.listener_view import view
    from bridge.monitor.messages import SPAN_NS
    from cosim.base.clock import monotonic_ns, sleep

    _behind(wakes=True)
    with (
        Listener(system, options.connect, options.as_, options.bus) as listener,
        until_signal(),
        ExitStack() as stack,
    ):
        show = None if once else stack.enter_context(_display())
        begun, shown = monotonic_ns(), 0
        while not once or monotonic_ns() < max(begun, listener.new_ns) + SPAN_NS * 6 // 5:
            now = monotonic_ns()
            listener.receive(now)
            if show is not None and now >= shown + round(REFRESH * 1e9):
                shown = now
                show(view(listener, now), now)
            sleep(DRAIN)
        listener.receive(now := monotonic_ns())
        _print(view(listener, now))


def _reject_file_options(said: Mapping[str, object]) -> None:
    """Refuse options that go with files only."""
    from cosim.base.errors import ScenarioError

    for name, value in said.items():
        if value is not None:
            raise ScenarioError(f"--listen neither reads nor writes files; expected no {name}")


def _system(options: ListenOptions) -> System:
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system
    from cosim.base.errors import ScenarioError

    if options.scenario is None:
        raise ScenarioError(
            "--listen needs --scenario, and --deploy for a deployment other than its usual one"
        )
    path = deployments.find(options.scenario, options.deploy or "")
    changes = [*options.set_, *options.settings(deployments.load(path))]
    return load_system(options.scenario, str(path), changes)


def _print(view: View) -> None:
    width = get_terminal_size().columns if sys.stdout.isatty() else 0
    for text, marked in view.lines(width):
        typer.secho(text, fg="red" if marked else None)


@contextmanager
def _display() -> Iterator[Callable[[View, int], None]]:
    """Show views: as tables on a terminal, otherwise as one line per second."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.live import Live

        console = Console()
        with Live(console=console, auto_refresh=False, screen=True) as live:
            yield lambda view, now: live.update(_text(view, console.width), refresh=True)
        return
    said = 0

    def say(view: View, now: int) -> None:
        nonlocal said
        if now >= said + round(LINE * 1e9):
            said = now
            typer.echo(view.line)

    yield say


def _text(view: View, width: int) -> Text:
    """For a terminal of `width` columns; one text, which costs a tenth of tables of rich."""
    from rich.text import Text

    return Text("\n", no_wrap=True).join(
        Text(text, style="bold red" if marked else "") for text, marked in view.lines(width)
    )
