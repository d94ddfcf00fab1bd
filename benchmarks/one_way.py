"""One way between two processes: our Zenoh bus, bare zenoh, UDP, ZeroMQ.

    python benchmarks/one_way.py [--quick] [--json FILE] [--blocks N] [--seconds S] [--rates HZ ...]

Each message is 56 bytes and carries when it was sent; the receiver stamps its arrival, on the same
clock (CLOCK_MONOTONIC). Ours is from `bus_send` in the tick to the stamp the tick reads: codec,
ring, a sending thread, and a call-back. The kinds run a block each, in turns; all over TCP or UDP
on the loopback interface. Also: what a tick pays for `bus_send`, and the gaps between arrivals.
Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np
import zenoh
import zmq

from bridge.native import pace
from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.zenoh.channel import Traffic, ZenohAttachment
from bridge.zenoh.names import Names, codec
from bridge.zenoh.options import Options
from bridge.zenoh.session import configure, open_session
from cosim.clock import sleep

KINDS = ("ours", "zenoh", "udp", "zeromq")
KEY = "bench/a/c/m"
NAMES = Names("bench")
CODEC = codec(KEY, 0x1000, ("k", "t_ns", "x", "y"))
LAST = 2.0  # s without a message, after which the receiver ends


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        port: int = found.getsockname()[1]
        return port


def ours(node: str, port: int) -> ZenohAttachment:
    where = (f"tcp/127.0.0.1:{port}",)
    listens = node == "b"
    options = Options(
        "benchmark", listen=where if listens else (), connect=() if listens else where
    )
    publishes, hears = ({}, {KEY: 0x1000}) if listens else ({KEY: 0x1000}, {})
    peers, awaited = ("a" if listens else "b",), () if listens else (KEY,)
    found = ZenohAttachment("net", NAMES, Traffic(node, publishes, hears, peers, awaited), options)
    return found


def session(port: int, listens: bool) -> zenoh.Session:
    where = (f"tcp/127.0.0.1:{port}",)
    options = Options(
        "benchmark", listen=where if listens else (), connect=() if listens else where
    )
    return open_session(configure(options, "x"), "net")


# ---- receiving -----------------------------------------------------------------------------------


def receive(kind: str, port: int, path: Path) -> None:
    """Arrivals (n, 2): sent, arrived, ns, into a file."""
    found: list[tuple[float, int]] = []
    {"ours": _ours, "zenoh": _zenoh, "udp": _udp, "zeromq": _zeromq}[kind](port, found)
    np.save(path, np.array(found))


def taken(data: bytes, t_ns: int, found: list[tuple[float, int]]) -> None:
    _, values, _ = CODEC.decode(data)
    found.append((values[1], t_ns))


def quiet(count: Callable[[], int]) -> None:
    """Until messages have come and no more come."""
    before = -1
    while count() == 0 or count() != before:
        before = count()
        sleep(LAST)


def _ours(port: int, found: list[tuple[float, int]]) -> None:
    end = ours("b", port)
    said()
    frames: list[Frame] = []

    def drained() -> int:
        frames.extend(end.bus.drain())
        return len(frames)

    quiet(drained)
    for frame in frames:
        taken(frame.payload, frame.t_ns, found)
    end.close()


def _zenoh(port: int, found: list[tuple[float, int]]) -> None:
    opened = session(port, listens=True)
    raw: list[tuple[bytes, int]] = []

    def came(sample: zenoh.Sample) -> None:
        raw.append((sample.payload.to_bytes(), pace.now()))

    opened.declare_subscriber(KEY, zenoh.handlers.Callback(came, indirect=False))
    said()
    quiet(lambda: len(raw))
    for data, t_ns in raw:
        taken(data, t_ns, found)
    opened.close()


def _udp(port: int, found: list[tuple[float, int]]) -> None:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", port))
    said()
    raw: list[tuple[bytes, int]] = []
    opened.settimeout(None)
    while True:
        try:
            raw.append((opened.recv(256), pace.now()))
        except TimeoutError:
            break
        opened.settimeout(LAST)
    for data, t_ns in raw:
        taken(data, t_ns, found)


def _zeromq(port: int, found: list[tuple[float, int]]) -> None:
    opened = zmq.Context().socket(zmq.SUB)
    opened.connect(f"tcp://127.0.0.1:{port}")
    opened.setsockopt(zmq.SUBSCRIBE, b"")
    said()
    raw: list[tuple[bytes, int]] = []
    while not raw or opened.poll(int(LAST * 1e3)):
        raw.append((opened.recv(), pace.now()))
    for data, t_ns in raw:
        taken(data, t_ns, found)


def said() -> None:
    print("ready", flush=True)


# ---- sending -------------------------------------------------------------------------------------


class Sender:
    """One kind's way of sending, `paid` (ns) what each call took its caller."""

    def __init__(self, kind: str, port: int) -> None:
        self.kind, self.paid = kind, list[int]()
        self.close: Callable[[], Any]
        if kind == "ours":
            end = ours("a", port)
            self.send, self.close = end.bus.send, end.close
            self.wait = end.wait_for_peers
        elif kind == "zenoh":
            opened = session(port, listens=False)
            publisher = opened.declare_publisher(
                KEY, priority=zenoh.Priority.REAL_TIME, express=True,
                congestion_control=zenoh.CongestionControl.DROP,
                reliability=zenoh.Reliability.BEST_EFFORT,
            )  # fmt: skip
            self.send, self.close = self._bytes(publisher.put), opened.close
        elif kind == "udp":
            plain = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            plain.connect(("127.0.0.1", port))
            self.send, self.close = self._bytes(plain.send), plain.close
        else:
            context = zmq.Context()
            bound = context.socket(zmq.PUB)
            bound.bind(f"tcp://127.0.0.1:{port}")
            self.send, self.close = self._bytes(bound.send), context.destroy

    @staticmethod
    def _bytes(put: Callable[[bytes], Any]) -> Callable[[Frame], Any]:
        return lambda frame: put(frame.payload)

    def run(self, n: int, rate: float) -> None:
        """Send n messages at a rate, 1/s."""
        if self.kind == "ours":
            self.wait()
        sleep(0.5)  # subscriptions travel
        start, period = pace.now() + 10_000_000, round(1e9 / rate)
        for k in range(n):
            pace.wait(start + k * period)
            t_ns = pace.now()
            frame = CODEC.frame([k, t_ns, 0, 0], Header(counter=k))
            before = pace.now()
            self.send(frame)
            self.paid.append(pace.now() - before)


def block(kind: str, n: int, rate: float) -> dict[str, float]:
    """One-way times of n messages, us."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arrivals.npy"
        command = [sys.executable, __file__, "--receive", kind, str(port), str(path)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        if kind == "zeromq":
            sender = Sender(kind, port)
            process.stdout.readline()
        else:
            process.stdout.readline()
            sender = Sender(kind, port)
        sender.run(n, rate)
        process.wait(60)
        sender.close()
        found = np.load(path)
    way = (found[:, 1] - found[:, 0]) / 1e3
    p50, p99, p999 = np.percentile(way, [50, 99, 99.9])
    return {
        "p50": p50, "p99": p99, "p999": p999, "maximum": way.max(), "lost": n - len(way),
        "jitter": float(np.std(np.diff(found[:, 1]))) / 1e3,
        "paid": float(np.median(sender.paid)) / 1e3,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--blocks", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[200.0, 1000.0])
    parser.add_argument("--receive", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.receive:
        kind, port, path = given.receive
        receive(kind, int(port), Path(path))
        return
    blocks, seconds = (1, 1.0) if given.quick else (given.blocks, given.seconds)
    results: dict[str, dict[str, dict[str, float]]] = {}
    for rate in given.rates:
        rows: dict[str, list[dict[str, float]]] = {kind: [] for kind in KINDS}
        for _ in range(blocks):
            for kind in KINDS:
                rows[kind].append(block(kind, round(rate * seconds), rate))
        results[f"{rate:g} Hz"] = {
            kind: {key: float(np.median([r[key] for r in got])) for key in got[0]}
            for kind, got in rows.items()
        }
        show(f"{rate:g} Hz", results[f"{rate:g} Hz"])
    if given.json:
        given.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


def show(rate: str, rows: dict[str, dict[str, float]]) -> None:
    names = ("p50", "p99", "p999", "maximum", "jitter", "paid", "lost")
    print(f"{rate}: one way, us; median of blocks")
    print(f"{'':8}" + "".join(f"{n:>9}" for n in names) + "   to bare zenoh")
    for kind, row in rows.items():
        ratio = row["p50"] / rows["zenoh"]["p50"]
        print(f"{kind:8}" + "".join(f"{row[n]:9.1f}" for n in names) + f"   {ratio:.2f}")


if __name__ == "__main__":
    main()
