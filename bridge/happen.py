"""What a fault script does to processes and buses while a rehearsal runs."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable

from bridge import babble
from bridge.attach import can_spec
from bridge.fault_script import Event as Planned
from bridge.fault_script import FaultScript
from bridge.rehearse import Event, Rehearsal
from bridge.system import System
from cosim.errors import RunError, ScenarioError


def events(script: FaultScript, system: System) -> tuple[Event, ...]:
    """The events of a script, to be done by :meth:`Rehearsal.run`.

    Raises ScenarioError for names the deployment does not have.
    """
    d = system.deployment
    messages = {m for node in system.nodes for m in system.identifiers(node)}
    script.check(list(d.nodes), list(d.buses), sorted(messages))
    babblers: dict[tuple[str, int], subprocess.Popen[bytes]] = {}
    return tuple(
        Event(e.t, f"{e.action} {e.target}", _deed(e, system, babblers, script))
        for e in script.process_events(list(d.nodes), list(d.buses))
    )


def _deed(
    event: Planned,
    system: System,
    babblers: dict[tuple[str, int], subprocess.Popen[bytes]],
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
        case "clock-jump":
            return lambda r: r.current[target].tell("jump", by_ns=round(event.by * 1e9))
        case "bus-down" | "bus-up":
            state = event.action.removeprefix("bus-")
            return lambda r: set_link(system, target, state)
        case "babble":
            return lambda r: _babble(r, event, system, babblers)
        case "hush":
            return lambda r: _hush(babblers.pop((target, event.index)))
        case _:
            raise ScenarioError(
                f"{event.action} cannot be done to a rehearsal here",
                script.place(event.index, "kind"),
            )


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


def _babble(
    r: Rehearsal,
    event: Planned,
    system: System,
    babblers: dict[tuple[str, int], subprocess.Popen[bytes]],
) -> None:
    spec = system.deployment.buses[event.target]
    channel = can_spec(system.deployment, event.target).channel
    command = babble.command(event, spec.interface, channel, fd=spec.fd)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    babblers[event.target, event.index] = process
    r.closing(lambda: _hush(process))


def _hush(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(3.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
