"""Runs `cosim` many times, each with another call of the system failing; see ``faulty.c``.

A program of its own, started with ``faulty.c`` preloaded: it imports once and forks for each case,
and for each node of a case. Standard input has a line of JSON a case, as :class:`Case` of
``faulted.py``; standard output a line each, {"code", "said", "out", "wrong"}, wrong: what is not
as it has to be, as text. The first case is one in which nothing fails: what the others record is
compared with it. Its answer has the number of `calls` of each process besides, and what these
processes import, this one imports as well.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from subprocess import PIPE, TimeoutExpired
from types import SimpleNamespace
from typing import Any

import bridge.node.process
import bridge.node.start
from cosim.cli.commands import command
from tests.children import FAILED, fork
from tests.cli.faulted import Case
from tests.cli.forked import Forked, calls, fails
from tests.cli.outcomes import judge

#: s; a command that takes longer hangs.
PATIENCE = 120
OURS = ("bridge.", "cosim.", "fmus.", "zenoh")


def attempt(case: Case) -> dict[str, Any]:
    """One command in a child; its exit code and what it said."""
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as out:
        child = fork(lambda: _child(case, said.fileno(), out.fileno()))
        _, status = os.waitpid(child, 0)
        texts = []
        for file in (said, out):
            file.seek(0)
            texts.append(file.read().decode())
    return {"code": os.waitstatus_to_exitcode(status), "said": texts[0], "out": texts[1]}


def _child(case: Case, said: int, out: int) -> int:
    code = FAILED
    signal.alarm(PATIENCE)
    os.dup2(out, 1)
    os.dup2(said, 2)
    sys.argv = ["cosim", *case.arguments]
    os.environ |= {"FAULT_ERRNO": str(case.errno)} | ({"FAULT_KEEP": "1"} if case.keep else {})
    os.environ |= {"FAULT_ROOT": f"{case.root}/", "TMPDIR": case.root}
    tempfile.tempdir = None
    Forked.at = {case.who: case.at}
    node = SimpleNamespace(Popen=Forked, PIPE=PIPE, TimeoutExpired=TimeoutExpired)
    bridge.node.process.subprocess = node  # type: ignore[attr-defined]
    fails(Forked.at.get("", 0))
    try:
        command()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
    if case.at == 0:
        calls(Path(case.root, ".calls"))
    return code


def answer(case: Case) -> dict[str, Any]:
    """The result of a case."""
    found = attempt(case)
    try:
        judge(case.here, found, Path(case.whole) if case.whole else None)
        assert case.at > 0 or found["code"] == 0, found
        wrong = ""
    except Exception as error:
        wrong = f"{type(error).__name__}: {error}"
    return found | {"wrong": wrong} | ({} if case.at else {"calls": _learn(Path(case.root))})


def _learn(root: Path) -> Mapping[str, int]:
    """Import what the processes of the first case have imported; the calls of each."""
    found = {}
    for path in root.glob("*.calls"):
        text, *modules = path.read_text().split()
        found[path.name.removesuffix(".calls")] = int(text)
        for name in modules:
            if name.startswith(OURS):
                importlib.import_module(name)
    return found


def main() -> None:
    """A line in, a line out."""
    for line in sys.stdin:
        case = Case(**json.loads(line))
        case.here.parent.mkdir(parents=True, exist_ok=True)
        print(json.dumps(answer(case)), flush=True)


if __name__ == "__main__":
    main()
