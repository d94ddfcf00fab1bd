"""``cosim ping`` beside other tools on the same paths: `ping`, and a ping over Zenoh.

    python benchmarks/ping_peers.py [--count N] [--rounds N] [--json FILE]

Two hosts are network namespaces; between them a relay delays every packet by a known law. On each
path, in turns: `ping` of iputils (ICMP, answered by the kernel), `cosim ping udp`, `cosim ping
zenoh`, and what Zenoh's own examples z_ping and z_pong do: publish on one key and wait for the
sample that the other end publishes on another. All ask 100 times a second with 64 bytes (`cosim
ping`: 128). The table holds medians of the rounds.

Needs root (namespaces) and Debian's iputils-ping.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np

from benchmarks import tables
from bridge.relay.network import RelayNetwork

COSIM = (sys.executable, "-m", "cosim")
RATE = 100
QUANTILES = (0, 50, 95, 99)
#: Laws of the relay, the same each way, and the least round trip, ms.
PATHS: dict[str, tuple[dict[str, Any], float]] = {
    "constant 10 ms each way": ({"law": "constant", "delay": "10 ms"}, 20.0),
    "uniform 5 to 25 ms, new every 30 ms": (
        {"law": "uniform", "low": "5 ms", "high": "25 ms", "hold": "30 ms"},
        10.0,
    ),
}
#: The two ends over Zenoh with nothing else: ours listens, and asks `count` times.
FAR = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
with zenoh.open(config) as session:
    answer = session.declare_publisher("bench/pong")
    session.declare_subscriber("bench/ping", lambda sample: answer.put(sample.payload))
    print("ready", flush=True)
    sys.stdin.readline()
"""
NEAR = """
import sys, threading, time, zenoh
config = zenoh.Config()
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
came = threading.Event()
with zenoh.open(config) as session:
    ask = session.declare_publisher("bench/ping")
    session.declare_subscriber("bench/pong", lambda sample: came.set())
    print("ready", flush=True)
    sys.stdin.readline()
    due = time.monotonic()
    for _ in range(int(sys.argv[2])):
        time.sleep(max(0.0, due - time.monotonic()))
        came.clear()
        start = time.perf_counter()
        ask.put(bytes(64))
        if came.wait(2.0):
            print(1e3 * (time.perf_counter() - start), flush=True)
        due += 1 / float(sys.argv[3])
"""
Hosts = RelayNetwork
QUIET: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}


@contextmanager
def started(hosts: Hosts, host: str, *words: str, **options: Any) -> Iterator[Any]:
    """A process on a host, ended by SIGINT and by force."""
    with hosts.on_host(host):
        process = subprocess.Popen(words, text=True, **options)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(2)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def call(hosts: Hosts, *words: str) -> str:
    """Run a program on the near host; its output."""
    with hosts.on_host("near"):
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout


def iputils(hosts: Hosts, count: int) -> list[float]:
    """Round trips of `ping`, ms."""
    to = hosts.addresses["far"]
    said = call(hosts, "ping", "-n", "-i", f"{1 / RATE:g}", "-c", str(count), "-s", "64", to)
    return [float(x) for x in re.findall(r"time=([\d.]+) ms", said)]


def ours_udp(hosts: Hosts, count: int) -> list[float]:
    """Round trips of ``cosim ping udp``, ms."""
    with started(hosts, "far", *COSIM, "pong", **QUIET) as far:
        assert "answers" in far.stderr.readline()
        return ours(hosts, count, "udp", hosts.addresses["far"])


def ours_zenoh(hosts: Hosts, count: int) -> list[float]:
    """Round trips of ``cosim ping zenoh``, ms."""
    at = f"tcp/{hosts.addresses['far']}:7462"
    with started(hosts, "far", *COSIM, "pong", "zenoh", at, **QUIET) as far:
        assert "answers" in far.stderr.readline()
        return ours(hosts, count, "zenoh", at)


def ours(hosts: Hosts, count: int, *path: str) -> list[float]:
    """Both ways of each question as ``cosim ping`` has written them, ms."""
    with tempfile.TemporaryDirectory() as folder:
        words = ("--rate", str(RATE), "--duration", f"{count / RATE:g}", "--out", folder)
        call(hosts, *COSIM, "ping", *path, *words)
        there, back = (
            np.genfromtxt(Path(folder, f"{way}.csv"), delimiter=",", skip_header=1)[:, 1]
            for way in ("there", "back")
        )
    rtt = 1e3 * (there + back)
    return [float(x) for x in rtt[~np.isnan(rtt)]]


def example(hosts: Hosts, count: int) -> list[float]:
    """Round trips as Zenoh's examples measure them, ms."""
    at = f"tcp/{hosts.addresses['near']}:7463"
    piped = {"stdout": subprocess.PIPE, "stdin": subprocess.PIPE}
    words = (sys.executable, "-c", NEAR, at, str(count), str(RATE))
    with started(hosts, "near", *words, **piped) as near:
        assert near.stdout.readline() == "ready\n"
        with started(hosts, "far", sys.executable, "-c", FAR, at, **piped) as far:
            assert far.stdout.readline() == "ready\n"
            call(hosts, "sleep", "1")  # until each knows the other's subscriber
            out, _ = near.communicate("go\n")
            far.communicate("end\n")
    return [float(x) for x in out.split()]


TOOLS: dict[str, Callable[[Hosts, int], list[float]]] = {
    "`ping` (ICMP)": iputils,
    "`cosim ping udp`": ours_udp,
    "`cosim ping zenoh`": ours_zenoh,
    "Zenoh's example": example,
}


def measure(count: int, rounds: int) -> list[dict[str, Any]]:
    """Rows of path, tool, and for each round the answers and quantiles, ms."""
    rows = []
    for path, (delay, least) in PATHS.items():
        found: dict[str, list[list[float]]] = {tool: [] for tool in TOOLS}
        with tempfile.TemporaryDirectory() as folder:
            links = {"*": {"delay": delay}}
            with RelayNetwork(("near", "far"), Path(folder, "packets"), links, seed=1) as hosts:
                for _ in range(rounds):
                    for tool, run in TOOLS.items():
                        rtt = run(hosts, count)
                        found[tool].append([len(rtt), *np.percentile(rtt, QUANTILES)])
        rows += [
            {"path": path, "tool": t, "least": least, "rounds": [list(map(float, r)) for r in runs]}
            for t, runs in found.items()
        ]
    return rows


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=1000, help="questions (default 1000)")
    parser.add_argument("--rounds", type=int, default=3, help="of each (default 3)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    options = parser.parse_args()
    for program in ("ping", "ip"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed (Debian: iputils-ping, iproute2)")
    rows = measure(options.count, options.rounds)
    lines = [
        [r["path"], r["tool"], f"{middle[0]:.0f}", *(f"{x:.2f}" for x in middle[1:]),
         f"{middle[1] - r['least']:.2f}"]
        for r in rows
        for middle in [[median(column) for column in zip(*r["rounds"], strict=True)]]
    ]  # fmt: skip
    header = ("path", "tool", "answers", *(f"p{q}, ms" if q else "min, ms" for q in QUANTILES),
              "min above the relay's least, ms")  # fmt: skip
    print(tables.grid(header, lines))
    if options.json:
        facts = {"machine": tables.machine(), "count": options.count, "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
