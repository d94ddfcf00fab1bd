"""Processes that are told by lines what to do, and answer by lines; and what they share."""

from __future__ import annotations

import ctypes as c
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from bridge.native import library_path
from bridge.zenoh.options import ZenohOptions
from fmus.build.toolchain import compile_shared

HERE = Path(__file__).resolve().parent
#: What is in a message of 56 bytes that is not ours: its number, and when it was sent.
ROW = struct.Struct("<qq40x")


@final
class Far:
    """A process that runs :func:`obey`; `what` is what messages call it."""

    def __init__(self, what: str, script: str, *arguments: str) -> None:
        self._what = what
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / script), *arguments],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def tell(self, *what: Any) -> None:
        """A method of the end, and its arguments."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(what) + "\n")
        self._process.stdin.flush()

    def answer(self) -> Any:
        """What it returned; ends the benchmark where the process has ended."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            sys.exit(f"{self._what} has ended, see above")
        return json.loads(line)

    def ask(self, *what: Any) -> Any:
        """Tell, and wait for the answer."""
        self.tell(*what)
        return self.answer()

    def close(self) -> None:
        """Let it end."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10)


def everybody(ends: Sequence[Far], *what: Any) -> list[Any]:
    """Tell all, then wait for all."""
    for end in ends:
        end.tell(*what)
    return [end.answer() for end in ends]


def obey(end: Any) -> None:
    """Do what the lines on standard input say, then end the process: some loops wait for ever."""
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        print(json.dumps(getattr(end, name)(*arguments)), flush=True)
    end.close()
    sys.stdout.flush()
    os._exit(0)


def prefer(priority: int) -> None:
    """Run this process and its threads as SCHED_FIFO, 0: not."""
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def free_ports(n: int) -> list[int]:
    """Of this machine."""
    held = [socket.create_server(("127.0.0.1", 0)) for _ in range(n)]
    ports = [int(s.getsockname()[1]) for s in held]
    for s in held:
        s.close()
    return ports


def options(listen: Sequence[int] = (), connect: Sequence[int] = ()) -> ZenohOptions:
    """Of a session on these ports of the loopback interface."""
    here, there = ([f"tcp/127.0.0.1:{port}" for port in ports] for ports in (listen, connect))
    return ZenohOptions("benchmark", listen=tuple(here), connect=tuple(there))


def build(folder: Path) -> Path:
    """Compile zenoh_tick.c."""
    source = HERE / "c/zenoh_tick.c"
    return compile_shared([source], folder / "zenoh_tick.so", include=[HERE.parent / "bridge/c"])


def tick_library(path: str) -> c.CDLL:
    """zenoh_tick.c, on top of the bridge's own library."""
    c.CDLL(str(library_path()), mode=c.RTLD_GLOBAL)
    found = c.CDLL(path)
    found.tick_echo.restype = found.tick_run.restype = found.tick_take.restype = c.c_int64
    return found


def pointer(array: Any) -> c.c_void_p:
    """Of an array, for C."""
    return c.c_void_p(array.ctypes.data)


def quantiles(us: Any) -> dict[str, float]:
    """Of times, us."""
    p50, p99, p999 = np.percentile(us, [50, 99, 99.9])
    return {"p50": p50, "p99": p99, "p99.9": p999, "max": float(np.max(us))}
