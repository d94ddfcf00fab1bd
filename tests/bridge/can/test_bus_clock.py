"""Two clocks are compared while a machine is stalled: its stall is not a step of the wall clock."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fmus.build.toolchain import compile_shared

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sockets of the tick are Linux's")

#: clock_gettime() of libc, which stalls for 5 ms after (or before) reading wall time.
STALLING = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>
#define API __attribute__((visibility("default")))
API int stalls, before;
static void stall(void)
{
    const struct timespec while_ = {0, 5000000};
    nanosleep(&while_, 0);
}
API int clock_gettime(clockid_t id, struct timespec *t)
{
    static int (*real)(clockid_t, struct timespec *);
    if (!real)
        *(void **)&real = dlsym(RTLD_NEXT, "clock_gettime");
    const int now = id == CLOCK_REALTIME && stalls > 0;
    stalls -= now;
    if (now && before)
        stall();
    const int error = real(id, t);
    if (now && !before)
        stall();
    return error;
}
"""

#: Frames through a pair of sockets, the clocks compared at each.
LOOKS = """
import ctypes, socket, struct, sys
from bridge.native.bus import Bus
from cosim.base.clock import monotonic_ns
path, before, *stalls = sys.argv[1:]
lib = ctypes.CDLL(path)
ctypes.c_int.in_dll(lib, "before").value = int(before)
here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
bus = Bus.from_socket(here.fileno())
for n in stalls:
    ctypes.c_int.in_dll(lib, "stalls").value = int(n)
    sent = monotonic_ns()
    there.send(struct.pack("=IB3x8s", 0x101, 8, bytes(8)))
    (frame,) = bus.drain()
    assert abs(frame.t_ns - sent) < 10**9, (sent, frame.t_ns)
    if bus.struct.wall_ns:
        bus.struct.wall_ns -= 10**9  # compared once a second: that is over
print(bus.struct.clock_steps)
"""


@pytest.fixture(scope="module")
def stalling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stalling")
    (folder / "stalling.c").write_text(STALLING)
    return compile_shared([folder / "stalling.c"], folder / "stalling.so")


@pytest.mark.parametrize("first", ["0", "9"])
@pytest.mark.parametrize("before", [0, 1])
def test_a_stall_between_two_clocks_is_no_step(stalling: Path, before: int, first: str) -> None:
    """One, and more than are tried again; also at first, when any is better than none."""
    words = [str(stalling), str(before), first, "0", "1", "0", "9", "0"]
    done = subprocess.run(
        [sys.executable, "-c", LOOKS, *words], capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "LD_PRELOAD": str(stalling)},
    )  # fmt: skip
    assert (done.returncode, done.stdout.strip()) == (0, "0"), done.stderr
