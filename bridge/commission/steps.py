"""The steps with drives: found, registers, watchdog, direction of each joint, emergency stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from bridge.commission.drive_line import DriveLine, LineDrive, answer
from bridge.commission.interfaces import StepFinding
from bridge.safety.limits import to_si
from cosim.base.clock import monotonic_ns
from cosim.base.errors import CosimError

#: Share of a drive's torque limit in the wiggle; rad after which it ends, and s.
WIGGLE, FAR, LONG = 0.01, 0.05, 0.5
#: rad: a joint that moves less has not moved.
NEAR = 1e-3
#: s for a person to press the emergency stop.
PRESS = 30.0
#: A question to a person, and whether the answer is yes.
Question = Callable[[str], bool]


def find(line: DriveLine, drive: LineDrive) -> StepFinding:
    """A drive answers, tells a state of its profile, and no error that stays."""
    status = drive.foreign.profile.status
    if not status.message:
        return StepFinding(
            drive.name, "limited", "its profile has no [status]: its state is unknown"
        )
    line.ask(drive)
    why = line.raise_drive(drive, "clear")
    end = monotonic_ns() + round(max(0.5, 2 * status.within) * 1e9)
    while drive.word is None and monotonic_ns() < end:
        line.serve(0.02)  # some drives tell their state by themselves, now and then
    if drive.word is None:
        return StepFinding(
            drive.name, "missing", "does not answer", "power, number, bit rate, wiring"
        )
    state = drive.state
    if why or state is None or state.kind == "fault":
        cure = state.cure if state is not None else "compare its firmware with the profile"
        return StepFinding(drive.name, "missing", why or f"tells {drive.says}", cure)
    place = "" if drive.q is None else f", at {drive.q:.4f} rad"
    return StepFinding(drive.name, "good", f"{drive.foreign.profile.title}: {drive.says}{place}")


def register(line: DriveLine, drive: LineDrive) -> StepFinding:
    """The time-out of the drive's watchdog, written and read back."""
    profile = drive.foreign.profile
    own, name = profile.watchdog, f"{drive.name}: {profile.watchdog.register or 'watchdog'}"
    if own.read is None or own.reply is None:
        text = f"is not read by frames; expected {profile.timeout * 1e3:g} ms"
        return StepFinding(name, "limited", text, "read it with the vendor's tool")
    if own.write is not None:
        line.send(drive, own.write, own.raw(profile.timeout))
    value = answer(line, drive, own.read, own.reply)
    if value is None:
        return StepFinding(name, "missing", "no answer", "is the number of the drive right?")
    seconds = value * to_si(own.unit, "s", "watchdog.unit")
    if value != own.raw(profile.timeout):
        text = f"reads {seconds:g} s, expected {profile.timeout:g} s"
        return StepFinding(name, "missing", text, "write it with the vendor's tool")
    return StepFinding(name, "good", f"{seconds * 1e3:g} ms, as the profile has it")


def watchdog(line: DriveLine, drive: LineDrive) -> StepFinding:
    """Enabled at torque 0 and then not fed: the drive has to leave its enabled state by itself."""
    name, timeout = f"{drive.name}: watchdog", drive.foreign.profile.timeout
    if why := line.raise_drive(drive, "clear", "enable"):
        return StepFinding(name, "missing", why, "see the state in the vendor's tool")
    line.serve(4 * timeout)
    state = drive.state
    if state is None or state.kind != "enabled":
        text = f"tells {drive.says} although it was fed every {timeout / 4 * 1e3:g} ms"
        line.disable(drive)
        return StepFinding(name, "missing", text, "is its watchdog shorter than the profile's?")
    line.feeding = False
    line.serve(3 * timeout)
    line.ask(drive)  # torque 0, to be told
    line.serve(max(0.02, drive.foreign.profile.status.within))
    line.feeding = True
    tripped, said = drive.state is not None and drive.state.kind != "enabled", drive.says
    line.disable(drive)
    line.serve(0.02)
    if not tripped:
        text = f"still {said} after {3 * timeout * 1e3:.0f} ms without a frame"
        return StepFinding(name, "missing", text, "its watchdog is off: set it, and do not go on")
    return StepFinding(name, "good", f"tripped without frames: {said}")


def direction(line: DriveLine, drive: LineDrive, ask: Question) -> StepFinding:
    """1 % of the torque: the joint has to turn in the direction of the torque."""
    name = f"{drive.name}: direction of {drive.joint}"
    tau = WIGGLE * drive.limit
    if not tau or drive.q is None:
        return StepFinding(name, "limited", "no tau_max in guard or profile, or no position came")
    if not ask(f"Turn {drive.joint} ({drive.name}, at {drive.q:.4f} rad) with {tau:.3g} N.m?"):
        return StepFinding(name, "limited", "not tried", "run the step again")
    if why := line.raise_drive(drive, "clear", "enable"):
        return StepFinding(name, "missing", why, "see the state in the vendor's tool")
    start, end = drive.q, monotonic_ns() + round(LONG * 1e9)
    drive.tau = tau
    while monotonic_ns() < end and abs(drive.q - start) < FAR:
        line.serve(0.01)
    moved = drive.q - start
    line.disable(drive)
    line.serve(0.02)
    if abs(moved) < NEAR:
        text = f"did not move with {tau:.3g} N.m (friction, brake, or no power)"
        return StepFinding(name, "limited", text, "turn it by hand: does q follow?")
    if moved < 0:
        text = f"turned by {moved:.4f} rad with a positive torque"
        return StepFinding(name, "missing", text, "direction = -1 in the deployment")
    if not ask(
        f"Did {drive.joint} turn in its positive direction, and is {start:.4f} rad its place?"
    ):
        text = "sign or zero differ from the model"
        return StepFinding(name, "missing", text, "direction and zero in the deployment")
    return StepFinding(name, "good", f"turned by {moved:.4f} rad from {start:.4f} rad")


def emergency_stop(line: DriveLine, drives: Sequence[LineDrive], ask: Question) -> StepFinding:
    """All drives enabled at torque 0 until somebody presses the emergency stop."""
    name = "emergency stop"
    if not ask(f"Press the emergency stop within {PRESS:g} s after this answer. Ready?"):
        return StepFinding(name, "limited", "not proven", "run this step with a person at the arm")
    for drive in drives:
        if why := line.raise_drive(drive, "clear", "enable"):
            return StepFinding(name, "missing", f"{drive.name}: {why}", "see the earlier steps")
    end = monotonic_ns() + round(PRESS * 1e9)
    while monotonic_ns() < end:
        line.serve(0.05)
        left = [d for d in drives if _alive(d)]
        if not left:
            return StepFinding(name, "good", "every drive is off")
    names = ", ".join(d.name for d in left)
    return StepFinding(name, "missing", f"still enabled: {names}", "it has to cut the power")


def _alive(drive: LineDrive) -> bool:
    """Tell if a drive still says that it is enabled."""
    old = monotonic_ns() - drive.told_ns > 2e9 * max(0.1, drive.foreign.profile.status.within)
    return not old and drive.state is not None and drive.state.kind == "enabled"


def drive_steps(
    line: DriveLine, drives: Sequence[LineDrive], ask: Question, *, alone: bool
) -> Iterator[StepFinding]:
    """All steps, each only where those before it are not missing.

    `alone`: nobody is at the arm, so the emergency stop is not asked for.
    """
    for drive in drives:
        for step in (find, register, watchdog, lambda li, dr: direction(li, dr, ask)):
            try:
                found = step(line, drive)
            except CosimError as error:
                found = StepFinding(drive.name, "missing", str(error))
            yield found
            if found.state == "missing":
                break
    if alone:
        text = "not proven: nobody was asked (--yes)"
        yield StepFinding("emergency stop", "limited", text, "run this without --yes")
    else:
        yield emergency_stop(line, drives, ask)
