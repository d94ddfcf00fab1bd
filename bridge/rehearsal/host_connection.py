"""The connection to the agent of a host, over which its nodes are started and watched.

The program at the other end is :mod:`bridge.rehearsal.agent`. The end of a connection is the end of
all nodes of its host. A connection without a line for `silence` of the host file is given up: the
host is frozen or cut off.
"""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, final

from bridge.node import checkpoints
from bridge.node.handle import LostError, NodeHandle, NodeStart
from bridge.records.node_lives import Life
from bridge.rehearsal.file_parts import packed, unpacked, write_part
from bridge.rehearsal.forked_life import ending
from bridge.rehearsal.host_file import HostCall
from bridge.rehearsal.host_task import BEAT, HostTask, digest_of
from cosim.base.clock import sleep, stopwatch
from cosim.base.errors import RunError
from cosim.base.queues import take
from cosim.checkpoint import archive

#: s between two looks.
LOOK = 0.02
#: s for the end of a host's program, and for the files of its nodes.
CLOSING, COLLECTING = 5.0, 300.0
#: Added to the name of a file that is being collected.
COLLECTED = ".collected"


@final
class HostConnection:
    """The connection to a host's program; `task`: what it has to do, `folder`: where files go."""

    def __init__(self, name: str, call: HostCall, task: HostTask, folder: Path) -> None:
        self.name, self.task, self._folder = name, task, folder
        self.lives: dict[str, RemoteNode] = {}
        self.hello: Mapping[str, Any] | None = None
        self.router = 0
        self.router_id, self.routers = "", frozenset[str]()  # its own, and those it is connected to
        self._lost: set[str] = set()  # routers whose connection was lost in the run
        self.loaded = self.collected = False
        self.failed = ""
        self._gone = False
        self._collected: dict[Path, Path] = {}  # by file, under which name it arrives
        self.watch: Callable[[], None] | None = None  # called at each look of the run
        self._ending: Callable[[], float] | None = None
        self._silent = stopwatch()
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._errors = folder / f"{name}.host.err"
        with self._errors.open("wb") as errors, call.where():
            self._popen = subprocess.Popen(
                call.words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
                text=True, start_new_session=True,
            )  # fmt: skip
        self.send_line(task.text())
        self._threads = [
            threading.Thread(target=do, name=f"host {name}", daemon=True)
            for do in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """The number of the process that keeps the connection."""
        return self._popen.pid

    def send_line(self, line: str) -> None:
        """Send a line; a connection that has ended ignores it."""
        self._lines.put(line)

    def send(self, **said: Any) -> None:
        """Send a line of JSON."""
        self.send_line(json.dumps(said))

    def _write(self) -> None:
        """Send the lines, and signs of life between them; "" is the end."""
        assert self._popen.stdin is not None
        with suppress(OSError, ValueError), self._popen.stdin as to:
            while not self._gone:
                try:
                    line = take(self._lines, BEAT)
                except queue.Empty:
                    line = json.dumps({"beat": True})
                if not line:
                    return
                to.write(line + "\n")
                to.flush()

    def start_node(self, start: NodeStart) -> RemoteNode:
        """Start a life of a node there, with the files of its state. Raises ScenarioError."""
        if start.resumes is not None and start.resumes >= 0 and not self.task.folder:
            self._put_state(start.life, start.resumes)
        found = self.lives[str(start.life)] = RemoteNode(start, self)
        self.send(start=start.text())
        return found

    def _put_state(self, life: Life, number: int) -> None:
        """Send the state of a life, and its journals."""
        place = checkpoints.place(self._folder, life)
        path = place / checkpoints.numbers(place)[number]
        for name, rows in archive.read(path).facts["rows"].items():
            for at, data in checkpoints.journal_parts(self._folder / name, 0, rows):
                self.send(put=name, states="", at=at, rows=rows, data=packed(data))
        state = packed(path.read_bytes())
        self.send(put=archive.LATEST, states=str(life), at=0, rows=0, data=state)

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            self._silent = stopwatch()
            try:
                with suppress(ValueError):  # a login shell may print something
                    self._heard(json.loads(line))
            except (OSError, RunError) as error:
                self.fail(f"a file from it cannot be written: {error}")
        code = self._popen.wait()
        said = self._errors.read_text("utf-8", "replace").strip()
        last = f": {said.splitlines()[-1]}" if said else ""
        self._gone = True
        self.fail(f"the connection has ended ({ending(code)}{last})")

    def fail(self, why: str) -> None:
        """Give the host up with all its nodes; the first reason is kept."""
        self.failed = self.failed or why
        for life in self.lives.values():
            life.events.put({"code": -signal.SIGKILL, "error": f"host {self.name}: {self.failed}"})

    def look(self) -> None:
        """Give the host up if it has been silent for too long."""
        if self.watch is not None:
            self.watch()
        limit = self.task.silence
        if self.loaded and not self._gone and self._silent() > limit:
            self._gone = True
            self.fail(f"nothing came from it for {limit:g} s (silence): it is frozen or cut off")
            self._popen.kill()

    def _heard(self, said: Mapping[str, Any]) -> None:
        match said["kind"]:
            case "hello":
                self.hello = said
            case "router":
                self.router = int(said["pid"])
            case "routers":
                self._heard_of_routers(said["own"], frozenset(said["others"]))
            case "loaded":
                self.loaded = True
            case "node" | "ended":
                self.lives[said["life"]].events.put(said)
            case "beat":
                for name, life in self.lives.items():
                    life.stopped = name in said["stopped"]
            case "file" | "part":
                path = self._folder / Path(said["name"]).name
                if said["kind"] == "file":  # until all are there, those of the last state remain
                    self._collected[path] = path = path.with_name(f"{path.name}{COLLECTED}")
                data = unpacked(said["data"]) if "data" in said else b""
                write_part(path, said["at"], data, said.get("zeros", 0))
            case "state":
                place = checkpoints.place(self._folder, Life.parse(said["life"]))
                archive.store(place, [unpacked(said["data"])])
            case "collected":
                for path, collected in self._collected.items():
                    collected.replace(path)
                self.collected = True
            case "failed":
                self.failed = str(said["error"])

    def _heard_of_routers(self, own: str, others: frozenset[str]) -> None:
        """A connection that was lost in the run is not made good by another: samples were lost."""
        if self.watch is not None:
            self._lost |= self.routers - others
        self.router_id, self.routers = own, others - self._lost

    def left(self, seconds: float) -> float:
        """The rest of `seconds` since the first call, s: all nodes end at once."""
        self._ending = self._ending or stopwatch()
        return max(0.0, seconds - self._ending())

    def check(self) -> None:
        """Raise RunError if the host cannot take part; LostError if it has ended."""
        if self.failed:
            raise LostError(f"host {self.name}: {self.failed}", (self.name,))
        if self.hello is not None and not self.task.folder:
            ours = digest_of(Path(self.task.scenario), Path(self.task.deployment))
            if self.hello["digest"] != ours:
                raise RunError(
                    f"host {self.name}: found another {self.task.scenario} or "
                    f"{self.task.deployment} there; expected the same bytes on all hosts"
                )

    def close(self) -> None:
        """Collect the files, and end the program with all that it runs."""
        if not self._gone and not self.task.folder:
            self.send(collect=True)
            elapsed = stopwatch()
            while not (self.collected or self._gone) and elapsed() < COLLECTING:
                self.look()
                sleep(LOOK)
        self.send_line("")
        try:
            self._popen.wait(CLOSING)
        except subprocess.TimeoutExpired:
            self._popen.kill()
        for thread in self._threads:
            thread.join(CLOSING)


@final
class RemoteNode(NodeHandle):
    """One life of a node on another host."""

    def __init__(self, start: NodeStart, host: HostConnection) -> None:
        super().__init__(start)
        self.events: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        self._host, self._pid, self._error = host, 0, ""
        self._code: int | None = None
        self._running = stopwatch()  # since it was not stopped
        self.stopped = False

    def poll(self) -> None:
        """Take in the events that have come."""
        self._host.look()
        if not self.stopped:
            self._running = stopwatch()
        elif self._running() > (limit := self._host.task.silence):
            why = f"it has been stopped by a signal for {limit:g} s (silence)"
            self.events.put({"code": -signal.SIGSTOP, "error": why})
        while not self.events.empty():
            said = self.events.get()
            self._pid = said.get("pid", self._pid)
            if "event" in said:
                self.keep_event(said["event"])
            if "code" in said and self._code is None:
                self._code, self._error = int(said["code"]), str(said["error"])

    def send_command(self, command: str, **values: int) -> None:
        """Send a command; a node that has ended ignores it."""
        self._host.send(to=str(self.start.life), command=command, **values)

    def send_signal(self, number: signal.Signals) -> None:
        """SIGKILL, SIGSTOP and so on, to this life only."""
        if self.code is None:
            self._host.send(to=str(self.start.life), signal=int(number))

    @property
    def pid(self) -> int:
        """The number of the process on its host; 0: not known yet."""
        self.poll()
        return self._pid

    @property
    def code(self) -> int | None:
        """Its exit code; None while it runs."""
        self.poll()
        return self._code

    def wait(self, seconds: float) -> int | None:
        """Its exit code, or None if it has not ended after so many seconds."""
        elapsed = stopwatch()
        while self.code is None and elapsed() < seconds:
            sleep(LOOK)
        return self.code

    def end(self, seconds: float = 3.0) -> None:
        """End it, up to `seconds` (s) after the first of its host: all were told to quit before."""
        if self.wait(self._host.left(seconds)) is None:
            self.send_signal(signal.SIGKILL)
            self.wait(seconds)

    def reason(self) -> str:
        """The reason why it ended too early."""
        if self.failed:
            return str(self.failed["error"])
        if self._error.startswith("host "):
            return self._error
        if self._code == -signal.SIGSTOP:
            return f"{self._error}, on host {self._host.name}"
        text = ending(self._code or 0)
        return f"{text} on host {self._host.name}{f': {self._error}' if self._error else ''}"
