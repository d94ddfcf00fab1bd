"""Messages that a node has not received before its start or no longer receives.

A node is ready when it has received a preview of every message that it needs and a heartbeat of
every node that it requires. A connection, a declared subscription or a token does not show that
samples arrive. If all nodes of a run are ready, each one receives everything that it needs.
"""

from __future__ import annotations

import ctypes as c
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from bridge.native import node as native
from bridge.native.message import REFUSALS, Receiver
from bridge.native.safety import LifeState, Why
from bridge.node.control import Control, Helpers, Say
from bridge.records.records import reason_names, refusal
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns, stopwatch

#: s between two looks, and between two times a node says what it still waits for.
LOOK, REPEAT = 0.02, 0.5
#: Looks at samples of an unannounced run after which a node that could start reports it.
UNANNOUNCED = 100
#: Failed measurements of other hosts' clocks before a node says so; it goes on measuring.
FAILURES = 3
#: Periods of a message in which a life that runs hears at least one.
MANY = 20
#: s without a message, at the end of a run, after which its receiver was deaf though it may wait
#: for ever (``silence = 0``): as long as a Zenoh session waits before it is opened anew.
SILENT = 5.0
#: s of it, at most, where a node waits for longer: for a peer that is started again.
USUAL = 10.0


def missing_before_start(wired: WiredNode) -> list[str]:
    """The inputs missing before a start, a phrase each; empty: the node is ready."""
    functions, struct, system = native.functions(), wired.struct, wired.system
    node, now = c.byref(struct), monotonic_ns()
    found = [
        f"{message} from {system.messages[message].node}{_what_came_instead(wired, message)}"
        for i, message in enumerate(system.received_by(wired.name))
        if functions.node_unheard(node, i)
    ]
    found += [
        f"a heartbeat of {peer}{_wrong_state_text(wired.peers[peer].state)}"
        for i, peer in enumerate(wired.peers)
        if functions.node_absent(node, i, now)
    ]
    return found


def _what_came_instead(wired: WiredNode, message: str) -> str:
    """Frames of a message that came and are no sample of it before the start; "": none."""
    reception, sender = (
        wired.inlet_bindings.receptions[message],
        wired.system.messages[message].node,
    )
    if reception.early:
        state = _state_name(reception.early_life)
        cure = ": RESET and START it" if reception.early_life == LifeState.FAULT else ""
        return (
            f" (samples came, of a run whose t = 0 nobody has told; {sender} is in {state}{cure})"
        )
    counts = _refused(wired.receivers[message])
    counts["range"] = counts.get("range", 0) + reception.early_range
    counts["another frame format"] = reception.misfits
    said = ", ".join(name for name, n in counts.items() if n)
    return f" (came and was refused: {said})" if said else ""


def _drives_event(wired: WiredNode) -> Mapping[str, Any] | None:
    """``drives`` when all drives of an armed node are ready, or with those that were given up."""
    struct = wired.struct
    if failed := wired.commanded.given_up():
        return {"event": "drives", "failed": failed}
    if struct.life.armed and native.functions().bringup_ready(c.byref(struct), monotonic_ns()):
        return {"event": "drives", "failed": []}
    return None


def _runs_unannounced(wired: WiredNode) -> list[str]:
    """Messages of a run that is on, of which no t = 0 is known here, a phrase each."""
    return [
        f"{message} from {wired.system.messages[message].node}{_what_came_instead(wired, message)}"
        for message, reception in wired.inlet_bindings.receptions.items()
        if reception.early
    ]


def _wrong_state_text(state: int) -> str:
    """The state of a received peer, if that state prevents a start; else ""."""
    if state in (-1, LifeState.INACTIVE, LifeState.ACTIVE):
        return ""
    return f" in another state than {_state_name(state)}"


def _state_name(state: int) -> str:
    """The name of a state on a bus, or its number if there is no such state."""
    return LifeState(state).name if state in LifeState.__members__.values() else str(state)


def silent_messages(wired: WiredNode) -> list[str]:
    """Messages that a running node has not received for longer than allowed, one phrase each.

    Messages of nodes that have finished are not included. Torques of a node in FAULT, and previews
    of one that waits for its start, show that it can be received, although they are not samples of
    the run.
    """
    found = {}
    for message, silence, limit in _silences(wired):
        if 0 < limit < silence:
            found[message] = _silence_text(wired, message, silence)
    return list(found.values())


def silent_at_end(wired: WiredNode) -> list[str]:
    """Messages that a finished life had received, and no more for its last seconds, a phrase each.

    As :func:`silent_messages`, and also where the deployment sets no limit.
    """
    found = {}
    for message, silence, limit in _silences(wired):
        reception = wired.inlet_bindings.receptions[message]
        longest = min(limit, USUAL) or max(SILENT, MANY * reception.period_ns * 1e-9)
        if silence > longest and reception.newest >= 0:
            found[message] = _silence_text(wired, message, silence)
    return list(found.values())


def _silences(wired: WiredNode) -> Iterator[tuple[str, float, float]]:
    """Message, time without it and limit of that time (s, 0: none) of each input.

    Without inputs whose sender has finished.
    """
    struct, d = wired.struct, wired.system.deployment
    over = {p for p, peer in wired.peers.items() if peer.state == LifeState.FINISHED}
    for i, inlet in enumerate(wired.plan.inlets):
        reception = wired.inlet_bindings.receptions[inlet.message]
        last = max(
            wired.inlet_bindings.inlets[i].heard_ns,
            wired.receivers[inlet.message].arrival_ns,
            reception.previewed_ns - struct.start_ns if reception.previewed_ns >= 0 else 0,
        )
        if wired.system.messages[inlet.message].node not in over:
            limit = max(wired.inlet_bindings.inlets[i].stop_ns * 1e-9, d.silence)
            yield inlet.message, (struct.slot * struct.h_ns - last) * 1e-9, limit


def _silence_text(wired: WiredNode, message: str, silence: float) -> str:
    sender, refused = wired.system.messages[message].node, wired.receivers[message]
    return f"{message} from {sender} for {silence:.3g} s{_refused_counts(refused)}"


def _refused_counts(receiver: Receiver) -> str:
    """The numbers of frames of a message that came in the run and were refused, by reason."""
    said = ", ".join(f"{n} {name}" for name, n in _refused(receiver).items())
    return f" (refused in the run: {said})" if said else ""


def _refused(receiver: Receiver) -> dict[str, int]:
    """Frames of a message that came and were refused, by reason, without reasons of none."""
    counts = {name: int(getattr(receiver, name)) for name in REFUSALS}
    return {name: n for name, n in counts.items() if n}


def never_received(wired: WiredNode) -> list[str]:
    """Messages of which a finished life has not received one sample, one phrase each.

    Only messages that it needs, and of which several samples were due while it ran.
    """
    struct = wired.struct
    ran = (struct.slot - struct.first) * struct.h_ns
    return [
        f"{message} from {wired.system.messages[message].node}"
        for message, r in wired.inlet_bindings.receptions.items()
        if r.awaited and r.newest < 0 and not r.of_fault and ran > MANY * r.period_ns
    ]


def _refusal_event(wired: WiredNode) -> Mapping[str, Any]:
    struct = wired.struct
    reasons, armed = reason_names(struct.refused), bool(struct.life.armed)
    unheard = missing_before_start(wired)
    missing = [f"not heard: {', '.join(unheard)}"] if unheard else []
    if struct.refused & Why.DRIVE:
        missing += wired.commanded.not_ready()
    why = refusal(reasons, armed, missing)
    return {
        "event": "refused", "reasons": reasons, "armed": armed, "missing": missing, "why": why,
    }  # fmt: skip


@contextmanager
def report_missing_inputs(
    wired: WiredNode,
    say: Say,
    ready: Callable[[], Mapping[str, Any]],
    measured: Callable[[], bool] = lambda: False,
    helping: Helpers | None = None,
) -> Iterator[None]:
    """Send, from a thread, the events that a node's supervisor needs while C runs the node.

    ``ready`` once it has received everything it needs (`ready` returns the event), ``waiting`` with
    the missing inputs until then, ``refused`` each time it refuses ARM or START, ``joined`` with
    the time t (s) if it begins during a run, ``deaf`` when it no longer receives a message,
    ``drives`` when all drives that it commands are ready, or with a sentence for each that failed.
    If it receives an EPOCH of a run on a host without a common clock, it calls `measured` after
    each EPOCH until that returns True (t = 0 of the run was found), and sends ``unshared`` after
    `FAILURES` other results. An error of the thread stops the node, and `helping` has it.
    """
    ended, watch = threading.Event(), _Watch(wired, say, ready, measured)

    def look() -> None:
        while not ended.wait(LOOK):
            watch.look()

    thread = (helping or Helpers(Control(wired.struct))).start("watch", look)
    try:
        yield
    finally:
        ended.set()
        thread.join()


class _Watch:
    """The sentences said of a node so far."""

    def __init__(
        self,
        wired: WiredNode,
        say: Say,
        ready: Callable[[], Mapping[str, Any]],
        measured: Callable[[], bool],
    ) -> None:
        self._wired, self._say, self._ready, self._measured = wired, say, ready, measured
        self._elapsed, self._next = stopwatch(), REPEAT
        self._told_ready = self._told_deaf = self._told_joined = False
        self._refusals = self._unshared = self._failures = self._unannounced = 0
        self._drives: Mapping[str, Any] = {}

    def look(self) -> None:
        """Say what is new."""
        struct = self._wired.struct
        if not self._told_ready:
            self._look_for_ready()
        if not struct.begun:
            self._look_for_runs()
        if struct.refusals != self._refusals:
            self._refusals = struct.refusals
            self._say(_refusal_event(self._wired))
        if struct.begun:
            self._look_at_run()
        event = _drives_event(self._wired)
        if event is not None and event != self._drives:
            self._drives = event
            self._say(event)

    def _look_for_ready(self) -> None:
        missing = missing_before_start(self._wired)
        if not missing or self._wired.struct.begun:
            self._told_ready = True
            self._say(self._ready())
        elif self._elapsed() > self._next:
            self._next = self._elapsed() + REPEAT
            self._say({"event": "waiting", "for": missing})

    def _look_for_runs(self) -> None:
        """Runs that could be joined, if their t = 0 were known."""
        epoch = self._wired.struct.epoch
        if epoch.follows and (found := _runs_unannounced(self._wired)):
            self._unannounced += 1
            if self._unannounced == UNANNOUNCED:
                self._say({"event": "waiting", "for": found})
        if epoch.unshared != self._unshared:
            self._unshared = epoch.unshared
            self._failures += not self._measured()
            if self._failures == FAILURES:
                self._say({"event": "unshared"})

    def _look_at_run(self) -> None:
        struct = self._wired.struct
        if not self._told_joined:
            self._told_joined = True
            if struct.first > 0:
                self._say({"event": "joined", "t": struct.first * struct.h})
        if not self._told_deaf and (lost := silent_messages(self._wired)):
            self._told_deaf = True
            self._say({"event": "deaf", "to": lost})
