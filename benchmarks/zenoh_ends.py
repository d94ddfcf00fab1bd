"""The ends that ``zenoh_latency.py`` compares: two processes a kind, told by lines what to do.

``zenoh_ends.py KIND near|far LIBRARY PRIORITY PORT PORT PORT``. Ours has a loop in C, as a
node's tick is; the others are Python as their users write it. Each message has 56 bytes. Times are
ns of the monotonic clock, one for both processes.
"""

from __future__ import annotations

import ctypes as c
import os
import queue
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np
import zenoh

from benchmarks.zenoh_far import ROW, obey, options, pointer, prefer, tick_library
from bridge.deployment.zenoh_keys import Names, codec
from bridge.native import pace
from bridge.realtime.requests import Realtime, enter
from bridge.zenoh.channel import ZenohAttachment, ZenohTraffic, control_publisher
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.session import configure, open_session
from cosim.base.clock import monotonic_ns, sleep

NAMES = Names("bench")
KEYS = {name: f"bench/node/component/{name}" for name in ("ping", "pong", "way")}
NUMBERS = {"ping": 0x1000, "pong": 0x1001, "way": 0x1002}
CODECS = {n: codec(KEYS[n], NUMBERS[n], ("number", "sent", "x", "y")) for n in KEYS}
PATIENCE = 2.0  # s, for a pong


class End(Protocol):
    """One process's end: the near one pings and streams, the far one echoes and takes."""

    def ready(self) -> None:
        """Until the other end is there."""

    def ping(self, n: int) -> list[int]:
        """What n round trips took, ns."""

    def stream(self, n: int, period_ns: int) -> list[int]:
        """Publish n messages, one a period; what each cost, ns."""

    def taken(self) -> list[list[int]]:
        """Of each message since the last call: number, sent, arrived; ns."""

    def echo(self, on: bool) -> None:
        """Answer pings, or no more."""

    def close(self) -> None:
        """Let go of what is open."""


def where(near: bool, ports: list[int]) -> ZenohOptions:
    """Options of a session: the near end listens."""
    return options(ports[:1] if near else (), () if near else ports[:1])


# ---- ours ----------------------------------------------------------------------------------------


class _Ours:
    """A node's end of a Zenoh bus, and a tick in C."""

    def __init__(self, near: bool, ports: list[int], lib: c.CDLL) -> None:
        said, heard = (("ping", "way"), ("pong",)) if near else (("pong",), ("ping", "way"))
        traffic = ZenohTraffic(
            "near" if near else "far",
            {KEYS[n]: NUMBERS[n] for n in said},
            {KEYS[n]: NUMBERS[n] for n in heard},
            ("far" if near else "near",),
            tuple(KEYS[n] for n in said),
        )
        self.end = ZenohAttachment("net", NAMES, traffic, where(near, ports))
        self._lib, self._bus = lib, c.byref(self.end.bus.struct)
        self._stop, self._thread = c.c_int32(), threading.Thread()
        self._granted = enter(Realtime(priority=0))

    def ready(self) -> None:
        self.end.wait_for_peers()

    def ping(self, n: int) -> list[int]:
        taken = np.zeros(n, np.int64)
        messages = (c.byref(CODECS[name].message) for name in ("ping", "pong"))
        error = self._lib.tick_ping(self._bus, *messages, c.c_int64(n), pointer(taken))
        if error:
            raise OSError(error, f"ours, ping: {os.strerror(error)}")
        return [int(x) for x in taken]

    def stream(self, n: int, period_ns: int) -> list[int]:
        ticks = np.zeros((n, 5), np.int64)
        self._lib.tick_run(
            self._bus, None, c.byref(CODECS["way"].message), c.c_int64(pace.now() + period_ns),
            c.c_int64(period_ns), c.c_int64(n), pointer(ticks),
        )  # fmt: skip
        return [int(x) for x in ticks[:, 1]]

    def taken(self) -> list[list[int]]:
        rows = np.zeros((8192, 3), np.int64)
        way = c.byref(CODECS["way"].message)
        n = self._lib.tick_take(self._bus, way, c.c_int64(len(rows)), pointer(rows))
        return [[int(x) for x in row] for row in rows[:n]]

    def echo(self, on: bool) -> None:
        self._stop.value = not on
        if on:
            messages = (c.byref(CODECS[name].message) for name in ("ping", "pong"))
            arguments = (self._bus, *messages, c.byref(self._stop))
            self._thread = threading.Thread(target=self._lib.tick_echo, args=arguments)
            self._thread.start()
        else:
            self._thread.join()

    def close(self) -> None:
        self._granted.leave()
        self.end.close()


# ---- the others ----------------------------------------------------------------------------------


class _Others:
    """What bare zenoh, UDP and ZeroMQ have in common: messages are bytes, loops are Python."""

    send: dict[str, Callable[[bytes], Any]]
    next_pong: Callable[[], Any]
    close: Callable[[], Any]

    def __init__(self) -> None:
        self.rows: list[tuple[bytes, int]] = []

    def ready(self) -> None:
        pass

    def ping(self, n: int) -> list[int]:
        taken, send, wait = [], self.send["ping"], self.next_pong
        for k in range(n):
            start = monotonic_ns()
            sent = ROW.pack(k, start)
            send(sent)
            while wait() != sent:  # the pong of an earlier one
                pass
            taken.append(monotonic_ns() - start)
        return taken

    def stream(self, n: int, period_ns: int) -> list[int]:
        paid, send, start = [], self.send["way"], pace.now() + period_ns
        for k in range(n):
            pace.wait(start + k * period_ns)
            before = monotonic_ns()
            send(ROW.pack(k, before))
            paid.append(monotonic_ns() - before)
        return paid

    def taken(self) -> list[list[int]]:
        rows, self.rows[:] = list(self.rows), []
        return [[*ROW.unpack(data), arrived] for data, arrived in rows]

    def echo(self, on: bool) -> None:
        """It always does."""

    def _loops(self, ping: Callable[[], bytes], way: Callable[[], bytes]) -> None:
        def answer() -> None:
            while True:
                self.send["pong"](ping())

        def record() -> None:
            while True:
                self.rows.append((way(), monotonic_ns()))

        for loop in (answer, record):
            threading.Thread(target=loop, daemon=True).start()


class _Zenoh(_Others):
    """Bare zenoh-python, our configuration and QoS; `direct`: call-backs on Zenoh's threads.

    `threads`: of Zenoh itself, as our sessions have them.
    """

    def __init__(self, near: bool, ports: list[int], direct: bool, threads: bool) -> None:
        super().__init__()
        config = configure(where(near, ports), "end")
        self.session = open_session(config, "net") if threads else zenoh.open(config)
        self.close = self.session.close
        said = ("ping", "way") if near else ("pong",)
        self._publishers = {
            n: control_publisher(self.session, KEYS[n], "best-effort") for n in said
        }
        self.send = {name: p.put for name, p in self._publishers.items()}
        heard: dict[str, Callable[[zenoh.Sample], None]]
        if near:
            came: queue.SimpleQueue[bytes] = queue.SimpleQueue()
            self.next_pong = lambda: came.get(timeout=PATIENCE)
            heard = {"pong": lambda sample: came.put(sample.payload.to_bytes())}
        else:
            heard = {"ping": self._answer, "way": self._record}
        for name, called in heard.items():
            back = zenoh.handlers.Callback(called, indirect=not direct)
            self.session.declare_subscriber(KEYS[name], back)

    def _answer(self, sample: zenoh.Sample) -> None:
        self.send["pong"](sample.payload.to_bytes())

    def _record(self, sample: zenoh.Sample) -> None:
        self.rows.append((sample.payload.to_bytes(), monotonic_ns()))

    def ready(self) -> None:
        for publisher in self._publishers.values():
            while not getattr(publisher.matching_status, "matching", False):
                sleep(0.01)


class _Udp(_Others):
    """A datagram a message."""

    def __init__(self, near: bool, ports: list[int]) -> None:
        super().__init__()
        here = dict(zip(KEYS, ports, strict=True))
        found = {name: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for name in KEYS}
        said = ("ping", "way") if near else ("pong",)
        for name, opened in found.items():
            end = opened.connect if name in said else opened.bind
            end(("127.0.0.1", here[name]))
        self.send = {name: found[name].send for name in said}
        self.close = lambda: None
        if near:
            found["pong"].settimeout(PATIENCE)
            self.next_pong = lambda: found["pong"].recv(256)
        else:
            self._loops(lambda: found["ping"].recv(256), lambda: found["way"].recv(256))


class _ZeroMQ(_Others):
    """PUB and SUB over TCP."""

    def __init__(self, near: bool, ports: list[int]) -> None:
        import zmq

        super().__init__()
        self._context = zmq.Context()
        self.close = lambda: None  # its threads wait for ever
        said = ("ping", "way") if near else ("pong",)
        found = {}
        for name, port in zip(KEYS, ports, strict=True):
            opened = self._context.socket(zmq.PUB if name in said else zmq.SUB)
            where = f"tcp://127.0.0.1:{port}"
            if name in said:
                opened.bind(where)
            else:
                opened.connect(where)
                opened.setsockopt(zmq.SUBSCRIBE, b"")
            found[name] = opened
        self.send = {name: found[name].send for name in said}
        if near:
            found["pong"].setsockopt(zmq.RCVTIMEO, int(PATIENCE * 1e3))
            self.next_pong = found["pong"].recv
        else:
            self._loops(found["ping"].recv, found["way"].recv)


#: All of Zenoh in one thread; sessions take it from the environment.
ONE = "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx), net: (handover: rx))"


def make(kind: str, near: bool, ports: list[int], path: str) -> End:
    """The end of a kind."""
    if kind.startswith("ours"):
        if kind != "ours":
            os.environ["ZENOH_RUNTIME"] = ONE
        return _Ours(near, ports, tick_library(path))
    if kind.startswith("zenoh"):
        return _Zenoh(near, ports, "direct" in kind, "our threads" in kind)
    return _Udp(near, ports) if kind == "udp" else _ZeroMQ(near, ports)


KINDS = (
    "ours", "ours, one Zenoh thread", "zenoh, default call-back", "zenoh, direct call-back",
    "zenoh, default, our threads", "udp", "zeromq",
)  # fmt: skip


def main() -> None:
    kind, side, path, priority, *ports = sys.argv[1:]
    prefer(int(priority))
    obey(make(kind, side == "near", [int(port) for port in ports], path))


if __name__ == "__main__":
    main()
