"""A CAN frame there and back between two processes: our bus, raw sockets in C, and python-can.

    python benchmarks/roundtrip.py [--quick] [--json FILE] [--blocks N] [--count N]
                                   [--channel NAME] [--launcher "COMMAND ..."]

Both ends are of one kind; the kinds run a block each, in turns. Ours encodes, protects and
decodes; the others copy bytes. Where there is no such interface the script starts itself again
under the launcher, which gives it a kernel with SocketCAN (`python -m bridge.vcan run`). In
User-Mode Linux a system call costs some 15 us and reading a clock is one, elsewhere it takes
0.03 us: ratios from there are of system calls. `--channel pair` sends the same frames through a
pair of UNIX sockets of this kernel, without CAN. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import ctypes as c
import json
import os
import shlex
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import can
import numpy as np

from benchmarks import tables
from bridge.native import library_path, pace
from bridge.realtime.lateness import Spread
from cosim.base.clock import monotonic_ns
from fmus.build.toolchain import compile_shared

ROOT = Path(__file__).resolve().parents[1]
PING, ECHO = 0x101, 0x102
FLOOR, PEER = "raw socket in C", "python-can"
#: Name -> what its functions in roundtrip.c begin with.
IN_C = {FLOOR: "raw", "raw in C, stamped, until empty": "stamped", "our bus, with codec": "bridge"}
RUNNERS = (*IN_C, PEER)
#: A channel that is none: a pair of UNIX sockets, which any kernel has. Not for python-can.
PAIR = "pair"
FRAMES = {"8 bytes": 8, "64 bytes, CAN FD": 64}
SHOWN = ("p50", "p99", "p999", "maximum")
PATIENCE = 1.0  # s, for a frame

# ---- the ends ------------------------------------------------------------------------------------


def opened(channel: str, receives: int) -> socket.socket:
    """A raw CAN socket that receives one identifier, with a time-out."""
    found = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    found.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    mask = np.array([receives, 0x7FF], np.uint32).tobytes()
    found.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, mask)
    patience = np.array([int(PATIENCE), 0], np.int64).tobytes()
    found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, patience)
    found.bind((channel,))
    return found


def loaded(path: Path) -> c.CDLL:
    """The benchmark's C, on top of the bridge's own library."""
    c.CDLL(str(library_path()), mode=c.RTLD_GLOBAL)
    return c.CDLL(str(path))


def in_c(end: str, name: str, found: socket.socket, size: int, n: int, lib: c.CDLL) -> list[int]:
    """One end in C: the times of its round trips, ns (none at the echo)."""
    function = lib[f"{IN_C[name]}_{end}"]
    function.restype = c.c_int32
    taken = np.zeros(n, np.int64)
    where = [c.c_void_p(taken.ctypes.data)] if end == "ping" else []
    error = function(c.c_int32(found.fileno()), c.c_int32(size), c.c_int64(n), *where)
    if error:
        raise OSError(error, f"{name}, {end}: {os.strerror(error)}")
    return [int(ns) for ns in taken] if end == "ping" else []


def in_python_can(end: str, bus: can.BusABC, size: int, n: int) -> list[int]:
    """One end with python-can, as its users write it."""
    kind: dict[str, Any] = {"is_fd": size > 8, "bitrate_switch": size > 8, "is_extended_id": False}
    taken = []
    for k in range(n):
        data = k.to_bytes(8, "little").ljust(size, b"\0")
        start = monotonic_ns()
        if end == "ping":
            bus.send(can.Message(arbitration_id=PING, data=data, **kind))
        got = bus.recv(PATIENCE)
        if got is None:
            raise OSError(f"python-can, {end}: no frame within {PATIENCE} s")
        if end == "echo":
            bus.send(can.Message(arbitration_id=ECHO, data=got.data, **kind))
        elif bytes(got.data) != data:
            raise OSError("python-can: another frame came back")
        else:
            taken.append(monotonic_ns() - start)
    return taken


@contextmanager
def attached(name: str, channel: str) -> Iterator[tuple[Any, Any]]:
    """The ends of echo and ping: sockets, or buses of python-can. Both are open from here on."""
    there: Any
    here: Any
    if channel == PAIR:
        there, here = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    elif name == PEER:
        there, here = (
            can.Bus(interface="socketcan", channel=channel, fd=True, can_filters=[
                can.typechecking.CanFilter(can_id=receives, can_mask=0x7FF, extended=False)
            ])
            for receives in (PING, ECHO)
        )  # fmt: skip
    else:
        there, here = opened(channel, PING), opened(channel, ECHO)
    with there, here:
        yield there, here


# ---- measuring -----------------------------------------------------------------------------------


def block(name: str, channel: str, size: int, n: int, lib: c.CDLL) -> dict[str, Any]:
    """One block of n round trips, with an echo in a process of its own."""
    warm = min(n, 50)

    def end(which: str, at: Any) -> list[int]:
        if name == PEER:
            return in_python_can(which, at, size, n + warm)
        return in_c(which, name, at, size, n + warm, lib)

    with attached(name, channel) as (there, here):
        echo = os.fork()
        if echo == 0:
            status = 1
            try:
                end("echo", there)
                status = 0
            finally:
                os._exit(status)
        try:
            taken = end("ping", here)[warm:]
        finally:
            _, status = os.waitpid(echo, 0)
    if status:
        raise OSError(f"{name}: the echo failed")
    spread = Spread.of(taken)
    return {key: getattr(spread, key) for key in ("count", "minimum", "mean", *SHOWN)}


def measure(channel: str, blocks: int, n: int, path: Path) -> list[dict[str, Any]]:
    """Everybody, in turns."""
    lib = loaded(path)
    runners = IN_C if channel == PAIR else RUNNERS
    cases = [(frame, name) for frame in FRAMES for name in runners]
    found: dict[tuple[str, str], list[dict[str, Any]]] = {case: [] for case in cases}
    for _ in range(blocks):
        for frame, name in cases:
            found[frame, name].append(block(name, channel, FRAMES[frame], n, lib))
    rows: list[dict[str, Any]] = []
    for frame, name in cases:
        us = {key: median(b[key] for b in found[frame, name]) * 1e-3 for key in SHOWN}
        rows.append({"frame": frame, "runner": name, "us": us, "blocks": found[frame, name]})
    for row in rows:
        floor = next(r["us"] for r in rows if r["frame"] == row["frame"] and r["runner"] == FLOOR)
        row["ratio"] = {key: row["us"][key] / floor[key] for key in SHOWN}
    return rows


def report(rows: list[dict[str, Any]]) -> str:
    """One table."""
    header = ["round trip, us: median of blocks", "frame", "p50", "p99", "p99.9", "max",
              "p50 to raw C", "p99 to raw C"]  # fmt: skip
    lines = [
        [row["runner"], row["frame"], *(f"{row['us'][key]:.1f}" for key in SHOWN),
         *(f"{row['ratio'][key]:.2f}" for key in ("p50", "p99"))]
        for row in rows
    ]  # fmt: skip
    return tables.grid(header, lines)


def clock_cost() -> float:
    """What reading the clock takes, ns, with the call from Python."""
    return float(np.median(np.diff([pace.now() for _ in range(2000)])))


def relaunched(launcher: str, arguments: list[str], path: Path) -> int:
    """The same under a launcher; its exit status."""
    command = shlex.split(launcher) or [sys.executable, "-m", "bridge.vcan", "run", "--"]
    command += [sys.executable, str(Path(__file__).resolve()), *arguments, "--built", str(path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, check=False).returncode


def has(channel: str) -> bool:
    return Path("/sys/class/net", channel).exists()


def parser() -> argparse.ArgumentParser:
    found = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    found.add_argument("--quick", action="store_true", help="one short block of everything")
    found.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    found.add_argument("--blocks", type=int, default=7, help="blocks of each (default 7)")
    found.add_argument("--count", type=int, default=4000, help="round trips of a block")
    found.add_argument("--channel", default="vcan0", help="CAN interface; pair: no CAN")
    found.add_argument("--launcher", default="", help="command that gives a kernel with SocketCAN")
    found.add_argument("--built", type=Path, help=argparse.SUPPRESS)
    return found


def main() -> None:
    """Measure, print the table, write the numbers."""
    options = parser().parse_args()
    with tempfile.TemporaryDirectory(prefix="roundtrip-") as folder:
        path = options.built or compile_shared(
            [ROOT / "benchmarks/c/roundtrip.c"], Path(folder, "roundtrip.so"),
            include=[ROOT / "bridge/c"],
        )  # fmt: skip
        if options.channel != PAIR and not has(options.channel):
            if options.built:
                sys.exit(f"{options.channel}: found no such interface under the launcher either")
            sys.exit(relaunched(options.launcher, sys.argv[1:], path))
        blocks, n = (1, 100) if options.quick else (options.blocks, options.count)
        rows = measure(options.channel, blocks, n, path)
    print(report(rows))
    print(f"reading a clock takes {clock_cost() * 1e-3:.2f} us here")
    if options.json:
        facts = {
            "machine": tables.machine(),
            "python-can": can.__version__,
            "channel": options.channel,
            "clock_ns": clock_cost(),
            "blocks": blocks,
            "count": n,
            "rows": rows,
        }
        options.json.write_text(json.dumps(facts, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
