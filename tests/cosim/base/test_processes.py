"""Calls spread over processes, and what becomes of them when one process dies, or all have to."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from cosim.base.processes import DIED, processes, spread

CRASH, RAISE = -1, -2
TWO = partial(processes, 2)


def square(x: int) -> int:
    """x², or the end of this process, or an exception."""
    if x == CRASH:
        os._exit(3)
    if x == RAISE:
        raise ValueError("no square")
    return x * x


def test_a_process_that_dies_takes_one_call_with_it() -> None:
    tasks = [1, 2, CRASH, 3, 4, 5]
    done = dict(spread(TWO, square, tasks))
    assert done == {1: 1, 2: 4, CRASH: DIED, 3: 9, 4: 16, 5: 25}
    assert list(spread(TWO, square, [])) == []


def test_what_a_call_raises_is_raised_here() -> None:
    with pytest.raises(ValueError, match="no square"):
        list(spread(TWO, square, [RAISE, 1]))


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    lines = [
        "from functools import partial",
        "from cosim.base.processes import processes, spread",
        "list(spread(partial(processes, 2), abs, [1, 2]))",
    ]
    script.write_text("\n".join(lines))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode
    assert "worker processes end before they start; in a script" in done.stderr


def test_processes_end_with_the_one_that_waits_for_them(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("""
from functools import partial
from time import sleep
from cosim.base.processes import processes, spread
if __name__ == "__main__":
    for task, _ in spread(partial(processes, 2), sleep, [0, 600, 600]):
        print(task, flush=True)
""")
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "0\n"
        process.kill()
        process.communicate(timeout=60)  # those who have its pipe have ended
