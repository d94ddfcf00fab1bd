"""``epoch.h``: which run is on the buses, and when its t = 0 was."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.native.enums import EPOCH_DATE_HOST, EPOCH_DATE_RUN
from bridge.native.library import library

__all__ = ["IDENTITY", "SIGNALS", "before", "new_run", "values"]
#: Values of the message, in this order. `origin`: date of t = 0, us, modulo 2^33 * 10 us.
SIGNALS = ("run", "host", "kept", "origin")
#: What follows where there is room: the identity of the host, 32 bits each.
IDENTITY = ("identity_0", "identity_1", "identity_2", "identity_3")


def values(
    run: int, host: int, kept: bool, date_ns: int, identity: Sequence[float] = ()
) -> list[float]:
    """Values of the message, for a run whose t = 0 has this date (ns since 1970).

    `identity`: of the host (4,), where the message has room for it.
    """
    return [run, host, float(kept), float(library().epoch_origin_us(date_ns)), *identity]


def before(host: int, date_ns: int, identity: Sequence[float]) -> list[list[float]]:
    """Values of HOST and DATE, which come before an EPOCH without room for the identity of the
    host. `date_ns`: at which they are sent (ns since 1970); `identity`: (4,).
    """
    number = host & EPOCH_DATE_RUN
    named = [number, EPOCH_DATE_HOST, 1.0, identity[0] * 10.0]
    return [named, values(number, EPOCH_DATE_HOST, False, date_ns)]


def new_run(origin_ns: int) -> int:
    """A number for the run with this t = 0."""
    return int(library().epoch_run(origin_ns))
