"""Cost of programs in bus time: ``python -m benchmarks.foreign_programs [REPEAT]``.

Two programs of can-isotp send 100 bytes with STmin = 5 ms (`tests/bridge/bus_server/programs`).
Measured is the wall time from bus time 0.1 s, when the transfer begins, to 0.173 s, when it is
over: without the start of the interpreters. Also, of a thread that reads the clock until 10 s of
bus time have passed, the wall time of a second of it.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from pathlib import Path

from bridge.bus_server.programs import Programs
from bridge.simulated_can.options import channel_options

TRANSFER = (0.1, 0.173)
"""Bus time at the start and the end of the transfer, s."""
PROGRAMS = Path(__file__).parents[1] / "tests/bridge/bus_server/programs"
SPIN = "import time\nend = time.perf_counter() + 10\nwhile time.perf_counter() < end: pass"


def wall(commands: list[list[str]], begin: float, end: float) -> float:
    """The wall time between two times of the bus (s), s."""
    options = channel_options("bench", bitrate=500_000, speed="simulated")
    found = Programs("bench", options, commands)
    try:
        found.start()
        found.run(begin)
        start = time.perf_counter()
        found.run(end)
        return time.perf_counter() - start
    finally:
        found.close()


def main(repeat: int) -> None:
    """Print both figures, each the median and the range of `repeat` runs."""
    names = ("isotp_receiver.py", "isotp_sender.py")
    pair = [[sys.executable, str(PROGRAMS / name)] for name in names]
    transfer = [wall(pair, *TRANSFER) * 1e3 for _ in range(repeat)]
    spin = [wall([[sys.executable, "-c", SPIN]], 1.0, 9.0) / 8 * 1e3 for _ in range(repeat)]
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for what, found in (("transfer", transfer), ("a second of spinning", spin)):
        middle = statistics.median(found)
        print(f"{what}: {middle:.0f} ms ({min(found):.0f} to {max(found):.0f} ms)")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
