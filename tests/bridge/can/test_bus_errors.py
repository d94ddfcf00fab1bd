"""Errors that a socket of a CAN interface reports, given to it by a library in front of libc."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.native.bus import BusState
from fmus.build.toolchain import compile_shared

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sockets of the tick are Linux's")

#: recvmmsg() and send() of libc, of which the next calls fail with the errors of `failing`.
FAILING = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <sys/socket.h>
#define API __attribute__((visibility("default")))
API int failing[4], calls;
static int fails(void)
{
    const int n = calls++;
    if (n > 3 || !failing[n]) return 0;
    errno = failing[n];
    return 1;
}
API int recvmmsg(int fd, struct mmsghdr *m, unsigned n, int flags, struct timespec *t)
{
    int (*real)(int, struct mmsghdr *, unsigned, int, struct timespec *);
    *(void **)&real = dlsym(RTLD_NEXT, "recvmmsg");
    return fails() ? -1 : real(fd, m, n, flags, t);
}
API ssize_t send(int fd, const void *data, size_t size, int flags)
{
    ssize_t (*real)(int, const void *, size_t, int);
    *(void **)&real = dlsym(RTLD_NEXT, "send");
    return fails() ? -1 : real(fd, data, size, flags);
}
"""

#: A bus for each case: what it receives while its socket fails, and then a frame; or what it sends.
CASES = """
import ctypes, json, socket, struct, sys
from bridge.native.bus import Bus
from bridge.native.frame import Frame
lib = ctypes.CDLL(sys.argv[1])
failing = (ctypes.c_int * 4).in_dll(lib, "failing")
calls = ctypes.c_int.in_dll(lib, "calls")

def state(bus):
    s = bus.struct
    return [s.state, s.last_errno, s.restarts, s.received, s.sent, s.send_failed]

found = []
for way, errors in json.loads(sys.argv[2]):
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    bus = Bus.from_socket(here.fileno())
    frame = struct.pack("=IB3x8s", 0x101, 8, bytes(8))
    calls.value = 1 << 20
    if way == "hear":
        there.sendall(frame)
    failing[:] = errors + [0] * (4 - len(errors))
    calls.value = 0
    result = len(bus.drain()) if way == "hear" else bus.send(Frame.of(1))
    seen = [result, *state(bus)]
    if way == "hear":
        there.sendall(frame)
        seen += [len(bus.drain()), *state(bus)]
    else:
        seen += [bus.send(Frame.of(1)), *state(bus)]
    found.append(seen)
print(json.dumps(found))
"""
DOWN = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)
OTHERS = (errno.EIO, errno.ENOBUFS)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, tuple[int, ...]], list[Any]]:
    """The result, state and counters of a bus in each case, and once more after it."""
    folder = tmp_path_factory.mktemp("failing")
    (folder / "failing.c").write_text(FAILING)
    library = compile_shared([folder / "failing.c"], folder / "failing.so")
    errors = [(e,) for e in (*DOWN, *OTHERS, errno.EINTR, errno.EAGAIN)] + [(errno.EIO,) * 4]
    cases = [(way, list(e)) for way in ("hear", "say") for e in errors]
    done = subprocess.run(
        [sys.executable, "-c", CASES, str(library), json.dumps(cases)],
        capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "LD_PRELOAD": str(library)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    names = [(way, tuple(e)) for way, e in cases]
    return dict(zip(names, json.loads(done.stdout), strict=True))


ACTIVE, IS_DOWN = int(BusState.ACTIVE), int(BusState.DOWN)


@pytest.mark.parametrize("error", DOWN)
def test_a_bus_whose_interface_is_gone_is_down_until_a_frame_goes_through(
    seen: dict[tuple[str, tuple[int, ...]], list[Any]], error: int
) -> None:
    """A socket reports an error once: what had arrived is read behind it, and the bus is up."""
    heard = seen["hear", (error,)]
    assert heard[:7] == [1, ACTIVE, error, 1, 1, 0, 0]
    assert heard[7:] == [1, ACTIVE, error, 1, 2, 0, 0]
    said = seen["say", (error,)]
    assert said[:7] == [error, IS_DOWN, error, 0, 0, 0, 1]
    assert said[7:] == [0, ACTIVE, error, 1, 0, 1, 1]


@pytest.mark.parametrize("error", OTHERS)
def test_other_errors_are_told_and_leave_the_bus_as_it_is(
    seen: dict[tuple[str, tuple[int, ...]], list[Any]], error: int
) -> None:
    assert seen["hear", (error,)][:7] == [1, ACTIVE, error, 0, 1, 0, 0]
    assert seen["say", (error,)][:7] == [error, ACTIVE, error, 0, 0, 0, 1]


def test_a_call_that_was_interrupted_is_made_again(
    seen: dict[tuple[str, tuple[int, ...]], list[Any]],
) -> None:
    assert seen["hear", (errno.EINTR,)][:7] == [1, ACTIVE, 0, 0, 1, 0, 0]
    assert seen["say", (errno.EINTR,)][:7] == [0, ACTIVE, 0, 0, 0, 1, 0]


def test_a_socket_with_nothing_to_read_is_no_error(
    seen: dict[tuple[str, tuple[int, ...]], list[Any]],
) -> None:
    heard = seen["hear", (errno.EAGAIN,)]
    assert heard[:7] == [0, ACTIVE, 0, 0, 0, 0, 0]
    assert heard[7:] == [2, ACTIVE, 0, 0, 2, 0, 0]


def test_a_socket_that_fails_again_and_again_does_not_hold_a_slot_up(
    seen: dict[tuple[str, tuple[int, ...]], list[Any]],
) -> None:
    """Four calls, and the frame comes with the next slot."""
    heard = seen["hear", (errno.EIO,) * 4]
    assert heard[:7] == [0, ACTIVE, errno.EIO, 0, 0, 0, 0]
    assert heard[7:] == [2, ACTIVE, errno.EIO, 0, 2, 0, 0]
