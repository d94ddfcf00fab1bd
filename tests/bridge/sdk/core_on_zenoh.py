"""The C core of a participant behind its C functions, with eclipse-zenoh as its transport.

``python core_on_zenoh.py LIBRARY PREFIX NODE LISTEN CONNECT``; nothing of this project is imported.
"""

from __future__ import annotations

import ctypes as c
import hashlib
import json
import queue
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import zenoh


class Frame(c.Structure):
    """``frame_t`` of participant.h."""

    _fields_ = (
        ("t_ns", c.c_int64), ("id", c.c_uint32), ("flags", c.c_uint8), ("bus", c.c_uint8),
        ("length", c.c_uint16), ("sequence", c.c_uint32), ("reserved", c.c_uint32),
        ("data", c.c_uint8 * 232),
    )  # fmt: skip


class Host(c.Structure):
    """``participant_host_t``."""

    _fields_ = (
        ("number", c.c_int32), ("kept", c.c_int32), ("identity", c.c_double * 4),
        ("error", c.c_double), ("date_offset_ns", c.c_int64), ("text", c.c_char * 64),
    )  # fmt: skip


Send = c.CFUNCTYPE(None, c.c_void_p, c.c_int32, c.POINTER(Frame), c.c_char_p)
Step = c.CFUNCTYPE(None, c.c_void_p, c.c_void_p, c.c_double, c.c_double)


def declared(path: str) -> Any:
    """The library with the types of its functions."""
    lib = c.CDLL(path)
    lib.participant_poll.restype = c.c_int64
    lib.participant_poll.argtypes = [c.c_void_p, c.c_int64]
    lib.participant_host.restype = c.POINTER(Host)
    lib.participant_subscription.restype = c.c_char_p
    lib.participant_output.restype = c.POINTER(c.c_double)
    return lib


def describe(host: Host) -> None:
    """This host, and its date."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    digest = hashlib.sha256(boot.encode()).digest()
    host.number = zlib.crc32(boot.encode()) % 255 + 1
    host.identity[:] = [int.from_bytes(digest[i : i + 4], "big") for i in range(0, 16, 4)]
    host.date_offset_ns = time.time_ns() - time.monotonic_ns()
    host.text = boot.encode()


def session_of(listen: str, connect: str) -> zenoh.Session:
    """A session with these endpoints only."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, value in (("listen", listen), ("connect", connect)):
        config.insert_json5(f"{key}/endpoints", json.dumps(value.split(",") if value else []))
    return zenoh.open(config)


class Core:
    """A participant and its session."""

    def __init__(self, path: str, session: zenoh.Session, name: str) -> None:
        self.lib, self.session, self.name = declared(path), session, name
        self.p = c.create_string_buffer(self.lib.participant_size())
        self.came: queue.Queue[Frame] = queue.Queue()
        self.publishers: dict[bytes, zenoh.Publisher] = {}
        self.kept = (Send(self.send), Step(self.step))
        table = c.byref(c.c_char.in_dll(self.lib, "TABLE"))
        self.lib.participant_init(self.p, table, *self.kept, None)
        describe(self.lib.participant_host(self.p).contents)
        self.declare()

    def declare(self) -> None:
        """Subscriptions, queries, and the token that it is there."""
        bus, number, i = c.c_int32(), c.c_uint32(), 0
        while (
            key := self.lib.participant_subscription(self.p, i, c.byref(bus), c.byref(number))
        ) is not None:
            if key:
                self.subscribe(key.decode(), bus.value, number.value)
            i += 1
        for what in ("state", "parameters", "clock"):
            self.session.declare_queryable(f"{self.name}/{what}", self.answer)
        self.tokens = [self.token("alive")]

    def token(self, what: str) -> zenoh.LivelinessToken:
        return self.session.liveliness().declare_token(f"{self.name}/{what}")

    def subscribe(self, key: str, bus: int, number: int) -> None:
        def came(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            frame = Frame(t_ns=time.monotonic_ns(), id=number, bus=bus, length=len(data))
            c.memmove(frame.data, data, len(data))
            self.came.put(frame)

        self.session.declare_subscriber(key, came)

    def answer(self, query: zenoh.Query) -> None:
        text = c.create_string_buffer(4096)
        what = str(query.key_expr).rpartition("/")[2]
        self.lib.participant_answer(self.p, what.encode(), text, 4096)
        query.reply(query.key_expr, text.value)

    def send(self, _: object, bus: int, frame: Any, key: bytes) -> None:
        if key not in self.publishers:
            self.publishers[key] = self.session.declare_publisher(
                key.decode(), express=True, priority=zenoh.Priority.REAL_TIME
            )
        self.publishers[key].put(c.string_at(frame.contents.data, frame.contents.length))

    def step(self, _: object, p: object, t: float, h: float) -> None:
        """A value that changes in every slot."""
        self.lib.participant_output(self.p, 0)[0] = 0.1 * t

    def run(self) -> None:
        """Until its end."""
        due = time.monotonic_ns()
        while due >= 0:
            try:
                left = max(0.0, (due - time.monotonic_ns()) * 1e-9)
                self.lib.participant_hear(self.p, c.byref(self.came.get(timeout=left)))
            except queue.Empty:
                pass
            due = self.lib.participant_poll(self.p, time.monotonic_ns())
            if len(self.tokens) == 1 and self.lib.participant_ready(self.p):
                self.tokens.append(self.token("ready"))


if __name__ == "__main__":
    library, prefix, node, listen, connect = sys.argv[1:]
    with session_of(listen, connect) as opened:
        Core(library, opened, f"{prefix}/{node}").run()
