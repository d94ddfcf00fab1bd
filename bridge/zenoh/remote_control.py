"""Queries and commands to a node over Zenoh: state, parameters, clock, arm, stop; JSON.

``PREFIX/NODE/state``, ``/parameters``, ``/clock`` read; a query of ``PREFIX/NODE/arm`` or ``/stop``
is the command, its answer the state it was given in. Commands to several nodes at once are NMT, as
on CAN.
"""

from __future__ import annotations

import ctypes as c
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import zenoh

from bridge.can.socket import BusError
from bridge.deployment.services import Encoding
from bridge.deployment.zenoh_keys import Names
from bridge.native.frame import Frame
from bridge.native.message import Header, encode
from bridge.native.pace import quantile
from bridge.native.safety import LifeState
from bridge.realtime.host_clock import host_clock
from bridge.safety.limits import explain
from bridge.wiring.outlets import forwarded_facts
from bridge.wiring.wiring import WiredNode
from bridge.zenoh.callbacks import aside
from bridge.zenoh.channel import ZenohAttachment
from bridge.zenoh.presence import Presence, wait_until_there
from cosim.base.clock import realtime_ns, realtime_offset_ns, sleep, stopwatch
from cosim.base.errors import RunError

READ = ("state", "parameters", "clock")
TOLD = ("arm", "stop")
_JSON = "application/json"
_PATIENCE = 3.0


class Stoppable(Protocol):
    """The object that arms and stops a node: :class:`bridge.node.control.Control`."""

    def arm(self) -> None:
        """Torque may follow START."""

    def stop(self) -> None:
        """Ramp down and stop."""


#: What a node has not heard and needs before its start, a phrase each.
Unheard = Callable[[WiredNode], list[str]]


def serve(end: ZenohAttachment, wired: WiredNode, control: Stoppable, unheard: Unheard) -> None:
    """Answer for a node until its session is closed."""
    commands: Mapping[str, Callable[[], None]] = {"arm": control.arm, "stop": control.stop}
    answers = {
        "state": lambda: state(wired, end, unheard(wired)),
        "parameters": lambda: parameters(wired),
        "clock": lambda: clock(wired),
    }

    def declare(session: zenoh.Session) -> None:
        for what in (*READ, *TOLD):
            key = end.names.of(wired.name, what)
            answer = answers.get(what, answers["state"])
            session.declare_queryable(key, _answering(key, answer, commands.get(what)))

    end.declare(declare)


def _answering(
    key: str, answer: Callable[[], Mapping[str, Any]], command: Callable[[], None] | None
) -> zenoh.handlers.Callback[zenoh.Query]:
    def answering(query: zenoh.Query) -> None:
        with query:
            found = answer()
            if command is not None:
                command()
            query.reply(key, json.dumps(found), encoding=_JSON)

    return aside(answering)


def state(wired: WiredNode, end: ZenohAttachment, unheard: Sequence[str]) -> dict[str, Any]:
    """The state of a node: life cycle, slot, lateness (us), peers, counts of its messages.

    `unheard`: the inputs for which it waits before its start.
    """
    s = wired.struct
    return {
        "node": wired.name,
        "state": LifeState(s.life.state).name.lower(),
        "armed": bool(s.life.armed),
        "reasons": explain(s.life.reasons) if s.life.reasons else "",
        "boots": int(s.boots),
        "slot": int(s.slot),
        "slots": int(s.slots),
        "t": s.slot * s.h,
        "missed": int(s.missed),
        "late_us": {f"p{q:g}": quantile(s.late, q / 100) / 1e3 for q in (50, 99) if s.late.count},
        "peers": sorted(end.presence.there),
        "unheard": list(unheard),
        "messages": {
            name: {"ok": int(r.ok), "lost": int(r.lost)} for name, r in wired.receivers.items()
        },
        "forwards": {name: forwarded_facts(f) for name, f in wired.forwards.items()},
    }


def parameters(wired: WiredNode) -> dict[str, Any]:
    """The parameters of a node: its components' parameters as the scenario has them, and its
    messages.

    Of each message it sends: number of bytes, period (s), signals in their order.
    """
    system = wired.system
    components = system.scenario.components
    return {
        "node": wired.name,
        "number": int(wired.spec.number),
        "h": wired.plan.h,
        "components": {
            name: {"model": components[name].model, "parameters": dict(components[name].parameters)}
            for name in wired.spec.components
        },
        "messages": {
            o.message: {
                "bytes": int(system.messages[o.message].encoding.message.length),
                "period": o.ticks * system.plan.h,
                "signals": [name for part in o.parts for name in part.scalars()],
            }
            for o in wired.plan.outlets
        },
    }


def clock(wired: WiredNode) -> dict[str, Any]:
    """The clock of a node's host, its date now, and the run it is in; see :mod:`.offsets`.

    `origin_ns`: the date of t = 0, 0: it has none.
    """
    s, ours = wired.struct, host_clock()
    origin = int(s.start_ns)
    return {
        "node": wired.name,
        "host": ours.host,
        "kept": ours.kept,
        "error": ours.error if ours.kept else None,
        "date_ns": realtime_ns(),
        "running": bool(s.begun) and s.life.state == LifeState.ACTIVE,
        "run": int(s.epoch.run),
        "origin_ns": origin + realtime_offset_ns() if origin else 0,
    }


def ask(
    session: zenoh.Session, names: Names, node: str, what: str, seconds: float = 3.0
) -> dict[str, Any]:
    """Send a node one of the queries `READ` or commands `TOLD`; return its answer.

    Raises RunError without an answer within `seconds` (s).
    """
    if what not in (*READ, *TOLD):
        raise RunError(f"{what!r}; a node is asked for one of {', '.join((*READ, *TOLD))}")
    key = names.of(node, what)
    for reply in session.get(key, timeout=seconds):
        if reply.ok is not None:
            found: dict[str, Any] = json.loads(reply.ok.payload.to_string())
            return found
    raise RunError(f"no answer to {key} within {seconds:g} s; is node {node} running?")


def wait_until_ready(
    session: zenoh.Session, names: Names, nodes: Sequence[str], name: str, seconds: float
) -> None:
    """Until all `nodes` are ready for a start. Raises BusError after `seconds` (s), naming which
    are not, and what each of them has not heard. `name`: of who waits.
    """
    present = Presence(session, names, name, "ready")
    try:
        wait_until_there(lambda: present.missing(nodes, {}), seconds)
    except BusError as error:
        lacking = [
            f"{node} has not received from {', '.join(found)}"
            for node in sorted(set(nodes) - present.there)
            if (found := _missing_inputs(session, names, node))
        ]
        raise BusError("; ".join([*lacking, str(error)])) from error


def _missing_inputs(session: zenoh.Session, names: Names, node: str) -> list[str]:
    """The inputs that a node waits for; none of one that does not answer."""
    try:
        return list(ask(session, names, node, "state", 1.0)["unheard"])
    except RunError:
        return []


#: Commands of NMT that :func:`command` sends, by name; see ``node.h``.
COMMANDS = {"start": 1, "stop": 2, "arm": 128, "reset": 129}


def command(
    session: zenoh.Session, names: Names, nmt: Encoding, what: str, number: int = 0
) -> None:
    """Send NMT `what` to the node with a number, 0: all; `nmt`: of the bus's services.

    A started node has its t = 0 at the time in the preceding EPOCH, or 100 ms after it receives the
    START. Raises RunError for another command, and if no node subscribes.
    """
    if what not in COMMANDS:
        raise RunError(f"{what!r} is not a command; expected one of {', '.join(COMMANDS)}")
    send_service(session, names.shared("nmt"), nmt, [COMMANDS[what], number])


def send_service(
    session: zenoh.Session, key: str, encoding: Encoding, values: Sequence[float]
) -> None:
    """Send a message of a bus's services, reliably; `values` are in the units of its fields.

    Raises RunError if no node listens.
    """
    frame = Frame()
    encode(encoding.message, (c.c_double * len(values))(*values), Header(), frame)
    publisher = session.declare_publisher(
        key, priority=zenoh.Priority.REAL_TIME, reliability=zenoh.Reliability.RELIABLE,
        congestion_control=zenoh.CongestionControl.BLOCK, express=True,
    )  # fmt: skip
    elapsed = stopwatch()
    while not getattr(publisher.matching_status, "matching", False):
        if elapsed() > _PATIENCE:
            raise RunError(f"no node listens to {key} after {_PATIENCE:g} s; is one running?")
        sleep(0.02)
    publisher.put(frame.payload)
