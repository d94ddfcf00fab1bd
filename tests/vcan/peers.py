"""Other people's programs on the bus, and plain sockets: what our code is tested against."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

PATH = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))
PATIENCE = 20.0  # s, before a test gives up; nothing is measured by it
EXTENDED = 0x80000000
SO_RCVBUFFORCE, SO_RXQ_OVFL = 33, 40
_CLASSIC, _FD = struct.Struct("=IB3x8s"), struct.Struct("=IBB2x64s")
_LOGGED = re.compile(r"\((?P<time>[\d.]+)\) (?P<bus>\w+) (?P<id>[0-9A-F]+)#(?P<data>\S*)")


@dataclass(frozen=True)
class Frame:
    """A data frame as a program logged it or a socket gave it."""

    identifier: int
    data: bytes
    extended: bool = False
    fd: bool = False

    def packed(self) -> bytes:
        """The bytes that Linux takes (`struct can_frame`, `struct canfd_frame`)."""
        number = self.identifier | (EXTENDED if self.extended else 0)
        if self.fd:
            return _FD.pack(number, len(self.data), 0, self.data)
        return _CLASSIC.pack(number, len(self.data), self.data)

    @staticmethod
    def unpacked(packet: bytes) -> Frame:
        """The frame in the bytes that a socket gave."""
        fd = len(packet) == _FD.size
        number, length, data = (
            (lambda i, n, _, d: (i, n, d))(*_FD.unpack(packet)) if fd else _CLASSIC.unpack(packet)
        )
        extended = bool(number & EXTENDED)
        return Frame(number & (0x1FFFFFFF if extended else 0x7FF), data[:length], extended, fd)

    @staticmethod
    def logged(line: str) -> Frame:
        """The frame in a line of ``candump -L``."""
        match = _LOGGED.match(line)
        assert match, line
        number, data, fd = match["id"], match["data"], match["data"].startswith("#")
        payload = bytes.fromhex(data[2:] if fd else data)
        return Frame(int(number, 16), payload, len(number) == 8, fd)


def tool(name: str) -> str:
    """The full name of a program, which has to be there."""
    found = shutil.which(name, path=PATH)
    assert found, f"{name} was not found: apt-get install can-utils iproute2"
    return found


def call(*words: str, check: bool = True, text: str = "") -> str:
    """Runs a program to its end, `text` being its input; its output."""
    command = [tool(words[0]), *words[1:]]
    done = subprocess.run(command, input=text, capture_output=True, text=True)
    assert not check or done.returncode == 0, f"{' '.join(words)}: {done.stderr}"
    return done.stdout


def open_socket(bus: str, *, fd: bool = False, receive_buffer: int = 16 << 20) -> socket.socket:
    """A plain raw socket that waits at most `PATIENCE`."""
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, receive_buffer)
    sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(fd))
    sock.settimeout(PATIENCE)
    sock.bind((bus,))
    return sock


def receive(sock: socket.socket, n: int) -> list[Frame]:
    """The next n frames."""
    return [Frame.unpacked(sock.recv(_FD.size)) for _ in range(n)]


def pending(sock: socket.socket) -> list[Frame]:
    """The frames that have arrived by now."""
    found = []
    sock.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(Frame.unpacked(sock.recv(_FD.size)))
    sock.settimeout(PATIENCE)
    return found


def listeners(bus: str) -> int:
    """The number of those that listen to everything on this bus."""
    text = Path("/proc/net/can/rcvlist_all").read_text()
    return sum(line.split()[:1] == [bus] for line in text.splitlines())


@contextlib.contextmanager
def pair(near: str, far: str, *, fd: bool = False) -> Iterator[tuple[socket.socket, socket.socket]]:
    """Two sockets, on one bus or on two."""
    with open_socket(near, fd=fd) as a, open_socket(far, fd=fd) as b:
        yield a, b


@contextlib.contextmanager
def listening(bus: str, *command: str) -> Iterator[subprocess.Popen[str]]:
    """A program that listens to all of a bus, from when it does; its output is a pipe."""
    before = listeners(bus)
    process = subprocess.Popen([tool(command[0]), *command[1:]], stdout=subprocess.PIPE, text=True)
    try:
        end = time.monotonic() + PATIENCE
        while listeners(bus) == before:
            assert process.poll() is None, f"{command} ended with {process.returncode}"
            assert time.monotonic() < end, f"{command} does not listen to {bus}"
            time.sleep(0.01)
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)


def dumped(process: subprocess.Popen[str], n: int) -> list[Frame]:
    """The next n frames that a ``candump -L`` has seen."""
    assert process.stdout
    return [Frame.logged(process.stdout.readline()) for _ in range(n)]


@contextlib.contextmanager
def gateway(source: str, target: str, *options: str) -> Iterator[None]:
    """A rule of the kernel's gateway: frames of one bus go to another as well, perhaps changed."""
    rule = ("-s", source, "-d", target, "-e", *options)
    call("cangw", "-A", *rule)
    try:
        yield
    finally:
        call("cangw", "-D", *rule, check=False)


@contextlib.contextmanager
def queueing(bus: str, *discipline: str) -> Iterator[None]:
    """A queueing discipline on the way out of an interface, like ``netem delay 10ms``."""
    call("tc", "qdisc", "add", "dev", bus, "root", *discipline)
    try:
        yield
    finally:
        call("tc", "qdisc", "del", "dev", bus, "root", check=False)


def send(sock: socket.socket, frames: Sequence[Frame]) -> None:
    """Hands them to the kernel, one after the other."""
    for frame in frames:
        sock.send(frame.packed())
