"""The steps with drives: found, settings, watchdog, direction of each joint, emergency stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from bridge.commission.drive_line import TRIES, DriveLine
from bridge.commission.interfaces import StepFinding
from bridge.commission.line_drives import LineDrive
from bridge.commission.registers import registers
from bridge.native.commanded import Failure
from cosim.base.clock import monotonic_ns
from cosim.base.errors import CosimError

#: Share of a drive's torque limit in the wiggle; rad after which it ends, and s.
WIGGLE, FAR, LONG = 0.01, 0.05, 0.5
#: rad: a joint that moves less has not moved.
NEAR = 1e-3
#: Times of its watchdog for which a drive is fed, and then not.
FED, UNFED = 2, 2
#: Times of its profile's `every` after which a drive tells its state too seldom.
SELDOM = 3
#: s for a person to press the emergency stop.
PRESS = 30.0
#: A question to a person, and whether the answer is yes.
Question = Callable[[str], bool]


def find(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    """A drive answers, tells a state of its profile and no error, and has its watchdog's time."""
    profile = drive.foreign.profile
    if not profile.status.message:
        text = "not checked: its profile has no [status], so its state is unknown"
        yield StepFinding(drive.name, "limited", text, "write its states into the profile")
        return
    why = line.bring_up([drive], enable=False).removeprefix(f"{drive.name} ")
    end = monotonic_ns() + round(max(0.5, 2 * profile.status.within) * 1e9)
    while not drive.heard and not why and monotonic_ns() < end:
        line.serve(0.02)  # some drives tell their state by themselves, now and then
    assert drive.entry is not None
    own = profile.watchdog
    if Failure(drive.entry.failure) is Failure.VALUE:
        cure = "write it with the vendor's tool"
        yield StepFinding(f"{drive.name}: {own.register}", "missing", why, cure)
        return
    yield _found(drive, why)
    if own.read is not None and not why:
        text = f"{profile.timeout * 1e3:g} ms, written and read back"
        yield StepFinding(f"{drive.name}: {own.register}", "good", text)


def _found(drive: LineDrive, why: str) -> StepFinding:
    state = drive.state
    assert drive.entry is not None
    if not drive.heard and drive.entry.failure not in (Failure.FORMAT, Failure.NUMBER):
        cure = "power, number, bit rate, wiring"
        return StepFinding(drive.name, "missing", "does not answer", cure)
    if why or state is None or state.kind == "fault":
        cure = state.cure if state is not None else "compare its firmware with the profile"
        return StepFinding(drive.name, "missing", why or f"tells {drive.says}", cure)
    place = "" if drive.q is None else f", at {drive.q:.4f} rad"
    return StepFinding(drive.name, "good", f"{drive.foreign.profile.title}: {drive.says}{place}")


def watchdog(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    """Enabled at torque 0 and then not fed: the drive has to leave its enabled state by itself."""
    name, timeout = f"{drive.name}: watchdog", drive.foreign.profile.timeout
    status = drive.foreign.profile.status
    for _ in range(TRIES):
        if why := line.bring_up([drive]).removeprefix(f"{drive.name} "):
            yield StepFinding(name, "missing", why, "see the state in the vendor's tool")
            return
        often = _fed(line, drive)
        stays = _tells_enabled(drive)
        if stays or line.late < timeout / 2:
            break
    if not stays:
        if line.late >= timeout / 2:
            text = f"not checked: this machine stood still for {line.late:.3f} s"
            yield StepFinding(name, "limited", text, "stop other work (docs/rehearsal.md)")
            return
        text = f"tells {drive.says} although it was fed in time"
        yield StepFinding(name, "missing", text, "is its watchdog shorter than the profile's?")
        return
    if 0 < often * SELDOM * status.every < 1:
        text = f"comes {often:.1f} times a second, the profile has every {status.every:g} s: "
        text += "after a trip, torques go to it for so long"
        yield StepFinding(f"{drive.name}: state", "limited", text, f"set {status.register}")
    yield _unfed(line, drive, name)


def _fed(line: DriveLine, drive: LineDrive) -> float:
    """Feed an enabled drive for some times of its watchdog; states that it told in a second."""
    profile = drive.foreign.profile
    heard, began = drive.heard, monotonic_ns()
    line.serve(max(FED * profile.timeout, profile.status.within))
    return (drive.heard - heard) / (monotonic_ns() - began) * 1e9


def _unfed(line: DriveLine, drive: LineDrive, name: str) -> StepFinding:
    """The finding on an enabled drive that gets no frame for some times of its watchdog."""
    profile = drive.foreign.profile
    line.feeding = False
    line.serve(UNFED * profile.timeout)
    heard = drive.heard
    line.ask_state(drive)
    line.serve(max(0.02, profile.status.within))
    line.feeding = True
    if drive.heard == heard:
        text = f"tells nothing any more, at last {drive.says}"
        return StepFinding(name, "missing", text, "power, wiring")
    if drive.is_enabled():
        waited = UNFED * profile.timeout * 1e3
        text = f"still {drive.says} after {waited:.0f} ms without a frame"
        return StepFinding(name, "missing", text, "its watchdog is off: set it, and do not go on")
    return StepFinding(name, "good", f"tripped without frames: {drive.says}")


def direction(line: DriveLine, drive: LineDrive, ask: Question) -> StepFinding:
    """1 % of the torque: the joint has to turn in the direction of the torque."""
    name, tau = f"{drive.name}: direction of {drive.joint}", WIGGLE * drive.limit
    if not tau or drive.q is None:
        text = "not checked: no tau_max in guard or profile, or no position came"
        return StepFinding(name, "limited", text, "tau_max of the guard")
    if not ask(f"Turn {drive.joint} ({drive.name}, at {drive.q:.4f} rad) with {tau:.3g} N.m?"):
        return StepFinding(name, "limited", "not checked: not tried", "run the step again")
    if why := line.bring_up([drive]).removeprefix(f"{drive.name} "):
        return StepFinding(name, "missing", why, "see the state in the vendor's tool")
    start, end = drive.q, monotonic_ns() + round(LONG * 1e9)
    line.torque(drive, tau)
    while monotonic_ns() < end and abs(drive.q - start) < FAR and drive.is_enabled():
        line.serve(0.01)
    moved, enabled, said = drive.q - start, drive.is_enabled(), drive.says
    line.rest()
    line.serve(0.02)
    if not enabled:
        return StepFinding(name, "missing", f"with {tau:.3g} N.m it tells {said}", "see its error")
    return _direction(drive, name, tau, (start, moved), ask)


def _direction(
    drive: LineDrive, name: str, tau: float, at: tuple[float, float], ask: Question
) -> StepFinding:
    """The finding on a motion; `at`: where it began, and how far it went, rad."""
    start, moved = at
    if abs(moved) < NEAR:
        text = f"not checked: did not move with {tau:.3g} N.m (friction, brake, or no power)"
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
        text = "not checked: the operator was not ready"
        return StepFinding(name, "limited", text, "run this step with a person at the arm")
    if why := line.bring_up(drives):
        return StepFinding(name, "missing", why, "see the earlier steps")
    end = monotonic_ns() + round(PRESS * 1e9)
    left = list(drives)
    while left and monotonic_ns() < end:
        line.serve(0.02)
        left = [drive for drive in drives if _tells_enabled(drive)]
    line.rest()
    if left:
        names = ", ".join(drive.name for drive in left)
        return StepFinding(name, "missing", f"still enabled: {names}", "it has to cut the power")
    return StepFinding(name, "good", f"all {len(drives)} drives are off")


def _tells_enabled(drive: LineDrive) -> bool:
    """Tell if a drive has said not long ago that it is enabled."""
    within = 2e9 * max(0.1, drive.foreign.profile.status.within)
    return monotonic_ns() - drive.told_ns <= within and drive.is_enabled()


def drive_steps(
    line: DriveLine, drives: Sequence[LineDrive], ask: Question, *, alone: bool
) -> Iterator[StepFinding]:
    """All steps, each only where those before it are not missing.

    `alone`: nobody is at the arm, so the emergency stop is not asked for.
    """
    good = True
    for drive in drives:
        for found in _steps_of(line, drive, ask):
            good &= found.state != "missing"
            yield found
        line.rest()
    if alone or not good:
        text = "nobody was asked (--yes)" if alone else "a drive is not ready for it"
        cure = "run this without --yes" if alone else "see the earlier steps"
        yield StepFinding("emergency stop", "limited", f"not checked: {text}", cure)
    else:
        yield emergency_stop(line, drives, ask)


def _steps_of(line: DriveLine, drive: LineDrive, ask: Question) -> Iterator[StepFinding]:
    """The steps of one drive, until one is missing."""
    steps: tuple[Callable[[], Iterator[StepFinding]], ...] = (
        lambda: find(line, drive),
        lambda: registers(line, drive),
        lambda: watchdog(line, drive),
        lambda: iter((direction(line, drive, ask),)),
    )
    for step in steps:
        missing = False
        try:
            for found in step():
                missing |= found.state == "missing"
                yield found
        except CosimError as error:
            yield StepFinding(drive.name, "missing", str(error))
            missing = True
        if missing:
            return
