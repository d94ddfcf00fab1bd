"""The end of a supervised command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import pytest

from cosim.record import verify
from tests.cli.command import CALL, CONFIG, started

ENDS = """
import atexit, ctypes, sys, threading, time
from cosim.cli.supervise import supervised

class Dismantled:
    def __del__(self):
        print("taken apart", flush=True)

def work():
    global kept
    kept = Dismantled()
    atexit.register(print, "registered with atexit")
    ctypes.CDLL(None).printf(b"printed by C\\n")
    threading.Thread(target=lambda: (time.sleep(0.05), print("thread"))).start()
    sys.exit(CODE)

sys.exit(supervised(work))
"""


@pytest.mark.parametrize("code", [0, 3])
def test_a_command_ends_with_all_its_output_and_without_dismantling_the_interpreter(
    code: int,
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ENDS.replace("CODE", str(code))],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == code, done.stderr
    assert sorted(done.stdout.splitlines()) == ["printed by C", "registered with atexit", "thread"]


def test_a_command_ends_also_where_sigchld_is_ignored(tmp_path: Path) -> None:
    """So the kernel forgets children that end: nobody is told, and nobody can wait for them."""
    done = subprocess.run(
        [*CALL, "--version"],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGCHLD, signal.SIG_IGN),
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("cosim ")


def _processes(pid: int) -> list[int]:
    """A process and all that it has started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(found for child in children for found in _processes(int(child)))]


@pytest.mark.parametrize("isolate", ["false", "true"])
def test_a_signal_to_all_processes_of_a_command_keeps_what_was_recorded(
    tmp_path: Path, isolate: str
) -> None:
    """As service managers send it."""
    change = ("run.stop=1e6", f"components.master.isolate={isolate}")
    words = [word for text in change for word in ("--set", text)]
    process = started("run", CONFIG, *words, "--no-plot", "--out", "here", cwd=tmp_path)
    part = tmp_path / "here" / "trajectories.parquet.part"
    try:
        while process.poll() is None and not (part.is_file() and part.stat().st_size > 1000):
            sleep(0.01)
        for pid in _processes(process.pid):
            os.kill(pid, signal.SIGTERM)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 143, said
    assert "interrupted at t = " in said and said.endswith("recorded until then: here\n")
    assert "Traceback" not in said
    verify(tmp_path / "here")
    assert (tmp_path / "here" / "SHA256SUMS").is_file()
    assert json.loads((tmp_path / "here" / "run.json").read_text())["status"] == "stopped"
