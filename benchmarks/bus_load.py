"""What the bit times of frames cost: ``python benchmarks/bus_load.py``, a Markdown table."""

from __future__ import annotations

import ctypes
import sys
import timeit
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from bridge.can.load import log_bits, log_times, measured_load  # noqa: E402
from bridge.native import load as native  # noqa: E402
from bridge.native.frame import Frame  # noqa: E402
from bridge.native.library import library  # noqa: E402
from cosim.bus.structs import BitsStruct  # noqa: E402
from cosim.bus.timing import BusTiming, FrameFormat, frame_bits  # noqa: E402

LOG = 1_000_000


def best_of(work: Callable[[], object], times: int) -> float:
    """The least of five, s a call."""
    return min(timeit.repeat(work, number=times, repeat=5)) / times


def frames(length: int, flags: int) -> list[str]:
    """A row: us a frame in Python and C, s a log of 10^6, s its busiest window."""
    random = np.random.default_rng(1)
    kind = FrameFormat(fd=bool(flags), brs=bool(flags))
    data = [random.bytes(length) for _ in range(1000)]
    structs = (Frame * 1000)(*(Frame.of(0x123, d, flags) for d in data))
    refs, bits = [ctypes.byref(s) for s in structs], BitsStruct()
    native.frame_bits_exact(structs[0])
    exact, out = library().frame_bits_exact, ctypes.byref(bits)
    python = best_of(lambda: [frame_bits(0x123, d, kind) for d in data], 5) / 1000
    in_c = best_of(lambda: [exact(ref, out) for ref in refs], 5) / 1000
    log = (
        random.integers(0, 64, LOG).astype(np.uint32),
        np.full(LOG, flags, np.uint8),
        np.full(LOG, length, np.uint16),
        random.integers(0, 256, (LOG, 64), dtype=np.uint8),
    )
    whole = best_of(lambda: log_bits(*log), 1)
    durations = log_times(log_bits(*log), BusTiming(1e6, 5e6))
    window = best_of(lambda: measured_load(np.cumsum(durations), durations), 1)
    return [f"{python * 1e6:.1f}", f"{in_c * 1e6:.2f}", f"{whole:.2f}", f"{window:.2f}"]


def main() -> None:
    print("| frame | Python, µs | C through ctypes, µs | log of 10^6, s | busiest window, s |")
    print("|---|---|---|---|---|")
    for name, length, flags in (("classic, 8 B", 8, 0), ("FD, 64 B", 64, 3)):
        print(f"| {name} | {' | '.join(frames(length, flags))} |")


if __name__ == "__main__":
    main()
