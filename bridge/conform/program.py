"""The program of the participant: started by the kit, and started again for rules that need it."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import final

from cosim.base.errors import CosimError, ScenarioError

#: s after SIGTERM until SIGKILL.
PATIENCE = 3.0
#: The last lines of its output that a message shows.
LINES = 4


@final
class Program:
    """A command and its process. Without a command: the participant runs already."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._begin = 0  # of the output of this life
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close

    @property
    def given(self) -> bool:
        """True if there is a command."""
        return bool(self._command)

    @property
    def running(self) -> bool:
        """True if its process runs, or if it is not ours."""
        return not self.given or (self._process is not None and self._process.poll() is None)

    def start(self) -> None:
        """Start it. Raises ScenarioError if there is no such program."""
        self.stop()
        self._begin = os.fstat(self._output.fileno()).st_size
        try:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            text = f"found {self._command[0]!r}: {os.strerror(error.errno or 0)}"
            raise ScenarioError(f"{text}; expected a command that starts the participant") from None

    def stop(self) -> None:
        """End it: SIGTERM, and SIGKILL to all of its group after `PATIENCE`."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.poll() is None:
            process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """End it, forget its output."""
        self.stop()
        self._output.close()

    def output(self) -> str:
        """The last lines that this life has printed, in one line. Raises CosimError."""
        try:
            size = os.fstat(self._output.fileno()).st_size - self._begin
            text = os.pread(self._output.fileno(), size, self._begin).decode(errors="replace")
        except (OSError, ValueError) as error:
            raise CosimError(f"cannot read the output of the participant: {error}") from None
        return " | ".join(text.strip().splitlines()[-LINES:])
