"""A life of a node as a copy of the agent of its host, and as the agent sees it."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, final

from bridge.deployment.system import System
from bridge.node.control import listen_to
from bridge.node.handle import NodeStart
from bridge.node.run import done, run_started
from cosim.base.copies import replace
from cosim.base.errors import CosimError

#: Bytes of a pipe that are read at once.
READ = 1 << 16


@final
class ForkedLife:
    """One life of a node as the process from which it was copied sees it."""

    def __init__(self, name: str, pid: int, commands: int, events: int, errors: Path) -> None:
        self.name, self.pid, self.events = name, pid, events
        self._commands, self._errors, self._rest = commands, errors, b""
        self.code: int | None = None

    def tell(self, line: bytes) -> None:
        """Send a line; a node that has ended ignores it."""
        with suppress(BrokenPipeError, OSError):
            os.write(self._commands, line)

    def kill(self, number: int) -> None:
        """Send it a signal."""
        if self.code is None:
            os.kill(self.pid, number)

    def is_stopped(self) -> bool:
        """True if a signal has stopped it (SIGSTOP, a debugger), and it has not been continued."""
        if self.code is not None or not Path(f"/proc/{self.pid}/stat").exists():
            return False
        return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] in "Tt"

    def read(self) -> Sequence[Mapping[str, Any]]:
        """Its new events; at their end its code is known."""
        data = os.read(self.events, READ)
        if not data:
            self.reap()
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = []
        for line in lines:
            with suppress(ValueError):  # a component may print something
                found.append(json.loads(line))
        return found

    def reap(self, options: int = 0) -> None:
        """Wait for its end; with WNOHANG only note it."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, options)
            self.code = os.waitstatus_to_exitcode(status) if pid else None

    def has_ended(self) -> bool:
        """True if it runs no more."""
        self.reap(os.WNOHANG)
        return self.code is not None

    def close(self) -> None:
        """Close both pipes."""
        for descriptor in (self._commands, self.events):
            os.close(descriptor)

    def last_error(self) -> str:
        """The last line of its standard error; "": none."""
        text = ""
        with suppress(OSError):
            text = self._errors.read_text("utf-8", "replace").strip()
        return text.splitlines()[-1] if text else ""


def live(start: NodeStart, folder: Path, system: System | None, lines: Any) -> int:
    """The life of a node in this process, with events on standard output. Returns its exit code."""

    def say(event: Mapping[str, Any]) -> None:
        with suppress(BrokenPipeError):
            os.write(1, (json.dumps(event) + "\n").encode())

    try:
        report = run_started(replace(start, folder=folder), say, listen_to(lines), system)
    except CosimError as error:
        say({"event": "failed", "error": str(error), "exit_code": error.exit_code})
        return error.exit_code
    say(done(report))
    return 0


def ending(code: int) -> str:
    """The end of a process in words."""
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
