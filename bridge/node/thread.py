"""Nodes as threads of one process, for buses that do not leave it (python-can's ``virtual``).

The ticks run in C without the GIL all the same. A thread cannot be killed or frozen: faults of that
kind need processes.
"""

from __future__ import annotations

import json
import queue
import signal
import threading
from typing import final

from bridge.node.control import listen_to
from bridge.node.handle import NodeHandle, NodeStart
from bridge.node.run import done, run_started
from cosim.base.errors import CosimError, RunError


@final
class Thread(NodeHandle):
    """One life of a node, in a thread of this process."""

    def __init__(self, start: NodeStart) -> None:
        super().__init__(start)
        self._commands: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=str(start.life), daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            commands = iter(self._commands.get, None)
            self.done = done(run_started(self.start, self.keep_event, listen_to(commands)))
        except CosimError as error:
            self.failed = {"error": str(error), "exit_code": error.exit_code}

    def poll(self) -> None:
        """Nothing: events are taken in as they come."""

    def send_command(self, command: str, **values: int) -> None:
        """A command."""
        self._commands.put(json.dumps({"command": command, **values}))

    def send_signal(self, number: signal.Signals) -> None:
        """Raises RunError: threads have no signals."""
        raise RunError(f"{number.name} for {self.start.life}: it is a thread, not a process")

    @property
    def pid(self) -> int:
        """The number of the thread."""
        return self._thread.native_id or 0

    @property
    def code(self) -> int | None:
        """0 or 1 once it has ended; None: it runs."""
        if self._thread.is_alive():
            return None
        return 0 if self.done else 1

    def wait(self, seconds: float) -> int | None:
        """Its exit code, or None if it has not ended after so many seconds."""
        self._thread.join(seconds)
        return self.code

    def end(self, seconds: float = 3.0) -> None:
        """Ask the node to quit, and wait for it up to so many seconds."""
        if self.code is None:
            self.send_command("quit")
            self._thread.join(seconds)
        self._commands.put(None)

    def reason(self) -> str:
        """The reason why it ended too early, if it reported that."""
        return str(self.failed["error"]) if self.failed else "the thread has ended"
