"""Processes of nodes that are forked instead of started: nothing is imported again."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep
from typing import IO, Any, ClassVar, final

from bridge.node.handle import NodeStart
from bridge.node.run import main
from tests.children import fork

#: s; a node that lives longer hangs.
PATIENCE = 60


def fails(at: int) -> None:
    """Count the calls of this process from now on; the `at`-th fails, 0: none. See ``faulty.c``."""
    ctypes.CDLL(None).fault_begin()
    os.environ["FAULT_AT"] = str(at)


def calls(path: Path) -> None:
    """Write how many calls this process has made, and the modules it has imported."""
    text = f"{ctypes.CDLL(None).fault_calls()}\n" + "\n".join(sys.modules)
    path.write_text(text, encoding="utf-8")


@final
class Forked:
    """The part of ``subprocess.Popen`` that :class:`bridge.node.process.Process` needs.

    `at`: which call fails in the process of which node.
    """

    at: ClassVar[dict[str, int]] = {}
    _ours: ClassVar[list[IO[str]]] = []  # this end of the pipes of all nodes

    def __init__(self, words: Sequence[str], *, stderr: IO[bytes], **_: Any) -> None:
        given, stdin = os.pipe()
        stdout, said = os.pipe()
        self.returncode: int | None = None
        self.pid = fork(
            lambda: self._child(words[-1], (given, said, stderr.fileno()), (stdin, stdout))
        )
        os.close(given)
        os.close(said)
        self.stdin, self.stdout = os.fdopen(stdin, "w"), os.fdopen(stdout)
        self._ours.extend((self.stdin, self.stdout))

    def _child(self, text: str, streams: tuple[int, int, int], theirs: tuple[int, int]) -> int:
        for end in (*(file.fileno() for file in self._ours), *theirs):
            os.close(end)
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.alarm(PATIENCE)
        for wanted, found in enumerate(streams):
            os.dup2(found, wanted)
        sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
        start = NodeStart.parse(text)
        fails(self.at.get(start.life.node, 0))
        code = 1
        try:
            code = main([text])
        except BaseException:
            traceback.print_exc()
        if not any(self.at.values()):
            calls(Path(os.environ["FAULT_ROOT"]) / f"{start.life}.calls")
        return code

    def poll(self) -> int | None:
        """The exit code, None: it runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Its exit code, or TimeoutExpired."""
        end = monotonic() + timeout
        while (code := self.poll()) is None:
            if monotonic() > end:
                raise subprocess.TimeoutExpired("node", timeout)
            sleep(0.002)
        return code
