"""All commands as one program. Errors become one sentence and an exit code; nothing else is caught.

Exit codes: 0 done, 1 a run stopped or a comparison failed, 2 bad input; ended by a signal: 130
(SIGINT), 143 (SIGTERM), 129 (SIGHUP).
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from typing import Any, TextIO, final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from cosim.base.errors import CosimError, FolderWarning, shortage
from cosim.base.interrupts import exit_code, signals_as_interrupt

#: Module and first line of help of every command, whose function has its name. Those of the bridge
#: are here by name only: this package does not know it.
COMMANDS: dict[str, tuple[str, str]] = {
    "run": (
        "cosim.cli.run",
        "Run a scenario; write trajectories, metadata, link tables and figures to a run folder.",
    ),
    "show": (
        "cosim.cli.show",
        "Print how a scenario runs: components, rates, order, and what every input samples.",
    ),
    "info": (
        "cosim.cli.info",
        "Print an FMU's variables, units, capabilities and platforms, and validate it.",
    ),
    "reproduce": (
        "cosim.cli.reproduce",
        "Reproduce the paper: run Sec. VII and Theorems 1-5, draw the figures, check all claims.",
    ),
    "analyze": (
        "cosim.cli.analyze",
        "Analyze a port: manipulability, felt damping and stiffness, and passivity.",
    ),
    "check": (
        "cosim.cli.check",
        "Check a scenario without running it: stability margins, links, wiring, predictions.",
    ),
    "compare": (
        "cosim.cli.compare",
        "Compare controllers: run each with every operator and link law, and print one table.",
    ),
    "delays": (
        "cosim.cli.delays",
        "List delays by name: presets of networks, and frozen traces with their SHA-256 sums.",
    ),
    "sweep": (
        "cosim.cli.sweep",
        "Run a parameter study: simulate every point; write a table and figures. Resumable.",
    ),
    "export": (
        "cosim.cli.export",
        "Write a scenario as an SSP that other tools run, or as one FMU that contains it.",
    ),
    "new": (
        "cosim.cli.new",
        "Write a controller in Python, a scenario it runs in, and a test.",
    ),
    "recover": (
        "cosim.cli.recover",
        "Complete a run folder after the run was killed or the disk was full.",
    ),
    "rehearse": (
        "bridge.cli.rehearse",
        "Run a scenario in real time, one process per node, on real buses; then check the run.",
    ),
    "node": (
        "bridge.cli.node",
        "Run one node of a deployment: configure it, wait for the start, run until the end.",
    ),
    "replay": (
        "bridge.cli.replay",
        "Recompute a recorded run offline, and compare every signal of every node.",
    ),
    "monitor": (
        "bridge.cli.monitor",
        "Show the status of a running or finished rehearsal (read-only).",
    ),
    "campaign": (
        "bridge.cli.campaign",
        "Run a rehearsal with each fault script of a campaign, and check each run.",
    ),
    "soak": (
        "bridge.cli.soak",
        "Run a soak test: many rehearsals with random faults, several at once.",
    ),
    "diff": (
        "bridge.cli.diff",
        "Compare two runs signal by signal, largest differences first, and print a verdict.",
    ),
    "keys": (
        "bridge.cli.keys",
        "Create a test authority and one certificate per node, for configs/zenoh/secure.json5.",
    ),
    "bus": (
        "bridge.cli.bus",
        "Serve a simulated CAN bus to python-can programs, socketcand clients and SocketCAN.",
    ),
    "ping": (
        "bridge.cli.ping",
        "Measure round-trip times between two nodes, and predict their effect on the controllers.",
    ),
    "tell": (
        "bridge.cli.tell",
        "Send a command or a query to the nodes of a deployment, and print their answers.",
    ),
}
_SETTINGS = {"help_option_names": ["-h", "--help"]}


@final
class _Commands(TyperGroup):
    """Commands that are imported when they are called: a list of them needs none."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, or None."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(COMMANDS[cmd_name][0])
        alone = typer.Typer(
            add_completion=False,
            pretty_exceptions_enable=False,
            rich_markup_mode=None,
            context_settings=_SETTINGS,
        )
        alone.command(cmd_name)(getattr(module, cmd_name))
        return get_command(alone)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """A line each."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])


app = typer.Typer(
    name="cosim",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=_SETTINGS,
)


def _version(wanted: bool) -> None:
    if wanted:
        from cosim import __version__

        typer.echo(f"cosim {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Co-simulation of controllers and FMU plants over links with real latency."""


def command() -> None:
    """The command in this process."""
    # The working directory is where a user's own modules are.
    sys.path.insert(0, os.getcwd())
    try:
        with warnings.catch_warnings(), signals_as_interrupt():
            warnings.simplefilter("once", FolderWarning)
            warnings.showwarning = _warn
            app()
    except CosimError as error:
        typer.echo(f"error: {error}", err=True)
        saved = vars(error).get("saved")
        if saved:
            typer.echo(
                f"recorded until then, and the last ticks of every signal: {saved}", err=True
            )
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        sys.exit(exit_code())
    except BrokenPipeError:
        sys.exit(1)
    except Exception as error:
        if not (lacking := shortage(error)):
            raise
        typer.echo(f"error: {lacking}", err=True)
        sys.exit(1)


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a reader's warning about a folder as one sentence, without the place in the code."""
    if issubclass(category, FolderWarning):
        typer.echo(f"note: {message}", err=True)
    else:
        typer.echo(warnings.formatwarning(message, category, filename, lineno, line), err=True)
