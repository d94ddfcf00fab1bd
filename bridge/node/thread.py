"""Nodes as threads of one process, for buses that do not leave it (python-can's ``virtual``).

The ticks run in C without the GIL all the same. A thread cannot be killed or frozen: faults of that
kind need processes.
"""

from __future__ import annotations

import json
import queue
import signal
import threading
from collections.abc import Mapping
from typing import Any, final

from bridge.node.control import listen_to
from bridge.node.process import Start
from bridge.node.run import done, run_started
from cosim.base.errors import CosimError, RunError


@final
class Thread:
    """One life of a node in this process; as :class:`bridge.node.process.Process` to who watches
    it.
    """

    def __init__(self, start: Start) -> None:
        self.start = start
        self.ready: Mapping[str, Any] | None = None
        self.done: Mapping[str, Any] | None = None
        self.failed: Mapping[str, Any] | None = None
        self.refused: list[Mapping[str, Any]] = []  # START or ARM
        self.waiting: tuple[str, ...] = ()  # for what it waits before it is ready
        self.deaf: tuple[str, ...] = ()  # what it hears no more
        self._told: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=str(start.life), daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            told = iter(self._told.get, None)
            self.done = done(run_started(self.start, self._said, listen_to(told)))
        except CosimError as error:
            self.failed = {"error": str(error), "exit_code": error.exit_code}

    def _said(self, event: Mapping[str, Any]) -> None:
        match event.get("event"):
            case "ready":
                self.ready = event
            case "refused":
                self.refused.append(event)
            case "waiting":
                self.waiting = tuple(event["for"])
            case "deaf":
                self.deaf = tuple(event["to"])

    def poll(self) -> None:
        """Nothing: events are taken in as they come."""

    def tell(self, command: str, **values: int) -> None:
        """A command."""
        self._told.put(json.dumps({"command": command, **values}))

    def send_signal(self, number: signal.Signals) -> None:
        """Raises RunError: threads have no signals of their own."""
        raise RunError(f"{number.name} for {self.start.life}: it is a thread, not a process")

    @property
    def pid(self) -> int:
        """Of the thread."""
        return self._thread.native_id or 0

    @property
    def code(self) -> int | None:
        """0 or 1 once it has ended; None: it runs."""
        if self._thread.is_alive():
            return None
        return 0 if self.done else 1

    def wait(self, seconds: float) -> int | None:
        """Its code once it has ended, within so long; else None."""
        self._thread.join(seconds)
        return self.code

    def end(self, seconds: float = 3.0) -> None:
        """Asked to end, and waited for."""
        if self.code is None:
            self.tell("quit")
            self._thread.join(seconds)
        self._told.put(None)

    def reason(self) -> str:
        """Why it ended too early, as far as it said."""
        return str(self.failed["error"]) if self.failed else "the thread has ended"

    def check(self) -> None:
        """Raise RunError if it has ended although it should not have."""
        if self.failed or (self.code is not None and not self.done):
            raise RunError(f"node {self.start.life}: {self.reason()}")
