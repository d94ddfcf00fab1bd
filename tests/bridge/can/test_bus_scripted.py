"""Arrivals on a socket, to the nanosecond: a library in front of libc has clocks and frames."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fmus.build.toolchain import compile_shared

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sockets of the tick are Linux's")

SCRIPTED = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#define API __attribute__((visibility("default")))
#ifndef SO_RXQ_OVFL
#define SO_RXQ_OVFL 40
#endif
API int armed, n_monotonic, n_wall, n_frames, at;
API long long monotonic[64], wall[64], stamps[64], lost[64];
static void put(struct msghdr *m, int type, const void *data, size_t size)
{
    struct cmsghdr *c = (struct cmsghdr *)((char *)m->msg_control + m->msg_controllen);
    c->cmsg_len = CMSG_LEN(size);
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = type;
    memcpy(CMSG_DATA(c), data, size);
    m->msg_controllen += CMSG_SPACE(size);
}
API int clock_gettime(clockid_t id, struct timespec *t)
{
    static int (*real)(clockid_t, struct timespec *);
    if (!real) *(void **)&real = dlsym(RTLD_NEXT, "clock_gettime");
    if (!armed) return real(id, t);
    const long long ns = id == CLOCK_REALTIME ? wall[n_wall++] : monotonic[n_monotonic++];
    t->tv_sec = ns / 1000000000;
    t->tv_nsec = ns % 1000000000;
    return 0;
}
API int recvmmsg(int fd, struct mmsghdr *m, unsigned n, int flags, struct timespec *t)
{
    int (*real)(int, struct mmsghdr *, unsigned, int, struct timespec *);
    unsigned k = 0;
    *(void **)&real = dlsym(RTLD_NEXT, "recvmmsg");
    if (!armed) return real(fd, m, n, flags, t);
    for (; k < n && at < n_frames; k++, at++) {
        const unsigned raw[4] = {0x100u + at, 8, 0, 0};
        const struct timespec stamp = {stamps[at] / 1000000000, stamps[at] % 1000000000};
        const unsigned gone = lost[at];
        memcpy(m[k].msg_hdr.msg_iov->iov_base, raw, sizeof raw);
        m[k].msg_len = sizeof raw;
        m[k].msg_hdr.msg_controllen = 0;
        if (stamps[at]) put(&m[k].msg_hdr, SO_TIMESTAMPNS, &stamp, sizeof stamp);
        if (lost[at] >= 0) put(&m[k].msg_hdr, SO_RXQ_OVFL, &gone, sizeof gone);
    }
    if (!k) errno = EAGAIN;
    return k ? (int)k : -1;
}
"""

#: All frames of each case from a bus in a given state; its state then, and the clocks read.
CASES = """
import ctypes as c, json, socket, sys
from bridge.native.bus import Bus
from bridge.native.library import library
from bridge.native.frame import Frame
lib, receive = c.CDLL(sys.argv[1]), library().bus_receive
found = []
for case in json.loads(sys.stdin.read()):
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    bus, seen = Bus.from_socket(here.fileno()), []
    for name, value in case["before"].items():
        setattr(bus.struct, name, value)
    for name in ("monotonic", "wall", "stamps", "lost"):
        (c.c_longlong * 64).in_dll(lib, name)[:] = (case[name] + [0] * 64)[:64]
    for name in ("n_monotonic", "n_wall", "at"):
        c.c_int.in_dll(lib, name).value = 0
    c.c_int.in_dll(lib, "n_frames").value = len(case["stamps"])
    frame, armed, struct = Frame(), c.c_int.in_dll(lib, "armed"), c.byref(bus.struct)
    while True:
        armed.value = 1
        got = receive(struct, c.byref(frame))
        armed.value = 0
        if not got:
            break
        seen.append(frame.t_ns)
    state = {name: getattr(bus.struct, name) for name in case["after"]}
    read = [c.c_int.in_dll(lib, name).value for name in ("n_monotonic", "n_wall")]
    found.append([seen, state, read])
print(json.dumps(found))
"""

S, MS, US = 1_000_000_000, 1_000_000, 1000
NOW, DATE = 1000 * S, 5_000_000 * S  # of the two clocks
TIGHT = 200 * US


def case(readings, stamps, times, *, more=(), before=None, lost=None, **after):
    """A case: (ns before, wall, ns after) of each reading, stamps of frames -> their times.

    `more`: further readings of the monotonic clock; `after`: state of the bus.
    """
    monotonic = [x for first, _, last in readings for x in (first, last)]
    return {
        "monotonic": [*monotonic, *more], "wall": [wall for _, wall, _ in readings],
        "stamps": stamps, "lost": lost or [-1] * len(stamps), "before": before or {},
        "after": after, "times": times,
        "read": [len(monotonic) + len(more), len(readings)],
    }  # fmt: skip


def reading(late, within, set_by=0):
    """Both clocks `late` ns after NOW, the wall clock set by so much: OFFSET - set_by apart."""
    return NOW + late, DATE + late + within // 2 + set_by, NOW + late + within


OFFSET = NOW - DATE
KNOWN = {"wall_ns": DATE, "offset_ns": OFFSET, "empty_ns": NOW - 5 * MS}
GOOD = reading(0, 100)
CASES_OF = {
    "the clocks are compared at the first frame": case(
        [GOOD], [DATE + 7, DATE + 9], [NOW + 7, NOW + 9],
        offset_ns=OFFSET, wall_ns=DATE + 50, began_ns=NOW + 100, empty_ns=NOW + 100,
        draining=0, stepped=0, clock_steps=0,
    ),
    "the limit itself is tight": case(
        [reading(0, TIGHT)], [DATE], [NOW], offset_ns=OFFSET, wall_ns=DATE + TIGHT // 2,
    ),
    "the tightest of three readings": case(
        [reading(0, TIGHT + 2), reading(MS, TIGHT + 2, 40), reading(2 * MS, TIGHT + 1 + 1, 80)],
        [DATE], [NOW], offset_ns=OFFSET, wall_ns=0, began_ns=NOW + TIGHT + 2,
    ),
    "a later one that is tighter": case(
        [reading(0, 3 * TIGHT), reading(MS, 2 * TIGHT, 40), reading(9 * MS, 4 * TIGHT, 80)],
        [DATE], [NOW - 40], offset_ns=OFFSET - 40, wall_ns=0, began_ns=NOW + MS + 2 * TIGHT,
    ),
    "no other after one that is tight": case(
        [reading(0, 3 * TIGHT), reading(MS, TIGHT, 40)], [DATE], [NOW - 40],
        offset_ns=OFFSET - 40, wall_ns=DATE + MS + TIGHT // 2 + 40,
    ),
    "not again within a second": case(
        [], [DATE, DATE + 3], [NOW, NOW + 3], before=KNOWN, offset_ns=OFFSET, wall_ns=DATE,
        began_ns=0,
    ),
    "not at the end of a second": case([], [DATE + S - 1], [NOW + S - 1], before=KNOWN),
    "again after a second": case(
        [reading(S, 100)], [DATE + S], [NOW + S], before=KNOWN, wall_ns=DATE + S + 50,
        offset_ns=OFFSET, clock_steps=0, stepped=0,
    ),
    "again where wall time has gone back": case(
        [reading(0, 100)], [DATE - 1], [NOW - 1], before=KNOWN, wall_ns=DATE + 50, clock_steps=0,
    ),
    "a wide reading tells nothing new": case(
        [reading(S + k * MS, TIGHT + 2, 60) for k in range(3)], [DATE + S], [NOW + S],
        before=KNOWN, wall_ns=DATE, offset_ns=OFFSET, clock_steps=0,
    ),
    "one that is just tight does": case(
        [reading(S, TIGHT, 60)], [DATE + S + 60], [NOW + S], before=KNOWN,
        wall_ns=DATE + S + TIGHT // 2 + 60, offset_ns=OFFSET - 60,
    ),
    "less than a step": case(
        [reading(S, 100, MS - 1)], [DATE + S], [NOW + S - MS + 1], before=KNOWN,
        offset_ns=OFFSET - MS + 1, clock_steps=0, stepped=0,
    ),
    "less than a step back": case(
        [reading(S, 100, 1 - MS)], [DATE + S], [NOW + S + MS - 1], before=KNOWN,
        offset_ns=OFFSET + MS - 1, clock_steps=0, stepped=0,
    ),
    "a step": case(
        [reading(S, 100, MS)], [DATE + S + MS], [NOW + S], more=[NOW + S + 100], before=KNOWN,
        offset_ns=OFFSET - MS, clock_steps=1, stepped=2,
    ),
    "a step back": case(
        [reading(2 * S, 100, -MS)], [DATE + 2 * S - MS], [NOW + 2 * S],
        more=[NOW + 2 * S + 100], before=KNOWN,
        offset_ns=OFFSET + MS, clock_steps=1, stepped=2,
    ),
    "a stamp of before a step lies where it may": case(
        [reading(S, 100, 60 * S)], [DATE + S, DATE + S + 61 * S], [NOW - 5 * MS, NOW + S + 200],
        more=[NOW + S + 150, NOW + S + 200], before=KNOWN, clock_steps=1, stepped=2,
    ),
    "the drain after a step is looked at again": case(
        [reading(S, 100)], [DATE + 2 * S], [NOW + S + 300], more=[NOW + S + 300],
        before=KNOWN | {"stepped": 2}, clock_steps=0, stepped=1,
    ),
    "and the one after that": case(
        [reading(S, 100)], [DATE + S], [NOW + S], before=KNOWN | {"stepped": 1}, stepped=0,
    ),
    "a frame without a stamp has come now": case(
        [GOOD], [0], [NOW + 400], more=[NOW + 400], offset_ns=OFFSET,
    ),
    "more than a batch is one drain": case(
        [GOOD], [DATE + k for k in range(20)], [NOW + k for k in range(20)], received=20,
        empty_ns=NOW + 100,
    ),
    "as many as a batch": case(
        [GOOD], [DATE + k for k in range(8)], [NOW + k for k in range(8)], received=8,
    ),
    "frames for which there was no room": case(
        [GOOD], [DATE] * 4, [NOW] * 4, lost=[-1, 3, 3, 10], overruns=10, overflow=10,
    ),
    "their count turns at 32 bits": case(
        [GOOD], [DATE], [NOW], lost=[2], before={"overflow": 2**32 - 3, "overruns": 7},
        overruns=12, overflow=2,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The results of each case."""
    folder = tmp_path_factory.mktemp("scripted")
    (folder / "scripted.c").write_text(SCRIPTED)
    library = compile_shared([folder / "scripted.c"], folder / "scripted.so")
    done = subprocess.run(
        [sys.executable, "-c", CASES, str(library)], input=json.dumps([*CASES_OF.values()]),
        capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "LD_PRELOAD": str(library)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return dict(zip(CASES_OF, json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("name", CASES_OF)
def test_frames_have_the_times_of_their_arrival(seen: dict[str, Any], name: str) -> None:
    """Stamps in wall time are put on the clock that is never set; clocks are read as seldom."""
    times, state, read = seen[name]
    expected = CASES_OF[name]
    assert times == expected["times"]
    assert state == expected["after"]
    assert read == expected["read"]
