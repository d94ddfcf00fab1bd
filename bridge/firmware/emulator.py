"""The process that runs an image: an emulator, or the image itself if it is for this machine.

Both ends of the serial line are a pair of sockets, so nothing has an address that another process
could take. The process is ended in any case: by :meth:`Emulator.close`, and with its parent.
"""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import tempfile
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from select import select
from typing import Self, final

from bridge.firmware.machine import NATIVE, machine_of
from bridge.firmware.progress import progress
from bridge.firmware.records import FirmwareError

#: s between two looks at a process that does not answer.
LOOK = 0.05
#: Looks in a row at which a process had nothing to do, and s of its processor time without an
#: answer, after which it is asked whether it has restarted, and after which it has failed.
IDLE_LOOKS, BUSY = (20, 100), (1.0, 10.0)
#: Bytes of one look at the serial line, and those that may wait for an image to read them.
_PIECE, UNREAD = 1 << 16, 1 << 22


def image_facts(image: Path) -> dict[str, str]:
    """The file of an image, its SHA-256 and its machine, for reports. Raises ScenarioError."""
    machine = machine_of(image)
    digest = sha256(image.read_bytes()).hexdigest()
    return {"image": str(image), "sha256": digest, "machine": machine.name}


@final
class Emulator:
    """A process with an image, and its serial line. Use as a context manager: it always ends.

    `node`: the node that it is, for messages. Raises ScenarioError for a file that is no image, and
    if its emulator is not installed.
    """

    def __init__(self, image: Path, node: str) -> None:
        self.machine = machine_of(image)
        self.image, self._command = image, self.machine.command(image)
        self.name = f"the {'image' if self.machine is NATIVE else 'emulator'} of node {node}"
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self._unsent = b""
        self._start()

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    def _start(self) -> None:
        self._line, line = socket.socketpair()
        self._control, control = socket.socketpair()
        given: list[int] = []
        stdio, options = line.fileno(), list[str]()
        if self.machine is not NATIVE:
            given, stdio = [line.fileno(), control.fileno()], subprocess.DEVNULL
            options = [*_device("serial", line), *_device("monitor", control), "-display", "none"]
        alone = shutil.which("setpriv")  # which ends it with this process, however that ends
        with line, control:
            self._process = subprocess.Popen(
                [*([alone, "--pdeathsig", "KILL"] if alone else []), *self._command, *options],
                stdin=stdio,
                stdout=stdio,
                stderr=self._errors,
                pass_fds=given,
                start_new_session=True,
            )
        self._line.setblocking(False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- the serial line ---------------------------------------------------------------------

    def fileno(self) -> int:
        """The descriptor of the serial line, for `select`."""
        return self._line.fileno()

    def send(self, data: bytes) -> None:
        """Send bytes to the image; what its line does not take now is sent by `receive`.

        Raises FirmwareError if the image does not read them.
        """
        self._unsent += data
        with suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):
            while self._unsent:
                self._unsent = self._unsent[self._line.send(self._unsent) :]
        if len(self._unsent) > UNREAD:
            text = f"{self.name} has not read {len(self._unsent)} bytes of its serial line"
            raise FirmwareError(text)

    def receive(self, seconds: float = LOOK) -> bytes:
        """Wait up to `seconds` (s) for bytes from the image; b"": none.

        Raises FirmwareError if the process has ended.
        """
        writing = [self._line] if self._unsent else []
        readable, _, _ = select([self._line], writing, [], seconds)
        self.send(b"")
        if readable:
            with suppress(ConnectionResetError):
                if data := self._line.recv(_PIECE):
                    return data
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
            raise FirmwareError(f"{self.name} {self._how()}")
        if self._process.poll() is not None:
            raise FirmwareError(f"{self.name} {self._how()}")
        return b""

    def _how(self) -> str:
        code = self._process.returncode
        if code is None:
            return "has closed its serial line"
        if code < 0:
            return f"ended by signal {-code}"
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return f"ended with exit status {code}{f': {lines[-1]}' if lines else ''}"

    # ---- what may be done to it --------------------------------------------------------------

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal to the process."""
        self._process.send_signal(number)

    def reset(self) -> None:
        """Reset the board; a program of this machine is started once more."""
        if self.machine is not NATIVE:
            self._control.sendall(b"system_reset\n")
            return
        self._end()
        self._start()

    def close(self) -> None:
        """End the process."""
        self._end()
        self._errors.close()

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        self._line.close()
        self._control.close()


def _device(option: str, end: socket.socket) -> list[str]:
    """The options of QEMU for a character device over an open socket."""
    name = f"{option}0"
    return ["-chardev", f"socket,id={name},fd={end.fileno()}", f"-{option}", f"chardev:{name}"]


@final
class Patience:
    """Waiting for an answer of an emulator, by its progress and not by the time of the wall.

    A busy machine gives a process little time, so a process has failed only if it was idle at
    `IDLE_LOOKS` in a row, stopped or waiting, or has computed for `BUSY` s without an answer.
    """

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._idle = 0
        self._began = self._last = progress(emulator.pid)

    def look(self) -> str:
        """The reason why no answer can be expected any more; "": it may still come."""
        now = progress(self._emulator.pid)
        self._idle = 0 if now.ready or now.seconds > self._last.seconds else self._idle + 1
        self._last = now
        if self._idle >= IDLE_LOOKS[1]:
            return "is stopped" if now.stopped else "does not answer, and waits"
        if (computed := now.seconds - self._began.seconds) >= BUSY[1]:
            return f"has computed for {computed:.0f} s without an answer"
        return ""

    @property
    def doubtful(self) -> bool:
        """True if it is time to ask whether the image has restarted."""
        computed = self._last.seconds - self._began.seconds
        return self._idle >= IDLE_LOOKS[0] or computed >= BUSY[0]
