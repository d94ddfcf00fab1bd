"""A node's process as its supervisor sees it: events by lines, commands by lines."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self, final

from bridge.records.lives import Life
from cosim.base.errors import RunError


@dataclass(frozen=True, slots=True)
class Start:
    """Everything a node's process is told on its command line."""

    scenario: Path
    deployment: Path
    settings: tuple[str, ...]
    life: Life
    folder: Path
    warm_up: float = 0.2
    realtime: bool = True
    real: bool = False
    script: str = ""

    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self), default=str)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Of :meth:`text`."""
        said = json.loads(text)
        paths = {key: Path(said[key]) for key in ("scenario", "deployment", "folder")}
        life = Life(**said["life"])
        return cls(**{**said, **paths, "life": life, "settings": tuple(said["settings"])})


def unready(waiting: Sequence[str]) -> str:
    """What a node that is not ready waits for, as far as it said."""
    if waiting:
        return f"has not heard {', '.join(waiting)}"
    return "opens its buses and loads its components"


@final
class Process:
    """One life of a node. What it writes on standard error is kept in ``FOLDER/LIFE.err``."""

    def __init__(self, start: Start) -> None:
        self.start = start
        self.errors = start.folder / start.life.file("err")
        self.events: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self.ready: Mapping[str, Any] | None = None
        self.done: Mapping[str, Any] | None = None
        self.failed: Mapping[str, Any] | None = None
        self.refused: list[Mapping[str, Any]] = []  # START or ARM
        self.waiting: tuple[str, ...] = ()  # for what it waits before it is ready
        self.deaf: tuple[str, ...] = ()  # what it hears no more
        with self.errors.open("wb") as errors:
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "bridge.node.start", start.text()],
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
            if event is None:
                continue
            match event.get("event"):
                case "ready":
                    self.ready = event
                case "done":
                    self.done = event
                case "refused":
                    self.refused.append(event)
                case "waiting":
                    self.waiting = tuple(event["for"])
                case "deaf":
                    self.deaf = tuple(event["to"])
                case "failed":
                    self.failed = event

    def tell(self, command: str, **values: int) -> None:
        """A command; a process that is gone does not hear it."""
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
        """Of the process."""
        return self._popen.pid

    @property
    def code(self) -> int | None:
        """Its exit code; None: it runs. What it said as its last is taken in before."""
        code = self._popen.poll()
        if code is not None:
            self._thread.join(1.0)
            self.poll()
        return code

    def wait(self, seconds: float) -> int | None:
        """Its exit code once it has ended, within so long; else None."""
        try:
            return self._popen.wait(seconds)
        except subprocess.TimeoutExpired:
            return None

    def end(self, seconds: float = 3.0) -> None:
        """Whatever it does, it ends: asked, then told, then killed."""
        if self.code is None:
            self.send_signal(signal.SIGCONT)
            self.tell("quit")
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
        """Why it ended too early, as far as it said."""
        if self.failed:
            return str(self.failed["error"])
        text = self.errors.read_text(encoding="utf-8", errors="replace").strip()
        last = f": {text.splitlines()[-1]}" if text else ""
        code = self.code
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}{last}"
        return f"exit code {code}{last}"

    def check(self) -> None:
        """Raise RunError if it has ended although it should not have."""
        self.poll()
        if self.failed or (self.code is not None and not self.done):
            raise RunError(f"node {self.start.life}: {self.reason()}")
