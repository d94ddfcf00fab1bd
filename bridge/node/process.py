"""A node's process as its supervisor sees it: events by lines, commands by lines."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, final

from bridge.node.handle import NodeHandle, NodeStart
from cosim.base.python import python_call


@final
class Process(NodeHandle):
    """One life of a node. Its standard error is stored in ``FOLDER/LIFE.err``."""

    def __init__(self, start: NodeStart) -> None:
        super().__init__(start)
        self.errors = start.folder / start.life.file("err")
        self.events: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        with self.errors.open("wb") as errors:
            self._popen = subprocess.Popen(
                python_call("bridge.node.start", start.text()),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,  # Ctrl-C is the supervisor's to handle
            )
        self._thread = threading.Thread(target=self._read, name=str(start.life), daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            try:
                self.events.put(json.loads(line))
            except ValueError:
                continue  # somebody's component printed something
        self.events.put(None)

    def poll(self) -> None:
        """Take in the events that have come."""
        while not self.events.empty():
            event = self.events.get()
            if event is not None:
                self.keep_event(event)

    def send_command(self, command: str, **values: int) -> None:
        """Send a command; a process that has ended ignores it."""
        assert self._popen.stdin is not None
        try:
            self._popen.stdin.write(json.dumps({"command": command, **values}) + "\n")
            self._popen.stdin.flush()
        except (BrokenPipeError, ValueError):
            return

    def send_signal(self, number: signal.Signals) -> None:
        """SIGKILL, SIGSTOP and so on, to this process only."""
        if self._popen.poll() is None:
            os.kill(self._popen.pid, number)

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._popen.pid

    @property
    def code(self) -> int | None:
        """Its exit code, after reading its last events; None: it is running."""
        code = self._popen.poll()
        if code is not None:
            self._thread.join(1.0)
            self.poll()
        return code

    def wait(self, seconds: float) -> int | None:
        """Its exit code, or None if it has not ended after so many seconds."""
        try:
            return self._popen.wait(seconds)
        except subprocess.TimeoutExpired:
            return None

    def end(self, seconds: float = 3.0) -> None:
        """End the process: ask it to quit, and kill it if it still runs after so many seconds."""
        if self.code is None:
            self.send_signal(signal.SIGCONT)
            self.send_command("quit")
            if self.wait(seconds) is None:
                self.send_signal(signal.SIGKILL)
                self.wait(seconds)
        self._thread.join(1.0)
        self.poll()
        for stream in (self._popen.stdin, self._popen.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):  # of what was told to a process that had ended
                    stream.close()

    def reason(self) -> str:
        """The reason why it ended too early, if it reported that."""
        if self.failed:
            return str(self.failed["error"])
        text = self.errors.read_text(encoding="utf-8", errors="replace").strip()
        last = f": {text.splitlines()[-1]}" if text else ""
        code = self.code
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}{last}"
        return f"exit code {code}{last}"
