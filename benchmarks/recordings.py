"""Memory and time of `cosim delays from` on files of growing size.

    python benchmarks/recordings.py [--sizes 10 100 300] [--quick] [--json FILE]

Synthetic recordings of messages of 1 kB (MCAP, one topic with header stamps) and of two captures
(pcap) of packets of 142 bytes, one at each end. Each is read by the command in a new process, of
which the peak of resident memory (of its worker, too) and the wall time are measured.
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from cosim.base.clock import stopwatch

START, PERIOD = 1_790_000_000_000_000_000, 1_000_000
COMMAND = str(Path(sys.executable).with_name("cosim"))


def write_mcap(path: Path, size: int) -> int:
    """An MCAP file of about `size` bytes; the number of its messages."""
    from mcap.writer import CompressionType, Writer

    n, rest = size // 1060, bytes(1000)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2msg", b"std_msgs/Header header\n")
        topic = writer.register_channel("/topic", "cdr", schema)
        for i in range(n):
            sent = START + i * PERIOD
            data = struct.pack("<IiI", 0x100, sent // 10**9, sent % 10**9) + rest
            received = sent + 2_000_000 + i * 7919 % 900_000
            writer.add_message(topic, received, data, received)
        writer.finish()
    return n


def write_pcap(path: Path, size: int, late: bool) -> int:
    """A capture of about `size` bytes at the end that sends, or at the other; its packets."""
    n, filling = size // 158, bytes(92)
    head = (
        b"\2" * 6 + b"\4" * 6 + b"\x08\0" + b"\x45\0" + struct.pack(">HHHBBH", 128, 0, 0, 64, 17, 0)
    )
    head += b"\x0a\0\0\1" + b"\x0a\0\0\2" + struct.pack(">HHHH", 5000, 6000, 108, 0)
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1))
        for i in range(n):
            t = START + i * PERIOD + (2_000_000 + i * 7919 % 900_000 if late else 0)
            packet = head + struct.pack("<Q", i) + filling
            length = len(packet)
            file.write(struct.pack("<IIII", t // 10**9, t % 10**9, length, length) + packet)
    return n


def measure(*files: Path) -> tuple[float, float]:
    """Wall time, s, and peak of resident memory, MB, of the command on `files`."""
    call = [COMMAND, "delays", "from", *map(str, files), "--out", str(files[0].parent / "out")]
    watch = stopwatch()
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(call)} ended with {process.returncode}")
    return watch(), usage.ru_maxrss / 1000


def rows(sizes: Sequence[int]) -> list[dict[str, Any]]:
    """A row for each kind and size (MB)."""
    found = []
    for size in sizes:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "a.mcap"
            n = write_mcap(path, size * 10**6)
            found.append(_row("mcap", size, n, *measure(path)))
            path.unlink()
            ends = [Path(folder) / f"{name}.pcap" for name in ("here", "there")]
            for late, end in enumerate(ends):
                n = write_pcap(end, size * 10**6, bool(late))
            found.append(_row("pcap, both ends", size, n, *measure(*ends)))
    return found


def _row(kind: str, size: int, n: int, wall: float, memory: float) -> dict[str, Any]:
    return {"kind": kind, "size": size, "samples": n, "wall": wall, "memory": memory}


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 100, 300])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = rows([1] if given.quick else given.sizes)
    print("| recording | MB | samples | wall time, s | peak memory, MB |")
    print("|---|---:|---:|---:|---:|")
    for row in found:
        print(
            f"| {row['kind']} | {row['size']} | {row['samples']} | {row['wall']:.1f} | "
            f"{row['memory']:.0f} |"
        )
    if given.json is not None:
        given.json.write_text(json.dumps({"rows": found}, indent=1))


if __name__ == "__main__":
    main()
