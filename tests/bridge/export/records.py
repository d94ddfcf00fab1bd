"""An image of a node, spoken to in records over its serial line, beside the twin's journals."""

from __future__ import annotations

import select
import socket
import struct
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bridge.deployment.system import System
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.records.node_lives import Life
from bridge.replay import twin
from bridge.wiring.wiring import HEARD

MAGIC = 0xC5
WALL, SLOTS = 0, 1


def crc(data: bytes) -> int:
    """CRC-16 with the polynomial 0x1021 and the start 0xFFFF, bit by bit."""
    state = 0xFFFF
    for byte in data:
        state ^= byte << 8
        for _ in range(8):
            state = (state << 1 ^ (0x1021 if state & 0x8000 else 0)) & 0xFFFF
    return state


def record(kind: str, payload: bytes = b"") -> bytes:
    """A record of this type."""
    body = kind.encode() + struct.pack("<H", len(payload)) + payload
    return bytes([MAGIC]) + body + struct.pack("<H", crc(body))


def frame_record(bus: int, flags: int, identifier: int, t_ns: int, data: bytes) -> bytes:
    """A frame that arrives at the image."""
    return record("f", struct.pack("<BBBBIq", bus, flags, len(data), 0, identifier, t_ns) + data)


class Line(Protocol):
    """The host's end of a serial line."""

    def send(self, data: bytes) -> None: ...
    def receive(self) -> bytes: ...
    def waits(self, seconds: float) -> bool:
        """True if something comes within this time."""
        ...


@dataclass
class Host:
    """Records to and from an image; `skipped`: bytes that belong to none."""

    line: Line
    skipped: int = 0
    _input: bytearray = field(default_factory=bytearray)

    def say(self, *records: bytes) -> None:
        self.line.send(b"".join(records))

    def next(self) -> tuple[str, bytes]:
        """The next record."""
        while True:
            found = self._whole()
            if found is not None:
                return found
            self._input += self.line.receive()

    def until(self, kind: str) -> dict[str, list[bytes]]:
        """All records to the first of this type, by type; lines for people, too."""
        found: dict[str, list[bytes]] = {}
        while kind not in found:
            what, payload = self.next()
            found.setdefault(what, []).append(payload)
        return found

    def hello(self, mode: int) -> bytes:
        """Ask for a mode until the image answers: what comes before it has started may be lost."""
        while True:
            self.say(record("m", bytes([mode])))
            if self.line.waits(1.0):
                return self.until("h")["h"][0]

    def _whole(self) -> tuple[str, bytes] | None:
        while self._input:
            raw = self._input
            if raw[0] == MAGIC:
                if len(raw) < 4:
                    return None
                end = 4 + int.from_bytes(raw[2:4], "little")
                if len(raw) < end + 2:
                    return None
                if crc(bytes(raw[1:end])) == int.from_bytes(raw[end : end + 2], "little"):
                    found = chr(raw[1]), bytes(raw[4:end])
                    del raw[: end + 2]
                    return found
            self.skipped += 1
            del raw[:1]
        return None


class Pipes:
    """A native image: its standard input and output."""

    def __init__(self, image: Path) -> None:
        self.process = subprocess.Popen([image], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def send(self, data: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(data)
        self.process.stdin.flush()

    def receive(self) -> bytes:
        assert self.process.stdout is not None
        found: bytes = self.process.stdout.read1(65536)  # type: ignore[attr-defined]
        assert found, "the image has ended"
        return found

    def waits(self, seconds: float) -> bool:
        return bool(select.select([self.process.stdout], [], [], seconds)[0])


class Serial:
    """An image in QEMU: its serial line is a Unix socket."""

    def __init__(self, command: Sequence[str], folder: Path) -> None:
        path = folder / "line"
        self.server = socket.socket(socket.AF_UNIX)
        self.server.bind(str(path))
        self.server.listen(1)
        quiet = ["-nographic", "-monitor", "none", "-serial", f"unix:{path}"]
        self.process = subprocess.Popen([*command, *quiet], stdin=subprocess.DEVNULL)
        self.server.settimeout(20)
        self.socket, _ = self.server.accept()
        self.socket.settimeout(60)

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def receive(self) -> bytes:
        found = self.socket.recv(65536)
        assert found, "the image has ended"
        return found

    def waits(self, seconds: float) -> bool:
        return bool(select.select([self.socket], [], [], seconds)[0])


@contextmanager
def image(line: Pipes | Serial) -> Iterator[Host]:
    """An image until the end of the block."""
    try:
        yield Host(line)
    finally:
        line.process.kill()
        line.process.wait()


@dataclass(frozen=True)
class Recorded:
    """A node of a twin: rows of its two journals, and frames by bus, received and sent."""

    rows: Any
    heard: Any
    received: Any
    sent: Any


def recorded(system: System, node: str, folder: Path) -> Recorded:
    """Run the twin; what it has of a node."""
    folder.mkdir(exist_ok=True)
    with twin.wired_nodes(system, folder, logged=True) as nodes:
        twin.run(system, nodes)
    life = Life(node)
    logs = [Journal.open(folder / life.frames(bus)).copy() for bus in system.buses_of(node)]
    for number, log in enumerate(logs):
        log["bus"] = number
    every = np.concatenate(logs)
    sent = (every["flags"] & Flags.SENT) != 0
    return Recorded(
        Journal.open(folder / life.file("journal")),
        Journal.open((folder / life.file("journal")).with_suffix(f".{HEARD}")),
        every[~sent],
        every[sent],
    )


def differences(host: Host, found: Recorded) -> list[str]:
    """Run an image along a recorded node, slot by slot; what is not the same, to the bit."""
    wrong: list[str] = []
    host.hello(SLOTS)
    order = np.argsort(found.received["t_ns"], kind="stable")
    frames = list(found.received[order])
    rows, heard, sent = [], [], []
    at = 0
    for slot, row in enumerate(found.rows):
        limit = int(row["deadline_ns"])
        while at < len(frames) and frames[at]["t_ns"] <= limit:
            f = frames[at]
            data = bytes(f["data"][: f["length"]])
            host.say(
                frame_record(int(f["bus"]), int(f["flags"]), int(f["id"]), int(f["t_ns"]), data)
            )
            at += 1
        host.say(record("s", struct.pack("<qq", slot, limit)))
        answer = host.until("d")
        if answer["d"] != [struct.pack("<qii", slot, 0, 0)]:
            wrong.append(f"slot {slot}: {answer['d']}")
        rows += answer["r"]
        heard += answer.get("j", [])
        sent += answer.get("f", [])
    wrong += _compared("row", rows, found.rows)
    wrong += _compared("heard", heard, found.heard)
    frames_sent = [
        (
            int(f["bus"]),
            int(f["flags"]) & ~Flags.SENT,
            int(f["id"]),
            bytes(f["data"][: f["length"]]),
        )
        for f in found.sent
    ]
    by_bus = sorted(_sent(sent), key=lambda f: f[0])
    if by_bus != frames_sent:
        wrong.append(f"{len(by_bus)} frames sent, {len(frames_sent)} in the twin")
    return wrong


def _sent(payloads: Sequence[bytes]) -> Iterator[tuple[int, int, int, bytes]]:
    for payload in payloads:
        bus, flags, length, _, identifier, _ = struct.unpack_from("<BBBBIq", payload)
        assert len(payload) == 16 + length
        yield bus, flags, identifier, payload[16:]


def _compared(what: str, found: Sequence[bytes], wanted: Any) -> list[str]:
    if len(found) != len(wanted):
        return [f"{len(found)} {what}s, {len(wanted)} in the twin"]
    same = [one == two.tobytes() for one, two in zip(found, wanted, strict=True)]
    return [] if all(same) else [f"{what} {same.index(False)} of {len(same)}"]
