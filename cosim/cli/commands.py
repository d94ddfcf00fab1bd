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
from cosim.base.names import hint
from cosim.cli.overview import COMMANDS, overview

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
            if found := hint(cmd_name, COMMANDS):
                ctx.fail(f"no command {cmd_name!r}{found}")
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

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help of the program."""
        formatter.write(overview())


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
