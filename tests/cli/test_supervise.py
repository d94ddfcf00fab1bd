"""The end of a supervised command."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
