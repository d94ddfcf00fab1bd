"""A check of a rule against a participant, and what many checks have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from bridge.conform.hearing import Heard, HeardFrame
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import ParticipantStage
from bridge.native.enums import LifeState, Why
from bridge.safety.limits import names
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import CosimError

#: Reasons that the kit itself gives if it is late.
OF_A_SLOW_MACHINE = Why.STALE | Why.PEER | Why.WATCHDOG | Why.OVERRUN | Why.SYNC
STOPPED = (LifeState.STOPPING, LifeState.FAULT)
#: s: tolerance of a time that was measured by arrival, beside a slot and the lateness of the kit.
TOLERANCE = 0.02


class BrokenRuleError(CosimError):
    """The participant breaks a rule; the text is what came."""


class InapplicableRuleError(CosimError):
    """A rule does not apply to this participant; the text says why."""


class VoidAttemptError(CosimError):
    """An attempt says nothing: the participant stopped for a reason of the machine."""


class CheckScene(IntEnum):
    """The situation in which a check begins."""

    WAITING = 0
    """Before the first START; peers are silent until :meth:`ParticipantStage.start`."""
    ACTIVE = 1
    """The participant is ACTIVE. Each check leaves it in any state."""
    ENDING = 2
    """The scene ACTIVE at the end of a kit, in which the participant may end."""
    OTHER_LIFE = 3
    """Any: the check starts the participant again."""
    RECORD = 4
    """All that was sent, after the end."""


#: Does the check; returns what came. Raises BrokenRuleError, InapplicableRuleError.
Judge = Callable[[ParticipantStage], str]


@dataclass(frozen=True, slots=True)
class Check:
    """A rule and its judge. `needs`: seconds of the run that it takes at most."""

    rule: ConformityRule
    scene: CheckScene
    judge: Judge
    needs: float = 3.0


class ToldStop(NamedTuple):
    """A stop of a participant: the frame that tells it first, and the reasons."""

    first: HeardFrame
    reasons: int

    def text(self) -> str:
        """For people."""
        return f"{self.first.text()} tells {self.first.state_name} for {reason_text(self.reasons)}"


def reason_text(reasons: int) -> str:
    """Names of reasons."""
    return ", ".join(names(Why(reasons))) or "no reason"


def wait_stop(stage: ParticipantStage, mark: int, seconds: float) -> ToldStop | None:
    """The stop that the participant tells first, from frame `mark` on; None: none in `seconds` (s).

    Raises VoidAttemptError for reasons that a slow machine has.
    """
    found = stage.hearing.wait(
        lambda f: f.kind in (Heard.SAMPLE, Heard.HEARTBEAT) and f.state in STOPPED, mark, seconds
    )
    if found is None:
        return None
    beat = stage.hearing.wait(
        lambda f: f.kind is Heard.HEARTBEAT and bool(f.reasons), found.index, 0.5
    )
    reasons = beat.reasons if beat else 0
    if reasons & Why.OVERRUN:
        raise VoidAttemptError(f"the participant stopped for {reason_text(reasons)}")
    return ToldStop(found, reasons)


def expect_stop(
    stage: ParticipantStage, mark: int, seconds: float, why: Why, what: str
) -> ToldStop:
    """The stop for the reason `why`, within `seconds` (s) after `what`.

    Raises BrokenRuleError if there is none, or for another reason; VoidAttemptError for one that a
    slow machine gives.
    """
    stop = wait_stop(stage, mark, seconds)
    if stop is None:
        raise BrokenRuleError(f"it stays {state_text(stage)} for {seconds:.3g} s after {what}")
    if stop.reasons & ~why & OF_A_SLOW_MACHINE:
        raise VoidAttemptError(f"after {what}: {stop.text()}")
    if not stop.reasons & why:
        raise BrokenRuleError(f"after {what}: {stop.text()}, expected {reason_text(why)}")
    return stop


def expect_active(stage: ParticipantStage, mark: int, seconds: float, what: str) -> str:
    """A text that says that the participant stayed ACTIVE for `seconds` (s) of `what`.

    Raises BrokenRuleError if it did not.
    """
    stop = wait_stop(stage, mark, seconds)
    if stop is not None:
        raise BrokenRuleError(f"with {what}: {stop.text()}")
    beat = stage.wait_beat(0.5)
    if beat is None or beat.state is not LifeState.ACTIVE:
        came = beat.text() if beat else "no heartbeat"
        raise BrokenRuleError(f"with {what} it does not stay ACTIVE: {came}")
    return f"ACTIVE through {seconds:.3g} s of {what}"


def needs_program(stage: ParticipantStage) -> None:
    """Raise InapplicableRuleError if the kit cannot start the participant."""
    if not stage.program.given:
        raise InapplicableRuleError("the kit has no command to start the participant again")


def needs_epoch(stage: ParticipantStage) -> None:
    """Raise InapplicableRuleError if no bus of the participant has EPOCH."""
    if not any(s.epoch for s in stage.cast.services.values()):
        raise InapplicableRuleError("no bus of the participant has the service EPOCH")


def state_text(stage: ParticipantStage) -> str:
    """The state in the newest heartbeat."""
    beat = stage.hearing.latest_beat()
    return "silent" if beat is None or beat.state is None else beat.state.name


def settle(stage: ParticipantStage, slots: int = 2) -> None:
    """Wait for some slots."""
    sleep(slots * stage.slot + 0.01)


def seconds_since(t_ns: int) -> float:
    """The time since a monotonic time (ns), s."""
    return (monotonic_ns() - t_ns) * 1e-9


def torque_values(stage: ParticipantStage, heard: HeardFrame) -> list[float]:
    """The torques in a sample (N.m), none if it carries none: values of the guard's port."""
    port = stage.spec.guard.port if stage.spec.guard else ""
    carried = stage.system.messages.get(heard.name)
    if carried is None or not heard.values or not port:
        return []
    found, first = list[float](), 0
    for part in carried.outlet.parts:
        if part.port == port:
            found += heard.values[first : first + part.size]
        first += part.size
    return found


def torque_messages(stage: ParticipantStage) -> list[str]:
    """The participant's messages that carry a guarded torque."""
    port = stage.spec.guard.port if stage.spec.guard else ""
    sent = (m for m in stage.system.messages.values() if m.node == stage.node)
    return [m.name for m in sent if port and any(p.port == port for p in m.outlet.parts)]


def nominal_ns(stage: ParticipantStage, heard: HeardFrame, t0_ns: int) -> int | None:
    """The nominal time of a sample (monotonic, ns), by its time stamp; None: it has none.

    The stamp is extended by the time of arrival.
    """
    carried = stage.system.messages[heard.name]
    message = carried.encoding.message
    if message.time < 0:
        return None
    span = 1 << int(message.header[message.time].length)
    arrived_us = (heard.t_ns - t0_ns) // 1000
    behind = (arrived_us - heard.t_us) % span
    behind = behind - span if behind > span // 2 else behind
    return t0_ns + (arrived_us - behind) * 1000
