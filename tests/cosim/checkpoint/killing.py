"""Kills commands at each change of a file, and compares what a resumed command leaves.

    python -m tests.cosim.checkpoint.killing FOLDER SCENARIO STAGE FIRST EACH

STAGE is "run", or "resume": of a run that was killed before. The command is killed (SIGKILL) before
the n-th change of a name or opening of a file in its run folder, n = FIRST, FIRST + EACH and so on.
Then it is resumed, or begun again where there is no checkpoint. The last line is JSON: the number
of kills, and the changes after which other bytes were left.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from cosim.base.errors import ScenarioError
from cosim.checkpoint import Resumption
from cosim.cli.commands import app
from cosim.record.sums import verify
from tests.children import fork
from tests.cosim.checkpoint.cuts import contents

CHANGES = {"open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree"}
RESUME = ["--resume", "kept", "--no-plot", "--csv"]
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def forked(work: Callable[[], int]) -> int:
    """The exit code of a process that does `work`; -9: it was killed."""
    return os.waitstatus_to_exitcode(os.waitpid(fork(work), 0)[1])


def command(arguments: list[str], kill: int = 0) -> Callable[[], int]:
    """A run of the command that is killed at the `kill`-th change; 0: at none."""

    def work() -> int:
        left = kill

        def watch(event: str, given: tuple[Any, ...]) -> None:
            nonlocal left
            if event not in CHANGES or "kept" not in str(given[0]):
                return
            if event == "open" and not (given[2] or 0) & WRITES:
                return
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        if kill:
            sys.addaudithook(watch)
        return CliRunner().invoke(app, ["run", *arguments]).exit_code

    return work


def completed(given: list[str]) -> int:
    """Resume the run, or begin it again where there is no checkpoint; the exit code."""
    try:
        Resumption.open(Path("kept"))
    except ScenarioError as error:
        if "the run is finished" not in str(error):
            return forked(command(given))
        for part in Path("kept").glob(".run-*.part.json"):
            part.unlink()  # the earlier run is whole, and the next --force deletes this, too
        return 0
    return forked(command(RESUME))


def main(folder: str, scenario: str, stage: str, first: int, each: int) -> None:
    os.chdir(folder)
    shared = [scenario, "--no-plot", "--csv"]
    assert forked(command([*shared, "--out", "whole"])) == 0
    whole = contents(Path("whole"))
    facts = json.loads(whole.pop("run.json"))
    del facts["command"]
    assert facts["requirements"]
    given = [*shared, "--out", "kept", "--force", "--checkpoint", "t=0.1 s"]
    kills, wrong = 0, []
    for n in range(first, 10_000, each):
        victim = given
        if stage == "resume":
            assert forked(command(given, 40)) == -9
            victim = RESUME
        code = forked(command(victim, n))
        if code != -9:
            assert code == 0, code
            break
        kills += 1
        code = completed(given)
        left = contents(Path("kept"))
        found = json.loads(left.pop("run.json"))
        del found["command"]
        if code or left != whole or found != facts:
            wrong.append(n)
        verify("kept")
    print(json.dumps({"kills": kills, "wrong": wrong}))


if __name__ == "__main__":
    main(*sys.argv[1:4], *map(int, sys.argv[4:]))
