"""Nodes that are participants: programs that run in place of this project's processes.

It is started with the other nodes, and told to start by EPOCH and NMT on its buses, as by ``cosim
tell``. Nothing is known of it but what it sends.
"""

from __future__ import annotations

import ctypes as c
import re
import shlex
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import final

from bridge.can.plain import PlainBus
from bridge.deployment.services import Encoding
from bridge.deployment.system import System
from bridge.native.epoch import before, new_run, values
from bridge.native.frame import Frame
from bridge.native.message import Decoded, Header, decode, encode
from bridge.node.buses import can_spec
from bridge.realtime.host_clock import host_clock
from bridge.records.node_lives import Life
from cosim.base.clock import monotonic_ns, realtime_ns, realtime_offset_ns
from cosim.base.errors import RunError, ScenarioError

#: NMT: start.
_START = 1
#: s until a program has ended after SIGTERM.
_ENDING = 5.0
_PLACE = re.compile(r"\{([\w-]+)(?:\.(listen|connect))?\}")


@final
class OutsideNodes:
    """The programs of `commands` by node; "": the user starts it.

    `system`: with the channels of this run. Use as a context manager: nothing is left running.
    """

    def __init__(self, system: System, commands: Mapping[str, str], folder: Path) -> None:
        self._system, self._commands, self._folder = system, commands, folder
        self._stack = ExitStack()
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._ended: set[str] = set()
        self._ends: list[_End] = []

    def __enter__(self) -> OutsideNodes:
        for bus in {b for node in self._commands for b in self._system.buses_of(node)}:
            nodes = [n for n in self._commands if bus in self._system.buses_of(n)]
            self._ends.append(self._stack.enter_context(_opened(self._system, bus, nodes)))
        for node, command in self._commands.items():
            if command:
                self._start(node, _words(self._system, node, command))
        return self

    def __exit__(self, *_: object) -> None:
        for program in self._running.values():
            _end(program)
        self._stack.close()

    def _start(self, node: str, words: Sequence[str]) -> None:
        with (self._folder / Life(node).file("err")).open("wb") as errors:
            try:
                self._running[node] = subprocess.Popen(
                    words, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors,
                    start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise ScenarioError(
                    f"found {words[0]!r}, which cannot be started ({error.strerror}); expected a "
                    "program",
                    f"--outside {node}",
                ) from None

    def waiting(self) -> list[str]:
        """The nodes that are not ready for a start. Raises RunError if a program has ended."""
        for node, text in self.ended():
            raise RunError(f"node {node}, outside: {text} before the start")
        return sorted({node for end in self._ends for node in end.waiting()})

    def start(self, start_ns: int) -> None:
        """Tell them to start, with t = 0 at this time of the monotonic clock."""
        for end in self._ends:
            end.start(start_ns)

    def stop(self) -> None:
        """Tell the programs to stop (SIGTERM)."""
        for program in self._running.values():
            if program.poll() is None:
                program.terminate()

    def ended(self) -> Iterator[tuple[str, str]]:
        """Nodes whose program has ended since the last call, and how."""
        for node, program in self._running.items():
            code = program.poll()
            if code is None or node in self._ended:
                continue
            self._ended.add(node)
            text = (self._folder / Life(node).file("err")).read_text("utf-8", "replace").strip()
            last = f": {text.splitlines()[-1]}" if text else ""
            how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            yield node, f"its program has ended ({how}{last})"


def _end(program: subprocess.Popen[bytes]) -> None:
    program.terminate()
    try:
        program.wait(_ENDING)
    except subprocess.TimeoutExpired:
        program.kill()
        program.wait()


def _words(system: System, node: str, command: str) -> list[str]:
    """The words of a command, as :func:`filled_words` has them. Raises ScenarioError."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ScenarioError(f"found {command!r}: {error}", f"--outside {node}") from None
    return filled_words(system, node, words, f"--outside {node}")


def filled_words(system: System, node: str, words: Sequence[str], place: str) -> list[str]:
    """The words of a command, with the channel of a bus in place of ``{BUS}``.

    On Zenoh ``{BUS.listen}`` and ``{BUS.connect}`` are endpoints of the node, with commas between
    them. Raises ScenarioError with the place.
    """
    d = system.deployment

    def put(found: re.Match[str]) -> str:
        bus, what = found[1], found[2]
        if bus not in system.buses_of(node):
            there = ", ".join(system.buses_of(node))
            raise ScenarioError(f"found {found[0]}, expected a bus of the node: {there}", place)
        if d.buses[bus].kind == "can":
            return can_spec(d, bus).channel
        from bridge.zenoh.options import options_of

        options = options_of(d, bus, node)
        return ",".join(options.listen if what == "listen" else options.connect)

    return [_PLACE.sub(put, word) for word in words]


# ---- a bus on which they are started ---------------------------------------------------------


class _End:
    """A bus with nodes that are started on it."""

    def __init__(self, system: System, bus: str, nodes: Sequence[str]) -> None:
        self.system, self.bus, self.nodes = system, bus, nodes

    def waiting(self) -> Sequence[str]:
        """Nodes that are not ready here."""
        raise NotImplementedError

    def start(self, start_ns: int) -> None:
        """EPOCH, then NMT START to each node."""
        service, clock = self.system.services[self.bus], host_clock()
        date = start_ns + realtime_offset_ns()
        if service.epoch is not None:
            fields = service.epoch.message.n_fields
            identity = clock.identity if fields > len(values(1, 1, False, 0)) else ()
            for one in () if identity else before(clock.number, realtime_ns(), clock.identity):
                self.send("epoch", service.epoch, one)
            run = new_run(start_ns)
            self.send("epoch", service.epoch, values(run, clock.number, clock.kept, date, identity))
        for node in self.nodes if service.nmt is not None else ():
            assert service.nmt is not None
            self.send("nmt", service.nmt, [_START, self.system.deployment.nodes[node].number])

    def send(self, what: str, encoding: Encoding, said: Sequence[float]) -> None:
        """Send a service; `said`: its values, in the units of its fields."""
        raise NotImplementedError


@final
class _CanEnd(_End):
    """A CAN bus. A node is ready when its heartbeat has come, if the bus has heartbeats."""

    def __init__(self, system: System, bus: str, nodes: Sequence[str], can: PlainBus) -> None:
        super().__init__(system, bus, nodes)
        numbers = {n: system.deployment.nodes[n].number for n in nodes}
        beats = system.services[bus].heartbeats
        self._can, self._counter = can, 0
        self._unheard = {n: beats[number] for n, number in numbers.items() if number in beats}

    def waiting(self) -> Sequence[str]:
        """Nodes of which no heartbeat has come."""
        while (came := self._can.receive(monotonic_ns())) is not None:
            for node, beat in list(self._unheard.items()):
                if _is_beat(beat, came.frame):
                    del self._unheard[node]
        return list(self._unheard)

    def send(self, what: str, encoding: Encoding, said: Sequence[float]) -> None:
        """Send a service; `said`: its values, in the units of its fields."""
        frame, header = Frame(), Header(counter=self._counter)
        encode(encoding.message, (c.c_double * len(said))(*said), header, frame)
        self._counter += 1
        self._can.send(frame)


def _is_beat(beat: Encoding, frame: Frame) -> bool:
    found = (c.c_double * max(1, beat.message.n_fields))()
    return frame.id == beat.message.id and (
        decode(beat.message, frame, found, Header()) is Decoded.OK
    )


@contextmanager
def _opened(system: System, bus: str, nodes: Sequence[str]) -> Iterator[_End]:
    """A bus, open. Raises BusError."""
    if system.deployment.buses[bus].kind == "zenoh":
        with _zenoh(system, bus, nodes) as end:
            yield end
        return
    can = PlainBus(can_spec(system.deployment, bus))
    try:
        yield _CanEnd(system, bus, nodes, can)
    finally:
        can.close()


@contextmanager
def _zenoh(system: System, bus: str, nodes: Sequence[str]) -> Iterator[_End]:
    """A Zenoh bus, as ``cosim tell`` opens it. A node is ready when its token is there."""
    from bridge.deployment.zenoh_keys import names_of
    from bridge.zenoh.node_channel import rules_of
    from bridge.zenoh.options import options_of
    from bridge.zenoh.presence import Presence
    from bridge.zenoh.remote_control import send_service
    from bridge.zenoh.session import close_session, configure, open_session

    operator, names = "operator", names_of(system.deployment, bus)
    options = options_of(system.deployment, bus, operator)
    session = open_session(configure(options, operator, rules_of(system, bus)), bus)
    present = Presence(session, names, operator, "ready")

    @final
    class ZenohEnd(_End):
        """The end of this session."""

        def waiting(self) -> Sequence[str]:
            """Nodes whose token is not there."""
            return sorted(set(self.nodes) - present.there)

        def send(self, what: str, encoding: Encoding, said: Sequence[float]) -> None:
            """Send a service; `said`: its values, in the units of its fields."""
            send_service(session, names.shared(what), encoding, said)

    try:
        yield ZenohEnd(system, bus, nodes)
    finally:
        close_session(session)


def parse(given: Sequence[str], system: System) -> dict[str, str]:
    """``NODE=COMMAND`` or ``NODE``, by node. Raises ScenarioError."""
    found: dict[str, str] = {}
    for text in given:
        node, _, command = text.partition("=")
        if node not in system.nodes:
            known = ", ".join(system.nodes)
            raise ScenarioError(f"found no node {node!r}, expected one of {known}", "--outside")
        found[node] = command
    return found
