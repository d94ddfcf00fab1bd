"""A command beside strict drives: starts them, runs it, ends them, and keeps what all of them said.

    python -m tests.strict_drives.bench SPEC.json

The file has `drives`, the arguments of one process for each bus, and `command`, its words.
The standard output is the command's, and so is the exit status.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

STRICT = (sys.executable, "-m", "tests.strict_drives")
PATIENCE = 60.0  # s


def start(words: Sequence[str]) -> subprocess.Popen[str]:
    """The drives of a bus, soon on the bus."""
    return subprocess.Popen(
        [*STRICT, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def ready(process: subprocess.Popen[str]) -> None:
    """Wait until the drives are on their bus."""
    assert process.stdout and process.stdout.readline() == "ready\n", "strict drives did not start"


def end(process: subprocess.Popen[str]) -> None:
    """The end of its standard input is its end."""
    process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, f"strict drives ended with {process.returncode}"


def main(path: str) -> int:
    spec = json.loads(Path(path).read_text("utf-8"))
    with ExitStack() as stack:
        drives = [start(words) for words in spec["drives"]]
        for process in drives:
            stack.callback(end, process)
        for process in drives:
            ready(process)
        return subprocess.run(spec["command"], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
