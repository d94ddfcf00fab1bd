"""Write ``docs/bus-load.md`` from the DBC files: ``python docs/bus_load.py`` in the checkout."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "bus-load.md"
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
    ("2 joints, ξ", "link2", SLOW, ("XI",)),
    ("2 joints, ξ τ", "link2", SLOW, ("XI", "TAU")),
    ("2 joints, ξ τ q dq", "link2", SLOW, ("XI", "TAU", "POS", "VEL")),
    ("2 joints, ξ", "link2", CLASSIC, ("XI",)),
    ("2 joints, ξ τ", "link2", CLASSIC, ("XI", "TAU")),
    ("2 joints, ξ τ q dq", "link2", CLASSIC, ("XI", "TAU", "POS", "VEL")),
    ("7 joints, ξ", "link", CLASSIC, ("XI_A", "XI_B", "XI_C")),
    ("7 joints, ξ τ", "link", CLASSIC, ("XI_A", "XI_B", "XI_C", "TAU_A", "TAU_B", "TAU_C")),
    ("2 joints, ξ τ", "link_fd2", FAST, ("LINK",)),
    ("2 joints, ξ τ q dq", "link_fd2", FAST, ("LINK", "STATE")),
    ("7 joints, ξ τ", "link_fd", FLEXIBLE, ("LINK",)),
    ("7 joints, ξ τ", "link_fd", FAST, ("LINK",)),
    ("7 joints, ξ τ q dq", "link_fd", FAST, ("LINK", "STATE")),
)
NODES = range(1, 9)
HEAD = """\
# Bus load

What a CAN bus can carry is known before anything is wired: frames have lengths in bits, and
priorities decide who waits. The tables below are written from the DBC files in `configs/can` by
`python docs/bus_load.py`; a test compares them with this page.

## How it is computed

**A frame** (`cosim/bus/timing.py`; in C `bridge/c/load.h`) lasts from its start to the end of the
intermission. Stuff bits and CRC-15 are those of the frame's own bits, so a frame that is known has
an exact time. FD frames are those of ISO 11898-1:2015: dynamic stuff bits to the end of the data,
then a CRC field with fixed stuff bits and the stuff count; with BRS, ESI to CRC delimiter have the
data bit rate. Both switches are at a sample point; the sum of BRS and CRC delimiter is one bit at
each rate whatever the sample points, so that the time of the frame is exact. The worst case has a
stuff bit after the first five stuffed bits and after every four more (55 + 10 n bits of a classic
frame with n bytes and an 11-bit identifier); no data exceeds it, most stays a few bits below. The
mean is over random data. The counts agree with a frame built bit by bit, with `canbusload -e` for
classic data frames, and between Python, NumPy and C.

**Load** (`bridge/can/load.py`) is frame time over period, summed. Of a log it is the time the bus
was busy in a window, for the busiest window wherever it begins. More than 100 % cannot be: the log
is not from one bus of these bit rates, or its times are wrong.

**Response time** (`cosim/bus/response.py`) is the longest from queueing a message to its end: one
frame of lower priority that has just begun, all frames of higher priority, earlier instances of the
same message, jitter and, if asked for, errors (Davis, Burns, Bril, Lukkien, Real-Time Systems 35,
2007). In the tests no simulated bus exceeds it, and the critical instant reaches it. It holds for
nodes that send their most urgent frame first. A node that sends in the order of queueing, as the
default queue of Linux and many USB adapters do, can take longer; `cosim/bus/arbitration.py`
orders both. [The simulated bus](bus.md) does so with errors, queues and fault confinement.

**The check** (`bridge/preflight/bus_checks.py`) refuses more than 100 % in the worst case, one
identifier from two nodes, frames that the bus or CAN does not have, messages more frequent than
they are long, and watchdogs that are off. It warns above 70 %, where a response may exceed its
deadline, of identifiers in CANopen's ranges, of signals larger than their field, of watchdogs
below 2 or above 50 periods (and 100 ms), and of nodes without heartbeat.
"""
COST = """\
## What it costs

`python benchmarks/bus_load.py` measures it. On two shared cores of a virtual machine, with Python
3.11: one frame of 8 bytes about 4 µs in Python and 0.3 µs in C, one of 64 bytes 10 µs and 1 µs; a
log of 10⁶ frames of 8 bytes 0.3 s, of 64 bytes 1 s, its busiest window another 0.4 s.
"""

LOAD_TEXT = {
    5e-3: """\
Worst case in %, by number of nodes, with a SYNC of 1 byte every tick and a heartbeat of 8 bytes
every 50 ms from each node; "–": over 100 %.
""",
    1e-3: "The same at 1 kHz.\n",
}
RESPONSE_TEXT = """\
Worst case of the slowest message that is sent every tick, in ms; "–": no bound. **Bold**: later
than the next tick.
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD, "## Frame times\n", frame_table()]
    for period in (5e-3, 1e-3):
        parts += [f"## Load at {1 / period:g} Hz\n", LOAD_TEXT[period], load_table(period)]
    return "\n".join([*parts, "## Response times\n", RESPONSE_TEXT, response_table(), COST])


def frame_table() -> str:
    """Bits of classic frames and times of FD frames."""
    lines = [
        "Bits of a classic frame with an 11-bit identifier, and µs of an FD frame with BRS:\n",
        "| bytes | classic: best | mean | worst | 500k/2M: best | mean | worst "
        "| 1M/5M: best | mean | worst |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    flexible = FrameFormat(fd=True, brs=True)
    for n in (0, 1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64):
        cells = ["", "", ""]
        if n <= 8:
            cells = [f"{law(n).nominal:.4g}" for law in (best, mean, worst)]
        for timing in (FLEXIBLE, FAST):
            cells += [f"{timing.time_ns(f(n, flexible)) / 1e3:.1f}" for f in (best, mean, worst)]
        lines.append(f"| {n} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def load_table(period: float) -> str:
    """Worst-case load of every set, by number of nodes."""
    lines = [f"| bus | every node sends | {' | '.join(map(str, NODES))} |", "|---" * 10 + "|"]
    for text, file, timing, names in SETS:
        shares = [bus_share(messages(file, names, n, period), timing).worst for n in NODES]
        cells = " | ".join("–" if share > 1 else f"{share * 100:.0f}" for share in shares)
        lines.append(f"| {rates(timing)} | {text} | {cells} |")
    return "\n".join([*lines, ""])


def response_table() -> str:
    """Worst response of a message that is sent every tick, for some numbers of nodes."""
    counts = (1, 2, 4, 8)
    heads = [f"{1 / period:g} Hz, {n}" for period in (5e-3, 1e-3) for n in counts]
    lines = [f"| bus | every node sends | {' | '.join(heads)} |", "|---" * 10 + "|"]
    for text, file, timing, names in SETS:
        cells = [
            slowest(messages(file, names, n, period), timing, period)
            for period in (5e-3, 1e-3)
            for n in counts
        ]
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
