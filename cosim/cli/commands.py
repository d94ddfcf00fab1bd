"""All commands as one program. Errors become one sentence and an exit code; nothing else is caught.

Exit codes: 0 done, 1 a run stopped or a comparison failed, 2 bad input; ended by a signal: 130
(SIGINT), 143 (SIGTERM), 129 (SIGHUP).
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from typing import TextIO

import typer

from cosim.cli import (
    analyze,
    check,
    compare,
    export,
    info,
    new,
    recover,
    reproduce,
    run,
    show,
    sweep,
)
from cosim.cli.supervise import supervised
from cosim.errors import CosimError, FolderWarning
from cosim.interrupts import exit_code, terminated

app = typer.Typer(
    name="cosim",
    help="Co-simulation of controllers and FMU plants over links with real latency.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run.run)
app.command("show")(show.show)
app.command("info")(info.info)
app.command("reproduce")(reproduce.reproduce)
app.command("analyze")(analyze.analyze)
app.command("check")(check.check)
app.command("compare")(compare.compare)
app.command("sweep")(sweep.sweep)
app.command("export")(export.export)
app.command("new")(new.new)
app.command("recover")(recover.recover)

#: Commands of the bridge, which this package does not know: (module, function) by name.
BRIDGE = {
    "rehearse": ("bridge.cli.rehearse", "rehearse"),
    "node": ("bridge.cli.node", "node"),
    "replay": ("bridge.cli.replay", "replay"),
    "monitor": ("bridge.cli.monitor", "monitor"),
    "campaign": ("bridge.cli.campaign", "campaign"),
    "soak": ("bridge.cli.soak", "soak"),
    "diff": ("bridge.cli.diff", "diff"),
    "keys": ("bridge.cli.keys", "keys"),
    "ping": ("bridge.cli.ping", "ping"),
    "tell": ("bridge.cli.tell", "tell"),
}
for _name, (_module, _function) in BRIDGE.items():
    app.command(_name)(getattr(importlib.import_module(_module), _function))


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


def main() -> None:
    """Entry point of the console script: nearly every command loads FMUs, so all are supervised."""
    sys.exit(supervised(command))


def command() -> None:
    """The command in this process."""
    # The working directory is where a user's own modules are.
    sys.path.insert(0, os.getcwd())
    try:
        with warnings.catch_warnings(), terminated():
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
    except MemoryError:
        typer.echo("error: there is not enough memory for this", err=True)
        sys.exit(1)
    except OSError as error:
        typer.echo(f"error: {error.filename or 'the system'}: {error.strerror or error}", err=True)
        sys.exit(1)


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """What a reader has to say about a folder is one sentence, without the place in the code."""
    if issubclass(category, FolderWarning):
        typer.echo(f"note: {message}", err=True)
    else:
        typer.echo(warnings.formatwarning(message, category, filename, lineno, line), err=True)
