"""Execution of the process and bus faults of a fault script during a rehearsal."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Container, Iterable, Mapping
from typing import Any, final

from bridge.deployment.system import System
from bridge.faults.script import FaultEvent, FaultScript
from bridge.node.buses import can_spec
from bridge.rehearsal import babbler
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal
from bridge.relay.network import RelayNetwork
from cosim.base.errors import RunError, ScenarioError

#: Faults that an image suffers, by the actions of its script.
OF_IMAGES = ("kill", "start", "freeze", "thaw", "noise")


def events(
    script: FaultScript,
    system: System,
    network: RelayNetwork | None = None,
    images: Container[str] = (),
) -> tuple[ScheduledEvent, ...]:
    """The events of a script, to be done by :meth:`Rehearsal.run`.

    `network`: between the hosts its nodes are on; `images`: nodes whose slots are computed by an
    image, which suffer their faults themselves, in simulated time. Raises ScenarioError for names
    the deployment does not have, for faults of a network without one, and for those that are not of
    an image in simulated time, or only of an image without it.
    """
    d = system.deployment
    messages = {m.name for node in system.nodes for m in system.subscriptions(node)}
    script.check(list(d.nodes), list(d.buses), sorted(messages))
    planned = script.process_events(list(d.nodes), list(d.buses))
    if d.clock == "simulated":
        _check_images(script, planned, images)
        return ()
    babblers = {(e.target, e.index): Babbler(e, system) for e in planned if e.action == "babble"}
    links = _Links(network)
    return tuple(
        ScheduledEvent(
            e.t,
            e,
            _event_action(e, system, babblers, links, script),
            e.action == "start",
            babblers[e.target, e.index].prepare if e.action == "babble" else None,
        )
        for e in planned
    )


def _check_images(
    script: FaultScript, planned: Iterable[FaultEvent], images: Container[str]
) -> None:
    """Raise ScenarioError for a fault that is not one of an image."""
    others = [(f.index, f"{f.kind} of frames") for f in script.frames]
    others += [(f.index, "drive") for f in script.drives]
    others += [
        (e.index, f"{e.action} of {e.target}")
        for e in planned
        if e.action not in OF_IMAGES or e.target not in images
    ]
    for index, found in others:
        raise ScenarioError(
            f"found {found} with the simulated clock, expected kill, restart, freeze or noise of a "
            "node with --firmware, or --clock wall",
            script.place(index, "kind"),
        )


def _event_action(
    event: FaultEvent,
    system: System,
    babblers: Mapping[tuple[str, int], Babbler],
    links: _Links,
    script: FaultScript,
) -> Callable[[Rehearsal], None]:
    target = event.target
    match event.action:
        case "kill":
            return lambda r: r.kill(target)
        case "start":
            return lambda r: r.restart(target)
        case "freeze":
            return lambda r: r.freeze(target)
        case "thaw":
            return lambda r: r.thaw(target)
        case "noise":
            raise ScenarioError(
                "noise needs a node with --firmware, on the simulated clock",
                script.place(event.index, "kind"),
            )
        case "clock-jump":
            return lambda r: r.current[target].send_command("jump", by_ns=round(event.by * 1e9))
        case "bus-down":
            return lambda r: take_down(r, system, target)
        case "bus-up":
            return lambda r: set_link(system, target, "up")
        case "babble":
            return lambda r: babblers[target, event.index].begin()
        case "hush":
            return lambda r: babblers[target, event.index].stop()
        case _:
            links.check(event, script)
            return lambda r: links.change(event)


@final
class _Links:
    """The active faults of each link of a network; simultaneous faults are combined."""

    def __init__(self, network: RelayNetwork | None) -> None:
        self._network = network
        self._wrong: dict[str, dict[int, Mapping[str, Any]]] = {}

    def check(self, event: FaultEvent, script: FaultScript) -> None:
        """Raise ScenarioError if the link does not exist."""
        if self._network is None:
            raise ScenarioError(
                f"{event.action} needs nodes on separate hosts with a network between them; "
                "use cosim soak",
                script.place(event.index, "kind"),
            )
        if event.target != "*" and event.target not in self._network.names:
            raise ScenarioError(
                f"no link {event.target!r}; there are: {', '.join(self._network.names)}",
                script.place(event.index, "link"),
            )

    def change(self, event: FaultEvent) -> None:
        """A fault begins, or is over."""
        assert self._network is not None
        for link in self._network.names if event.target == "*" else (event.target,):
            wrong = self._wrong.setdefault(link, {})
            if event.action == "net-over":
                wrong.pop(event.index, None)
            else:
                wrong[event.index] = event.spec
            whole: dict[str, Any] = {}
            for spec in wrong.values():
                whole |= spec
            self._network.set(link, **whole)


def take_down(rehearsal: Rehearsal, system: System, bus: str) -> None:
    """Set a SocketCAN bus down; it is up again when the rehearsal is left, even if that is before
    the script sets it up. Raises RunError where it fails.
    """
    rehearsal.closing(lambda: set_link(system, bus, "up"))
    set_link(system, bus, "down")


def set_link(system: System, bus: str, state: str) -> None:
    """``ip link set CHANNEL up|down`` of a SocketCAN bus. Raises RunError where it fails."""
    spec = system.deployment.buses[bus]
    if spec.interface != "socketcan":
        raise RunError(f"bus {bus} is {spec.interface}; only socketcan can be set {state}")
    found = subprocess.run(
        ["ip", "link", "set", spec.channel, state], capture_output=True, text=True, check=False
    )
    if found.returncode:
        raise RunError(f"ip link set {spec.channel} {state}: {found.stderr.strip()}")


@final
class Babbler:
    """The process of a babbling peer. It is ready before the run, so that it begins at its time."""

    def __init__(self, event: FaultEvent, system: System) -> None:
        spec = system.deployment.buses[event.target]
        channel = can_spec(system.deployment, event.target).channel
        self._command = babbler.command(event, spec.interface, channel, fd=spec.fd)
        self._process: subprocess.Popen[bytes] | None = None

    def prepare(self, r: Rehearsal) -> Callable[[], None]:
        """Start it. What is returned waits until it has its bus, and raises RunError if it ends."""
        self._process = process = subprocess.Popen(
            [*self._command, "--hold"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        r.closing(self.stop)

        def wait() -> None:
            assert process.stdout is not None and process.stderr is not None
            if not process.stdout.readline():
                said = process.stderr.read().decode(errors="replace").strip()
                raise RunError(f"the babbling peer has ended before the run: {said}")

        return wait

    def begin(self) -> None:
        """Let it send. Raises RunError where it has ended."""
        assert self._process is not None and self._process.stdin is not None
        try:
            self._process.stdin.write(b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise RunError("the babbling peer has ended too early") from None

    def stop(self) -> None:
        """End it."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        try:
            process.communicate(timeout=3.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
