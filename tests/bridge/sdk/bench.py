"""A participant of one node in a time that a test moves: what it sends, and what it hears."""

from __future__ import annotations

import ctypes as c
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from bridge.can.codec import Codec
from bridge.deployment.system import System, load_system
from bridge.native.epoch import before, new_run, values
from bridge.sdk import write_participant
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.sdk.core_on_zenoh import Frame, Host, Send, Step, declared

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")
MS = 1_000_000
#: Monotonic time and date at which a bench begins, ns.
BEGIN, DATE = 10**12, 1_790_000_000 * 10**9
#: The first 32 bits of the identity of its host.
IDENTITY = 0x89ABCDEF
HOST = 77


def library(folder: Path, deploy: str, node: str, *changes: str) -> Path:
    """The core of a participant of a node, as a shared library without a warning."""
    system = load_system(TELEOPERATION, deploy, changes)
    write_participant(system, node, "c", folder)
    files = [folder / name for name in ("participant.c", "protocol.c", "table.c")]
    made = subprocess.run(
        ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-shared", "-fPIC",
         "-o", folder / "core.so", *files],
        capture_output=True, text=True,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return folder / "core.so"


@dataclass
class Sent:
    """A frame that the participant sent at `t` (ns since the bench began)."""

    t: int
    bus: str
    id: int
    data: bytes


@dataclass
class Bench:
    """A participant of `system`'s node `name`, and what it has sent."""

    path: Path
    system: System
    name: str
    sent: list[Sent] = field(default_factory=list)
    steps: list[float] = field(default_factory=list)
    now: int = 0

    def __post_init__(self) -> None:
        self.lib = declared(str(self.path))
        self.p = c.create_string_buffer(self.lib.participant_size())
        self.buses = self.system.buses_of(self.name)
        self.kept = (Send(self._send), Step(self._step))
        table = c.byref(c.c_char.in_dll(self.lib, "TABLE"))
        self.lib.participant_init(self.p, table, *self.kept, None)
        host: Host = self.lib.participant_host(self.p).contents
        host.number, host.date_offset_ns = HOST, DATE - BEGIN
        host.identity[0] = IDENTITY
        self.due = 0

    def _send(self, _: object, bus: int, frame: Any, key: object) -> None:
        f = frame.contents
        data = c.string_at(f.data, f.length)
        self.sent.append(Sent(f.t_ns - BEGIN, self.buses[bus], f.id, data))

    def _step(self, _: object, p: object, t: float, h: float) -> None:
        self.steps.append(t)

    def run(self, until: int) -> None:
        """Let the time pass to `until` (ns since the bench began)."""
        while 0 <= self.due <= until:
            self.now = max(self.due, self.now)
            due = self.lib.participant_poll(self.p, BEGIN + self.now)
            self.due = due if due < 0 else due - BEGIN
        self.now = until

    def hear(self, bus: str, number: int, data: bytes, flags: int = 0) -> None:
        """A frame arrives now."""
        frame = Frame(
            t_ns=BEGIN + self.now, id=number, flags=flags, bus=self.buses.index(bus),
            length=len(data),
        )  # fmt: skip
        c.memmove(frame.data, data, len(data))
        self.lib.participant_hear(self.p, c.byref(frame))

    def sample(self, message: str, numbers: list[float], j: int, life: int = 2) -> None:
        """Sample `j` of a message arrives; life: the state of its sender."""
        m = self.system.messages[message]
        t_us = (j * m.period_ns + m.offset_ns) // 1000
        data = _codec(m.encoding).encode(numbers, 0x80 | life, t_us & 0xFFFFFFFF, j)
        self.hear(m.bus, m.encoding.message.id, data, m.encoding.message.flags)

    def beat(self, other: str, state: int = 1, counter: int = 0, boots: int = 1) -> None:
        """A heartbeat of another node arrives."""
        number = self.system.deployment.nodes[other].number
        bus = next(b for b in self.buses if b in self.system.buses_of(other))
        beat = self.system.services[bus].heartbeats[number]
        data = _codec(beat).encode([state, 0, boots, 0], 0x80, 0, counter)
        self.hear(bus, 0x700 + number, data)

    def epoch(self, bus: str, origin: int, host: int = HOST, kept: bool = False) -> None:
        """An EPOCH arrives, for t = 0 at `origin` (ns since the bench began)."""
        said = values(new_run(BEGIN + origin), host, kept, DATE + origin)
        epoch = self.system.services[bus].epoch
        assert epoch is not None
        self.hear(bus, 2, _codec(epoch).encode(said, 0x80))

    def host(self, bus: str, host: int, identity: int) -> None:
        """A HOST arrives, a frame before an EPOCH of a host with this number."""
        self._before(bus, before(host, 0, [identity, 0, 0, 0])[0])

    def date(self, bus: str, host: int, apart: int) -> None:
        """A DATE arrives, a frame before an EPOCH; it is `apart` (ns) from ours."""
        self._before(bus, before(host, DATE + self.now + apart, [0, 0, 0, 0])[1])

    def _before(self, bus: str, said: list[float]) -> None:
        epoch = self.system.services[bus].epoch
        assert epoch is not None
        self.hear(bus, 2, _codec(epoch).encode(said, 0x80))

    def nmt(self, bus: str, command: int, node: int = 0) -> None:
        """An NMT command arrives."""
        self.hear(bus, 0, bytes([command, node]))

    def of(self, number: int) -> list[Sent]:
        """The frames with an identifier that it has sent."""
        return [s for s in self.sent if s.id == number]

    def state(self) -> int:
        """The state in its last heartbeat."""
        number = self.system.deployment.nodes[self.name].number
        return self.of(0x700 + number)[-1].data[2] & 7


def _codec(encoding: Any) -> Codec:
    assert isinstance(encoding, Codec)
    return encoding
