"""The end of a program: errors become one sentence and an exit code; nothing else is caught.

Exit codes: 0 done, 1 a run stopped or a comparison failed, 2 bad input; ended by a signal: 130
(SIGINT), 143 (SIGTERM), 129 (SIGHUP).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any, NoReturn, TextIO

import typer
from typer.core import TyperGroup

from cosim.base.errors import CosimError, FolderWarning, RunError, ScenarioError, shortage
from cosim.base.interrupts import exit_code, has_come, hear_of_children, signals_as_interrupt
from cosim.base.streams import complete_output


class ProgramGroup(TyperGroup):
    """The commands of a program. Only what a command returns or raises of ours ends it."""

    def invoke(self, ctx: Any) -> Any:
        """Call the command. Raises RunError if a component or module calls `sys.exit`."""
        try:
            return super().invoke(ctx)
        except SystemExit as end:
            from cosim.fmi.failures import sentence  # needs NumPy

            raise RunError(f"a component or a module ended this command: {sentence(end)}") from end


def run_program(app: Callable[[], object]) -> NoReturn:
    """Call the program and exit; after a signal the exit code is that of the signal."""
    hear_of_children()
    try:
        code = _code(app)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    sys.exit(exit_code() if has_come() else complete_output(code))


def _code(app: Callable[[], object]) -> int:
    try:
        with warnings.catch_warnings(), signals_as_interrupt():
            warnings.simplefilter("once", FolderWarning)
            warnings.showwarning = _warn
            app()
    except CosimError as error:
        typer.echo(f"error: {_for_another_command(error) or error}", err=True)
        saved = vars(error).get("saved")
        if saved:
            typer.echo(
                f"recorded until then, and the last ticks of every signal: {saved}", err=True
            )
        return error.exit_code
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        return exit_code()
    except BrokenPipeError:
        return 1
    except Exception as error:
        if not (lacking := shortage(error)):
            raise
        typer.echo(f"error: {lacking}", err=True)
        return 1
    return 0


def _for_another_command(error: CosimError) -> str:
    """The sentence that a file is for another command, where bad input is of that kind; or ""."""
    from cosim.loading.file_kinds import misplaced

    return misplaced(sys.argv[1:]) if error.exit_code == ScenarioError.exit_code else ""


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
