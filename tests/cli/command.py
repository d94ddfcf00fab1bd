"""The command as a user runs it: exit code, standard output, standard error."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from cosim.cli.check import MARK
from cosim.cli.commands import command

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "teleoperation.toml"
CALL = [sys.executable, "-c", "from cosim.cli import main; main()"]


def options_of(name: str) -> set[str]:
    """The options that the help of a command lists: ``--set``, ``--no-plot``."""
    done = subprocess.run([*CALL, name, "--help"], capture_output=True, text=True, check=True)
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", done.stdout))


@dataclass(frozen=True)
class Done:
    """Results of a command."""

    code: int
    out: str
    err: str
    checked: tuple[str, ...] = ()  # lines of the check before a run, which are not in `err`

    @staticmethod
    def of(code: int, out: str, err: str) -> Done:
        """A command that ended with `code`, and what it said."""
        lines = err.splitlines(keepends=True)
        checked = tuple(x.strip() for x in lines if x.startswith(MARK))
        return Done(code, out, "".join(x for x in lines if not x.startswith(MARK)), checked)


@dataclass(frozen=True)
class Command:
    """``cosim`` in this process: everything but a new interpreter."""

    patch: pytest.MonkeyPatch
    capture: pytest.CaptureFixture[str]

    def __call__(self, *arguments: str | Path) -> Done:
        self.patch.setattr(sys, "argv", ["cosim", *map(str, arguments)])
        self.patch.setattr(sys, "path", list(sys.path))
        self.capture.readouterr()
        try:
            command()
            code: int | str | None = 0
        except SystemExit as end:
            code = end.code
        assert code is None or isinstance(code, int)
        return Done.of(code or 0, *self.capture.readouterr())

    def refused(self, *arguments: str | Path, code: int = 2) -> str:
        """The one sentence of a command that fails."""
        done = self(*arguments)
        assert done.code == code, done
        assert done.err.startswith("error: ")
        assert "Traceback" not in done.err
        return done.err.removeprefix("error: ").strip()


def started(*arguments: str | Path, cwd: Path) -> subprocess.Popen[str]:
    """``cosim`` in a process of its own, as the console script starts it."""
    return subprocess.Popen(
        [*CALL, *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_heard,
    )


def _heard() -> None:
    """Signals act although these tests run under nohup, or in the background of a script."""
    for number in (signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)


def finished(*arguments: str | Path, cwd: Path, seconds: float = 120.0) -> Done:
    """The same, waited for; it is killed after so many seconds."""
    process = started(*arguments, cwd=cwd)
    try:
        out, err = process.communicate(timeout=seconds)
    finally:
        process.kill()  # nothing, where it has ended
    return Done.of(process.returncode, out, err)
