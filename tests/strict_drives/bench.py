"""A command beside strict drives: starts them, runs it, ends them, and keeps what all of them said.

    python -m tests.strict_drives.bench SPEC.json

The file has `drives`, the arguments of one process for each bus, and `command`, its words.
The standard output is the command's, and so is the exit status.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from tests.children import fork
from tests.strict_drives.__main__ import main as drives_of_a_bus


@dataclass(frozen=True)
class Drives:
    """A process with the drives of a bus: its pipes, as descriptors."""

    pid: int
    to: int
    said: int


def start(words: Sequence[str], others: Sequence[Drives] = ()) -> Drives:
    """The drives of a bus, soon on the bus: a fork, for imports are slow on the guest's processor.

    `others`: processes whose standard input this one must not hold open.
    """
    heard, to = os.pipe()
    said, tells = os.pipe()

    def work() -> int:
        for descriptor in (to, said, *(other.to for other in others)):
            os.close(descriptor)
        os.dup2(heard, 0)
        os.dup2(tells, 1)
        return drives_of_a_bus(words)

    pid = fork(work)
    os.close(heard)
    os.close(tells)
    return Drives(pid, to, said)


def ready(drives: Drives) -> None:
    """Wait until the drives are on their bus."""
    with os.fdopen(drives.said) as said:
        assert said.readline() == "ready\n", "strict drives did not start"


def end(drives: Drives) -> None:
    """The end of its standard input is its end."""
    os.close(drives.to)
    code = os.waitstatus_to_exitcode(os.waitpid(drives.pid, 0)[1])
    assert code == 0, f"strict drives ended with {code}"


def main(path: str) -> int:
    spec = json.loads(Path(path).read_text("utf-8"))
    with ExitStack() as stack:
        drives: list[Drives] = []
        for words in spec["drives"]:
            drives.append(start(words, drives))
            stack.callback(end, drives[-1])
        for process in drives:
            ready(process)
        return subprocess.run(spec["command"], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
