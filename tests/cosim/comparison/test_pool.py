"""Calls spread over processes, and what becomes of them when one process dies."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.comparison.pool import spread

CRASH, RAISE = -1, -2


def square(x: int) -> int:
    """x², or the end of this process, or an exception."""
    if x == CRASH:
        os._exit(3)
    if x == RAISE:
        raise ValueError("no square")
    return x * x


def test_one_job_is_done_here_and_in_order() -> None:
    assert list(spread(square, [3, 1, 2], 1)) == [(3, 9), (1, 1), (2, 4)]
    assert list(spread(square, [], 2)) == []


def test_a_process_that_dies_takes_one_call_with_it() -> None:
    tasks = [1, 2, CRASH, 3, 4, 5]
    done = dict(spread(square, tasks, 2))
    assert done == {1: 1, 2: 4, CRASH: None, 3: 9, 4: 16, 5: 25}


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_call_raises_is_raised_here(jobs: int) -> None:
    with pytest.raises(ValueError, match="no square"):
        list(spread(square, [RAISE, 1], jobs))


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    call = "list(spread(abs, [1, 2], 2))"
    script.write_text(f"from cosim.comparison.pool import spread\n{call}\n")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode
    assert "worker processes end before they start; in a script" in done.stderr
