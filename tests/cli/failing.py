"""Runs `cosim` many times, each with another call of the system failing; see ``faulty.c``.

A program of its own, started with ``faulty.c`` preloaded: it imports once and forks for each case.
Standard input has a line of JSON a case, {"at", "errno", "keep", "root", "arguments"}; standard
output a line each, {"code", "said", "out"}. The first case is one in which nothing fails: its
answer has the number of `calls` too, and what it imports, this process imports as well.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

from cosim.cli.commands import command

#: s; a command that takes longer hangs.
PATIENCE = 120
OURS = ("bridge.", "cosim.", "fmus.")


def attempt(case: dict[str, Any]) -> dict[str, Any]:
    """One command in a child; its exit code and what it said."""
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as out:
        child = os.fork()
        if child == 0:
            _child(case, said.fileno(), out.fileno())
        _, status = os.waitpid(child, 0)
        texts = []
        for file in (said, out):
            file.seek(0)
            texts.append(file.read().decode())
    return {"code": os.waitstatus_to_exitcode(status), "said": texts[0], "out": texts[1]}


def _child(case: dict[str, Any], said: int, out: int) -> None:
    code = 99
    try:
        signal.alarm(PATIENCE)
        os.dup2(out, 1)
        os.dup2(said, 2)
        sys.argv = ["cosim", *map(str, case["arguments"])]
        os.environ |= {"FAULT_AT": str(case["at"]), "FAULT_ERRNO": str(case["errno"])}
        os.environ |= {"FAULT_KEEP": "1"} if case["keep"] else {}
        os.environ |= {"FAULT_ROOT": str(case["root"]), "TMPDIR": str(case["root"])}
        tempfile.tempdir = None
        try:
            command()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        except BaseException:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        if case["at"] == 0:
            calls = ctypes.CDLL(None).fault_calls()
            Path(case["root"], "calls").write_text(f"{calls}\n" + "\n".join(sys.modules))
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def main() -> None:
    """A line in, a line out."""
    for line in sys.stdin:
        given = json.loads(line)
        Path(given["root"]).mkdir(parents=True, exist_ok=True)
        done = attempt(given)
        if given["at"] == 0:
            calls, *modules = Path(given["root"], "calls").read_text().split()
            done["calls"] = int(calls)
            for name in modules:
                if name.startswith(OURS):
                    importlib.import_module(name)
        print(json.dumps(done), flush=True)


if __name__ == "__main__":
    main()
