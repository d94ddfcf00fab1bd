"""Runs `cosim` many times, each with another call of the system failing; see ``faulty.c``.

A program of its own, started with ``faulty.c`` preloaded: it imports once and forks for each case.
Standard input has a line of JSON a case, {"at", "errno", "keep", "root", "arguments"}; standard
output a line each, {"code", "said"}.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy  # noqa: F401
import pyarrow.parquet  # noqa: F401

import cosim.simulate  # noqa: F401
from cosim.cli.commands import command


def attempt(case: dict[str, object]) -> dict[str, object]:
    """One command in a child; its exit code and what it said on standard error."""
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            _child(case, said.fileno())
        _, status = os.waitpid(child, 0)
        said.seek(0)
        text = said.read().decode()
    return {"code": os.waitstatus_to_exitcode(status), "said": text}


def _child(case: dict[str, object], said: int) -> None:
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(said, 2)
        sys.argv = ["cosim", *map(str, case["arguments"])]  # type: ignore[call-overload]
        os.environ |= {"FAULT_AT": str(case["at"]), "FAULT_ERRNO": str(case["errno"])}
        os.environ |= {"FAULT_KEEP": "1"} if case["keep"] else {}
        os.environ["FAULT_ROOT"] = str(case["root"])
        try:
            command()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        except BaseException:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        sys.stderr.flush()
    finally:
        os._exit(code)


if __name__ == "__main__":
    for line in sys.stdin:
        given = json.loads(line)
        Path(given["root"]).mkdir(parents=True)
        print(json.dumps(attempt(given)), flush=True)
