"""Write ``bus-load.md`` from the DBC files: ``python docs/evidence/bus_load.py``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("bus-load.md")
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from bridge.can.dbc import load  # noqa: E402
from bridge.can.layout import MessageLayout, find  # noqa: E402
from bridge.can.messages import BusMessage, Role, bus_responses, bus_share  # noqa: E402
from cosim.bus.timing import BusTiming, FrameFormat, best, mean, worst  # noqa: E402

SLOW, CLASSIC = BusTiming(5e5), BusTiming(1e6)
FLEXIBLE, FAST = BusTiming(5e5, 2e6, fd=True), BusTiming(1e6, 5e6, fd=True)
#: What each node sends every tick: text, file, bus, messages without the node's number.
SETS: tuple[tuple[str, str, BusTiming, tuple[str, ...]], ...] = (
    ("2 joints, ξ τ q dq", "link2", SLOW, ("XI", "TAU", "POS", "VEL")),
    ("2 joints, ξ", "link2", CLASSIC, ("XI",)),
    ("2 joints, ξ τ q dq", "link2", CLASSIC, ("XI", "TAU", "POS", "VEL")),
    ("7 joints, ξ", "link", CLASSIC, ("XI_A", "XI_B", "XI_C")),
    ("7 joints, ξ τ", "link", CLASSIC, ("XI_A", "XI_B", "XI_C", "TAU_A", "TAU_B", "TAU_C")),
    ("2 joints, ξ τ q dq", "link_fd2", FAST, ("LINK", "STATE")),
    ("7 joints, ξ τ", "link_fd", FLEXIBLE, ("LINK",)),
    ("7 joints, ξ τ", "link_fd", FAST, ("LINK",)),
    ("7 joints, ξ τ q dq", "link_fd", FAST, ("LINK", "STATE")),
)
NODES = (1, 2, 4, 8)
HEAD = """\
# Bus load

The load and the response times of a CAN bus follow from the lengths of the frames in bits and from
their priorities, so they are known before any hardware is connected. The tables below are made of
the DBC files in `configs/can` by `python docs/evidence/bus_load.py`; a test compares them.

## Methods

**Frame time** (`cosim/bus/timing.py`; in C `bridge/c/load.h`). A frame lasts from its start to the
end of the intermission. Stuff bits and the CRC are computed from its bits, so the time of a frame
with known content is exact (CAN FD: ISO 11898-1:2015, with fixed stuff bits and the stuff count).
With BRS, the bits from ESI to the CRC delimiter have the data bit rate; BRS and CRC delimiter
together take one bit time at each of the two rates, whatever the sample points are. The worst case
has a stuff bit after the first five stuffed bits and after every four more (55 + 10 n bits for a
classic frame with n bytes and an 11-bit identifier). The mean is that of random data.

**Load** (`bridge/can/load.py`) is the sum of frame time over period; of a log it is the fraction of
a window in which the bus was busy. A load above 100 % means that the log is not from one bus with
these bit rates, or that its time stamps are wrong.

**Response time** (`cosim/bus/response.py`) is the longest time from queueing a message to its end:
one frame of lower priority that has just begun, all frames of higher priority, earlier instances of
the message, jitter and, optionally, errors (Davis, Burns, Bril, Lukkien, Real-Time Systems 35,
2007). It holds for nodes that send their most urgent frame first. A node that sends in the order of
queueing, as the default queue of Linux and many USB adapters do, can take longer;
`cosim/bus/arbitration.py` computes the order of frames for both.

**Check** (`bridge/preflight/bus_checks.py`). `cosim check --deploy` refuses a worst-case load above
100 %, an identifier that two nodes send, frames that the bus does not support, messages with a
period shorter than their frame time, and disabled watchdogs. It warns of a load above 70 %, of
response times that may exceed their deadline, of identifiers in CANopen's ranges, of signals larger
than their field, of watchdogs below 2 or above 50 periods (and 100 ms), and of nodes without
heartbeat.
"""
LOAD_TEXT = """\
Worst-case load in %, by rate and number of nodes, with a SYNC of 1 byte every tick and a heartbeat
of 8 bytes every 50 ms from each node; "–": above 100 %.
"""
RESPONSE_TEXT = """\
Worst-case response time of the slowest message that is sent every tick, in ms; "–": no bound.
**Bold**: longer than one tick.
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD, "## Frame times\n", frame_table(), "## Load\n", LOAD_TEXT, load_table()]
    return "\n".join([*parts, "## Response times\n", RESPONSE_TEXT, response_table()])


def frame_table() -> str:
    """Bits of classic frames and times of FD frames."""
    lines = [
        "Bits of a classic frame with an 11-bit identifier, and µs of an FD frame with BRS:\n",
        "| bytes | classic: best | mean | worst | 500k/2M: best | mean | worst "
        "| 1M/5M: best | mean | worst |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    flexible = FrameFormat(fd=True, brs=True)
    for n in (0, 2, 4, 8, 16, 24, 64):
        cells = ["", "", ""]
        if n <= 8:
            cells = [f"{law(n).nominal:.4g}" for law in (best, mean, worst)]
        for timing in (FLEXIBLE, FAST):
            cells += [f"{timing.time_ns(f(n, flexible)) / 1e3:.1f}" for f in (best, mean, worst)]
        lines.append(f"| {n} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def load_table() -> str:
    """Worst-case load of every set, by rate and number of nodes."""

    def cell(file: str, timing: BusTiming, names: tuple[str, ...], n: int, period: float) -> str:
        share = bus_share(messages(file, names, n, period), timing).worst
        return "–" if share > 1 else f"{share * 100:.0f}"

    return _table(cell)


def response_table() -> str:
    """Worst response of a message that is sent every tick, by rate and number of nodes."""

    def cell(file: str, timing: BusTiming, names: tuple[str, ...], n: int, period: float) -> str:
        return slowest(messages(file, names, n, period), timing, period)

    return _table(cell)


def _table(cell: Callable[[str, BusTiming, tuple[str, ...], int, float], str]) -> str:
    """A row for each set, a column for each rate and number of nodes."""
    columns = [(n, period) for period in (5e-3, 1e-3) for n in NODES]
    heads = [f"{1 / period:g} Hz, {n}" for n, period in columns]
    lines = [f"| bus | every node sends | {' | '.join(heads)} |", "|---" * 10 + "|"]
    for text, file, timing, names in SETS:
        cells = [cell(file, timing, names, n, period) for n, period in columns]
        lines.append(f"| {rates(timing)} | {text} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def slowest(found: Sequence[BusMessage], timing: BusTiming, period: float) -> str:
    """The worst response of messages with this period, ms."""
    times = [r.worst for m, r in bus_responses(found, timing) if m.period == period]
    known = [t for t in times if t is not None]
    if len(known) < len(times):
        return "–"
    text = f"{max(known) / 1e6:.2f}"
    return f"**{text}**" if max(known) > period * 1e9 else text


def messages(file: str, names: Sequence[str], count: int, period: float) -> list[BusMessage]:
    """What `count` nodes send, every `period` (s), with SYNC and heartbeats."""
    layouts = read(file)
    found = [_message(layouts, "SYNC", "n1", period, "sync")]
    for n in range(1, count + 1):
        found += [_message(layouts, f"{name}_{n}", f"n{n}", period, "data") for name in names]
        found.append(_message(layouts, f"HEARTBEAT_{n}", f"n{n}", None, "heartbeat"))
    return found


@cache
def read(file: str) -> tuple[MessageLayout, ...]:
    """The layouts of a file, read once."""
    return load(ROOT / "configs" / "can" / f"{file}.dbc")


def _message(
    layouts: Sequence[MessageLayout], name: str, node: str, period: float | None, role: Role
) -> BusMessage:
    return BusMessage.of(find(layouts, name), node=node, bus="can0", period=period, role=role)


def rates(timing: BusTiming) -> str:
    """A bus in words."""
    nominal = f"{timing.bitrate / 1e3:g}k" if timing.bitrate < 1e6 else "1M"
    return f"{nominal}/{(timing.data_bitrate or 0) / 1e6:g}M" if timing.fd else nominal


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
