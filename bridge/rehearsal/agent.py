"""The nodes of one host: ``python -m bridge.rehearsal.agent``, started there by a rehearsal.

Lines of JSON come in. The first is a :class:`HostTask`; then ``{"start": NodeStart}``, ``{"to":
LIFE, "command": …}``, ``{"to": LIFE, "signal": N}``, ``{"put": FILE, …}`` (a part of a journal or
state with which a life is resumed), ``{"collect": true}`` and, as a sign of life, ``{"beat":
true}``. The ``kind`` of a line that goes out is ``hello``, ``router``, ``routers``
(those it is connected to), ``loaded``, ``node`` (an event of a life), ``ended`` (of a life),
``beat``, ``part`` (of a journal, when a life has saved its state), ``state``, ``file`` (a part of
one, at the end), ``collected`` or ``failed``.

The scenario is read once, and each node is a copy of this process. When the lines end or are silent
for too long, or the router of this host ends, all nodes are killed: a lost connection leaves
nothing behind.
"""

from __future__ import annotations

import json
import os
import select
import selectors
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, final

from bridge.deployment.system import System, load_system
from bridge.node import checkpoints
from bridge.node.handle import NodeStart
from bridge.realtime.host_clock import host_clock
from bridge.records.node_lives import Life
from bridge.rehearsal.file_parts import packed, unpacked, write_part
from bridge.rehearsal.forked_life import READ, ForkedLife, ending, live
from bridge.rehearsal.host_task import BEAT, HostTask, digest_of
from bridge.rehearsal.router_config import client_config, router_config
from cosim.base.clock import sleep, stopwatch
from cosim.base.errors import CosimError
from cosim.base.interrupts import die_with
from cosim.base.python import add_working_directory, python_call
from cosim.checkpoint.archive import LATEST

#: s that nodes which were told to quit may take, and between two looks at them.
ENDING, LOOK = 3.0, 0.02
#: s without a connection to all routers after which certificates are looked at, again and again.
REFUSED = 3.0


@final
class Agent:
    """The nodes and the router of one host; `say` sends a line."""

    def __init__(self, task: HostTask, folder: Path) -> None:
        self.task, self.scratch = task, folder
        self.nodes = Path(task.folder) if task.folder else folder / "nodes"
        self._select = selectors.DefaultSelector()
        self._lives: dict[str, ForkedLife] = {}
        self._router: subprocess.Popen[bytes] | None = None
        self._system: System | None = None
        self._rest = self._router_rest = b""
        self._over = False
        self._sent: dict[str, int] = {}  # rows of each journal that the other end has
        self._heard_last = self._said_last = self._looked_last = stopwatch()
        self._alone = task.others > 0  # its router is not connected to all others

    def say(self, kind: str, **facts: Any) -> None:
        """Send a line; who started this may be gone. Raises CosimError if it takes none."""
        rest = (json.dumps({"kind": kind, **facts}) + "\n").encode()
        self._said_last = stopwatch()
        with suppress(BrokenPipeError):
            while rest:
                if not select.select([], [1], [], self.task.silence)[1]:
                    raise CosimError("the connection takes nothing")
                with suppress(BlockingIOError):
                    rest = rest[os.write(1, rest) :]

    def run(self) -> int:
        """Work until the lines end. Returns the exit code."""
        clock = host_clock()
        self.say(
            "hello",
            host=clock.identity_text,
            name=os.uname().nodename,
            digest=digest_of(Path(self.task.scenario), Path(self.task.deployment)),
        )
        self.nodes.mkdir(parents=True, exist_ok=True)
        self._start_router()
        self._system = load_system(self.task.scenario, self.task.deployment, self._settings())
        self.say("loaded")
        self._select.register(sys.stdin.fileno(), selectors.EVENT_READ, None)
        self._heard_last = stopwatch()
        while not self._over:
            for key, _ in self._select.select(BEAT):
                if key.data is None:
                    self._commands()
                elif key.data == "router":
                    self._heard_of_router()
                else:
                    self._heard(key.data)
            self._beat()
        return 0

    def _beat(self) -> None:
        """Send a sign of life. Raises CosimError if the other end has sent none for too long."""
        if self._said_last() >= BEAT:
            stopped = [life.name for life in self._lives.values() if life.is_stopped()]
            self.say("beat", stopped=stopped)
        if self.task.keys and self._alone and self._looked_last() > REFUSED:
            self._looked_last = stopwatch()
            self._check_certificates()
        if self._heard_last() > self.task.silence:
            raise CosimError(f"nothing came over the connection for {self.task.silence:g} s")

    def _check_certificates(self) -> None:
        """Raise CosimError if a router that is not connected has or sees a wrong certificate."""
        from bridge.zenoh.certificates import refusal

        for endpoint in self.task.connect:
            if said := refusal(endpoint, Path(self.task.keys), self.task.name):
                raise CosimError(f"its Zenoh router cannot connect to {endpoint}: {said}")

    def close(self) -> None:
        """Kill the nodes and end the router."""
        self._end_lives()
        if self._router is not None:
            self._router.kill()
            self._router.wait()

    def _end_lives(self, seconds: float = 0.0) -> None:
        """Kill the nodes that have not ended after so many seconds."""
        elapsed = stopwatch()
        while elapsed() < seconds and not all(life.has_ended() for life in self._lives.values()):
            sleep(LOOK)
        for life in self._lives.values():
            life.kill(signal.SIGKILL)
        for life in self._lives.values():
            life.reap()

    def _settings(self) -> list[str]:
        path = self.scratch / "client.json5"
        path.write_text(json.dumps(client_config(self.task.silence)), encoding="utf-8")
        found = list(self.task.settings)
        for bus in self.task.buses:
            at = f"deploy.buses.{bus}"
            found += [
                f"{at}.zenoh='{path}'", f"{at}.options.listen={{}}",
                f'{at}.options.connect="{self.task.client}"',
            ]  # fmt: skip
        return found

    def _start_router(self) -> None:
        """Start the router and wait until it listens. Raises CosimError."""
        task, path = self.task, self.scratch / "router.json5"
        config = router_config(task.silence, tls=bool(task.keys))
        path.write_text(json.dumps(config), encoding="utf-8")
        words = [task.router or str(path), *task.listen, "--tell"]
        words += [f"--connect={endpoint}" for endpoint in task.connect]
        words += ["--insecure"] if task.insecure else []
        words += ["--name", task.name, *(["--keys", task.keys] if task.keys else [])]
        parent = os.getpid()
        self._router = subprocess.Popen(
            python_call("bridge.zenoh.router", *words),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=(self.scratch / "router.err").open("wb"), start_new_session=True,
            preexec_fn=lambda: die_with(parent),
        )  # fmt: skip
        self.say("router", pid=self._router.pid)
        assert self._router.stdout is not None
        if self._router.stdout.readline() != b"ready\n":
            raise CosimError(self._router_text())
        self._select.register(self._router.stdout.fileno(), selectors.EVENT_READ, "router")

    def _router_text(self) -> str:
        assert self._router is not None
        code = self._router.wait()
        said = (self.scratch / "router.err").read_text("utf-8", "replace").strip()
        return f"its Zenoh router has ended: {ending(code)}{f': {said}' if said else ''}"

    def _heard_of_router(self) -> None:
        """Pass on which routers it is connected to. Raises CosimError at its end."""
        assert self._router is not None and self._router.stdout is not None
        data = os.read(self._router.stdout.fileno(), READ)
        if not data:
            raise CosimError(self._router_text())
        *lines, self._router_rest = (self._router_rest + data).split(b"\n")
        for line in lines:
            own, *others = line.decode().split()
            self._alone = len(others) < self.task.others
            self.say("routers", own=own, others=others)

    # ---- lines -------------------------------------------------------------------------------

    def _commands(self) -> None:
        data = os.read(sys.stdin.fileno(), READ)
        if not data:
            self._over = True
        self._heard_last = stopwatch()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._obey(json.loads(line))

    def _obey(self, said: Mapping[str, Any]) -> None:
        if "start" in said:
            self._start(NodeStart.parse(said["start"]))
        elif "collect" in said:
            self._collect()
        elif "put" in said:
            self._put(said)
        elif "beat" in said:
            return
        elif (life := self._lives.get(said["to"])) is not None:
            if "signal" in said:
                life.kill(said["signal"])
            else:
                command = {k: v for k, v in said.items() if k != "to"}
                life.tell(json.dumps(command).encode() + b"\n")

    def _start(self, start: NodeStart) -> None:
        """A copy of this process becomes a life of a node."""
        commands, events, parent = os.pipe(), os.pipe(), os.getpid()
        pid = os.fork()
        if pid == 0:
            os._exit(self._become(start, commands[0], events[1], parent))
        os.close(commands[0])
        os.close(events[1])
        name = str(start.life)
        errors = self.nodes / start.life.file("err")
        life = self._lives[name] = ForkedLife(name, pid, commands[1], events[0], errors)
        self._select.register(events[0], selectors.EVENT_READ, life)
        self.say("node", life=name, pid=pid)

    def _become(self, start: NodeStart, commands: int, events: int, parent: int) -> int:
        """The life of a node in this process, which is a copy. Returns its exit code."""
        code = 1
        try:
            errors = os.open(self.nodes / start.life.file("err"), os.O_WRONLY | os.O_CREAT, 0o644)
            for number, descriptor in enumerate((commands, events, errors)):
                os.dup2(descriptor, number)
            os.closerange(3, 3 + max(_descriptors(), default=0))
            die_with(parent)
            lines = os.fdopen(0, "r", encoding="utf-8", closefd=False)
            code = live(start, self.nodes, self._system, lines)
        except BaseException as error:
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
        return code

    def _put(self, said: Mapping[str, Any]) -> None:
        """A part of a file with which a life is resumed. Raises OSError."""
        name, states = Path(said["put"]).name, said["states"]
        folder = checkpoints.place(self.nodes, Life.parse(states)) if states else self.nodes
        write_part(folder / name, said["at"], unpacked(said["data"]))
        self._sent[name] = said["rows"]

    def _send_state(self, life: ForkedLife, rows: Mapping[str, int]) -> None:
        """Send the state that a life has saved, and the rows of its journals until then."""
        for name, count in rows.items():
            parts = checkpoints.journal_parts(self.nodes / name, self._sent.get(name, 0), count)
            for at, data in parts:
                self.say("part", name=name, at=at, data=packed(data))
            self._sent[name] = count
        path = checkpoints.place(self.nodes, Life.parse(life.name)) / LATEST
        self.say("state", life=life.name, data=packed(path.read_bytes()))

    def _heard(self, life: ForkedLife) -> None:
        for event in life.read():
            if event.get("event") == "saved" and not self.task.folder:
                self._send_state(life, event["rows"])
            self.say("node", life=life.name, event=event)
        if life.code is not None:
            self._select.unregister(life.events)
            life.close()
            self.say("ended", life=life.name, code=life.code, error=life.last_error())

    def _collect(self) -> None:
        """Send the files of all nodes, unless they are where they belong.

        The journal of a node that was killed has zeros for the rows that it did not write.
        """
        self._end_lives(ENDING)
        checkpoints.put_back(self.nodes)
        for path in sorted(self.nodes.iterdir()) if not self.task.folder else ():
            with path.open("rb") as file:
                part = file.read(checkpoints.PART)
                while True:
                    at = file.tell() - len(part)
                    if part.count(0) == len(part):
                        self.say("file", name=path.name, at=at, zeros=len(part))
                    else:
                        self.say("file", name=path.name, at=at, data=packed(part))
                    if not (part := file.read(checkpoints.PART)):
                        break
        self.say("collected")


def _descriptors() -> list[int]:
    return [int(name) for name in os.listdir("/proc/self/fd")]


def main() -> int:
    """Serve until standard input ends. Returns the exit code."""
    data = b""
    while not data.endswith(b"\n"):  # nothing of the lines behind it is taken
        one = os.read(sys.stdin.fileno(), 1)
        if not one:
            return 0
        data += one
    os.set_blocking(1, False)
    with TemporaryDirectory(prefix="cosim-") as folder:
        agent = Agent(HostTask.parse(data.decode()), Path(folder))
        try:
            return agent.run()
        except (CosimError, OSError) as error:
            with suppress(CosimError):
                agent.say("failed", error=str(error))
            return 1
        finally:
            agent.close()


if __name__ == "__main__":
    add_working_directory()
    sys.exit(main())
