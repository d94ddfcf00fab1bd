"""The bridge's commands on vcan, as a user starts them in a terminal."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bridge.native.journal import Journal, JournalError
from tests.vcan.peers import PATIENCE, call, listeners, tool

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
COSIM = (sys.executable, "-c", "from cosim.cli import main; main()")
#: s, before a command that starts four processes on one shared CPU is given up.
LONG = 180.0
NODES = ("master", "slave", "master_control", "slave_control")

# Two kernels on two shared CPUs stand still when they like: nobody here may be stopped by that. All
# nodes have 200 Hz, and what is late is late; none has a priority, or who does things to them would
# have to wait until they are done.
CALM = (
    'run.step="5 ms"',
    *(f'deploy.nodes.{node}.overrun="20 s"' for node in NODES),
    *(f"deploy.nodes.{node}.priority=0" for node in NODES),
    *(f'deploy.nodes.{node}.within="20 s"' for node in NODES),
    *(f'deploy.nodes.{node}.drive.watchdog="20 s"' for node in NODES[:2]),
    *(
        f'deploy.nodes.{node}.stale={{"{node}.q"={{stop="20 s"}},"{node}.xi_in"={{age="age[0]"}}}}'
        for node in NODES[2:]
    ),
)


def bring_up() -> None:
    """Both buses up, for CAN FD, without gateway rules."""
    call("cangw", "-F", check=False)
    for bus in ("vcan0", "vcan1"):
        call("ip", "link", "set", bus, "down")
        call("ip", "link", "set", bus, "mtu", "72", "up")


def settings(*changes: str) -> list[str]:
    """Settings in the form that ``--set`` takes."""
    return [word for change in changes for word in ("--set", change)]


def environment(folder: Path) -> dict[str, str]:
    """That of the tests, without asammdf: its import takes seconds here, and nobody needs it."""
    folder.mkdir(exist_ok=True)
    (folder / "asammdf.py").write_text("raise ImportError\n")
    path = os.pathsep.join((str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")))
    return {**os.environ, "PYTHONPATH": path}


def cosim(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Runs ``cosim WORDS`` to its end."""
    return subprocess.run(
        [*COSIM, *words], capture_output=True, text=True, timeout=LONG, env=environment(folder)
    )


@contextlib.contextmanager
def running(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """``cosim WORDS`` in the background; interrupted at the end."""
    process = subprocess.Popen(
        [*COSIM, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(folder),
    )
    try:
        yield process
    finally:
        interrupt(process)


def interrupt(process: subprocess.Popen[str]) -> str:
    """Ctrl-C, and once more where the first is only a stop; then it is killed. What it said."""
    for _ in range(4):
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.communicate(timeout=PATIENCE / 4)[0]
    process.kill()
    return process.communicate()[0]


def ended(process: subprocess.Popen[str]) -> str:
    """The output of a command until it ended by itself."""
    return process.communicate(timeout=LONG)[0]


def until(
    what: Callable[[], bool], why: str, *commands: subprocess.Popen[str], seconds: float = LONG
) -> None:
    """Waits for something; fails with `why`, at once when one of the commands has ended."""
    end = time.monotonic() + seconds
    while not what():
        for command in commands:
            if command.poll() is not None:
                raise AssertionError(f"{why}: ended with {ended(command)}")
        assert time.monotonic() < end, f"still not after {seconds:g} s: {why}"
        time.sleep(0.02)


def said(process: subprocess.Popen[str], words: str) -> None:
    """Waits for a line with these words."""
    assert process.stdout
    seen = []
    for line in process.stdout:
        seen.append(line)
        if words in line:
            return
    raise AssertionError(f"it ended without {words!r}:\n{''.join(seen)}")


@contextlib.contextmanager
def dump(bus: str, file: Path) -> Iterator[Path]:
    """All frames of a bus, written by ``candump -L``."""
    before = listeners(bus)
    with file.open("w") as out:
        process = subprocess.Popen([tool("candump"), "-L", "-r", str(8 << 20), bus], stdout=out)
        until(lambda: listeners(bus) > before, f"candump listens to {bus}")
        try:
            yield file
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)


def slots(journal: Path) -> int:
    """The number of slots that a node has recorded by now; 0 where there is no journal yet."""
    try:
        return len(Journal.open(journal))
    except JournalError:
        return 0
