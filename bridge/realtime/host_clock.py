"""Identification of a host's clock: its number in EPOCH, and whether it is synchronized.

Processes of one host share its clocks. Two hosts share the date (CLOCK_REALTIME) if time servers
(NTP, PTP) synchronize both; the kernel reports whether, and with which error.
"""

from __future__ import annotations

import ctypes as c
import hashlib
import platform
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

#: Linux: another one for each start of a machine; containers and network namespaces share it.
BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
#: ``STA_UNSYNC`` of <sys/timex.h>: no time server keeps the date.
_UNSYNC = 0x40


class _Timex(c.Structure):
    """The begin of ``struct timex`` of Linux; the kernel fills 208 bytes."""

    _fields_ = (
        ("modes", c.c_uint),
        ("offset", c.c_long),
        ("freq", c.c_long),
        ("maxerror", c.c_long),
        ("esterror", c.c_long),
        ("status", c.c_int),
        ("rest", c.c_char * 256),
    )


@dataclass(frozen=True, slots=True)
class HostClock:
    """The clock of a host. `host`: identifies it; `kept`: synchronized to a time server.

    `error`: the maximum error (s) according to the kernel; infinite without a time server.
    `estimated`: the error (s) that the kernel estimates.
    """

    host: str
    kept: bool
    error: float = float("inf")
    estimated: float = float("inf")

    @property
    def number(self) -> int:
        """1 to 255, in EPOCH: hosts with different numbers are different."""
        return zlib.crc32(self.host.encode()) % 255 + 1

    @property
    def identity(self) -> tuple[float, float, float, float]:
        """128 bits of a hash of `host`, 32 in each number: no two hosts have the same."""
        digest = hashlib.sha256(self.host.encode()).digest()
        a, b, c_, d = (float(int.from_bytes(digest[i : i + 4], "big")) for i in range(0, 16, 4))
        return a, b, c_, d

    @property
    def identity_text(self) -> str:
        """`identity` as 32 hexadecimal digits."""
        return "".join(f"{int(word):08x}" for word in self.identity)

    def describe(self) -> str:
        """For reports; hosts with one number have different identities."""
        name = f"host {self.identity_text[:8]}"
        if not self.kept:
            return f"{name}, date kept by no time server"
        return f"{name}, date kept by a time server to {self.error * 1e3:.3g} ms"


def host_clock() -> HostClock:
    """The clock of this machine. If the kernel cannot be queried (not Linux), it is not
    synchronized.
    """
    host = BOOT_ID.read_text().strip() if BOOT_ID.is_file() else platform.node()
    try:
        adjtimex = c.CDLL(None).adjtimex
    except (AttributeError, OSError, TypeError):
        return HostClock(host, kept=False)
    state = _Timex()
    if adjtimex(c.byref(state)) < 0 or state.status & _UNSYNC:
        return HostClock(host, kept=False)
    return HostClock(host, True, state.maxerror * 1e-6, state.esterror * 1e-6)
