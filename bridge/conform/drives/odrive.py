"""Rules for an ODrive axis over CANSimple.

From the vendor's reference of CANSimple and its enumerations (firmware 0.6). The frames are written
here anew, apart from the profiles and the emulated drive.
"""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from statistics import median

from bridge.conform.drives.bench import CameFrame, DriveBench, DriveSilentError, shown
from bridge.conform.drives.kit import DriveProtocol, Outcome, numbered

_VERSION, _HEARTBEAT, _ESTOP, _ERROR, _AXIS, _ESTIMATES, _MODE, _TORQUE, _CLEAR = (
    0x00, 0x01, 0x02, 0x03, 0x07, 0x09, 0x0B, 0x0E, 0x18,
)  # fmt: skip
_IDLE, _CLOSED_LOOP = 1, 8
_BUSY = 1
_WATCHDOG, _ESTOPPED = 0x1000000, 0x2000000
#: s: a heartbeat comes at least so often; an answer and a change of state within such a time.
_BEAT, _ANSWERS, _OBEYS = 0.35, 0.1, 1.0
#: The period of set-points that feed the watchdog, s.
_FEED = 0.005


def _id(bench: DriveBench, command: int) -> int:
    return bench.node << 5 | command


def _send(bench: DriveBench, command: int, data: bytes = b"") -> None:
    bench.send(_id(bench, command), data)


def _asked(bench: DriveBench, command: int) -> CameFrame | None:
    """The answer to a remote frame; None: none."""
    bench.send(_id(bench, command), remote=True)
    return bench.find(lambda f: f.id == _id(bench, command), _ANSWERS)[0]


def _beat(bench: DriveBench) -> tuple[int, int, int]:
    """Errors, state and result of the next heartbeat. Raises DriveSilentError without one."""
    found, _ = bench.find(lambda f: _is_beat(bench, f), _BEAT)
    if found is None:
        raise DriveSilentError("no heartbeat came")
    return _told(found)


def _is_beat(bench: DriveBench, frame: CameFrame) -> bool:
    return frame.id == _id(bench, _HEARTBEAT) and len(frame.data) >= 6


def _told(frame: CameFrame) -> tuple[int, int, int]:
    errors, state, result = struct.unpack("<IBB", frame.data[:6])
    return errors, state, result


def _text(told: tuple[int, int, int]) -> str:
    return f"errors 0x{told[0]:X}, axis state {told[1]}, result {told[2]}"


def _settled(bench: DriveBench) -> tuple[int, int, int]:
    """The heartbeat after the next one, or when the axis is not busy any more."""
    _beat(bench)
    told = _beat(bench)
    for _ in range(round(_OBEYS / 0.01)):
        if told[2] != _BUSY:
            break
        told = _beat(bench)
    return told


def _disable(bench: DriveBench) -> None:
    _send(bench, _AXIS, struct.pack("<I", _IDLE))
    bench.listen(_ANSWERS)


def _prepare(bench: DriveBench) -> None:
    _disable(bench)
    _send(bench, _CLEAR, b"\0")
    bench.listen(_ANSWERS)


def _feed(bench: DriveBench) -> None:
    _send(bench, _TORQUE, struct.pack("<f", 0.0))


def _fed(bench: DriveBench, seconds: float) -> list[CameFrame]:
    """All frames of a while in which the watchdog is fed."""
    return bench.every(seconds, _FEED, lambda: _feed(bench))


def _request(bench: DriveBench) -> tuple[int, int, int]:
    """Torque mode, closed loop; the last heartbeat while it is fed. Raises DriveSilentError."""
    _send(bench, _MODE, struct.pack("<II", 1, 1))
    _send(bench, _AXIS, struct.pack("<I", _CLOSED_LOOP))
    beats = [f for f in _fed(bench, 0.5) if _is_beat(bench, f)]
    if not beats:
        raise DriveSilentError("no heartbeat came")
    return _told(beats[-1])


def _close(bench: DriveBench) -> None:
    """Bring it into closed loop, fed. Raises DriveSilentError if it does not get there."""
    if (told := _request(bench))[1] != _CLOSED_LOOP:
        raise DriveSilentError(f"the axis is not in closed loop: {_text(told)}")


# ---- rules that only read ----------------------------------------------------------------------


def _beats(bench: DriveBench) -> Outcome:
    found, seen = bench.find(lambda f: f.id == _id(bench, _HEARTBEAT), _BEAT)
    if found is None:
        return False, shown(seen)
    return len(found.data) >= 6, shown([found])


def _regular(bench: DriveBench) -> Outcome:
    times = [f.t_ns for f in bench.listen(1.2) if f.id == _id(bench, _HEARTBEAT)]
    gaps = [(b - a) * 1e-6 for a, b in pairwise(times)]
    if len(gaps) < 2:
        return False, f"{len(times)} heartbeats in 1.2 s"
    usual = median(gaps)
    fine = max(gaps) < 2 * usual + 20 and usual < 1e3 * _BEAT
    return fine, f"usually {usual:.1f} ms, at most {max(gaps):.1f} ms"


def _state_known(bench: DriveBench) -> Outcome:
    told = _beat(bench)
    return 0 <= told[1] <= 14, _text(told)


def _estimates(bench: DriveBench) -> Outcome:
    found = _asked(bench, _ESTIMATES)
    if found is None or len(found.data) != 8:
        return False, shown([found] if found else [])
    q, dq = struct.unpack("<ff", found.data)
    return math.isfinite(q) and math.isfinite(dq), f"{q:g} turns, {dq:g} turns/s"


def _version(bench: DriveBench) -> Outcome:
    found = _asked(bench, _VERSION)
    fine = found is not None and len(found.data) == 8 and found.data[0] == 2
    return fine, shown([found] if found else [])


def _errors(bench: DriveBench) -> Outcome:
    found, told = _asked(bench, _ERROR), _beat(bench)
    if found is None or len(found.data) != 8:
        return False, shown([found] if found else [])
    active, _ = struct.unpack("<II", found.data)
    return active == told[0], f"active errors 0x{active:X}, heartbeat 0x{told[0]:X}"


def _foreign(bench: DriveBench) -> Outcome:
    other = (bench.node + 1) % 63
    bench.send(other << 5 | _VERSION, remote=True)
    found = [f for f in bench.listen(_ANSWERS) if f.id == _id(bench, _VERSION)]
    return not found, shown(found)


# ---- rules that switch it ----------------------------------------------------------------------


def _idle(bench: DriveBench) -> Outcome:
    _send(bench, _AXIS, struct.pack("<I", _IDLE))
    told = _settled(bench)
    return told[1] == _IDLE, _text(told)


def _no_errors(bench: DriveBench) -> Outcome:
    _send(bench, _CLEAR, b"\0")
    told = _settled(bench)
    return told[0] == 0, _text(told)


def _rests(bench: DriveBench) -> Outcome:
    _fed(bench, 0.2)
    told = _beat(bench)
    return told[1] == _IDLE, f"{_text(told)}, after set-points of 0 N.m"


def _closed(bench: DriveBench) -> Outcome:
    told = _request(bench)
    return told[:2] == (0, _CLOSED_LOOP), _text(told)


def _invalid(bench: DriveBench) -> Outcome:
    _send(bench, _AXIS, struct.pack("<I", 77))
    told = _settled(bench)
    return told[1] == _IDLE, _text(told)


def _stays(bench: DriveBench) -> Outcome:
    _close(bench)
    beats = [f for f in _fed(bench, max(0.5, 3 * bench.setup.watchdog)) if _is_beat(bench, f)]
    wrong = [f for f in beats if _told(f)[1] != _CLOSED_LOOP]
    return bool(beats) and not wrong, _text(_told((wrong or beats)[-1])) if beats else "nothing"


def _leaves(bench: DriveBench) -> Outcome:
    _close(bench)
    _send(bench, _AXIS, struct.pack("<I", _IDLE))
    told = _settled(bench)
    return told[:2] == (0, _IDLE), _text(told)


def _unfed(bench: DriveBench) -> list[tuple[float, bool, CameFrame]]:
    """The frames after the last set-point that tell whether it has no error and is in closed loop:
    s since it, True if so, and the frame. Errors are asked for, since heartbeats come seldom.
    """
    _close(bench)
    _feed(bench)
    begin, found = bench.line.now(), []
    ask = _id(bench, _ERROR)
    for f in bench.every(bench.setup.watchdog + 0.5, _FEED, lambda: bench.send(ask, remote=True)):
        at = (f.t_ns - begin) * 1e-9
        if f.id == ask and len(f.data) == 8:
            found.append((at, f.data[:4] == bytes(4), f))
        elif _is_beat(bench, f):
            found.append((at, _told(f)[1] == _CLOSED_LOOP, f))
    return found


def _not_early(bench: DriveBench) -> Outcome:
    if not bench.setup.watchdog:
        return None, "--watchdog does not tell its time-out"
    off = [at for at, alive, _ in _unfed(bench) if not alive]
    kept = not off or off[0] > 0.9 * bench.setup.watchdog
    return kept, f"it left closed loop after {off[0] * 1e3:.1f} ms" if off else "closed loop"


def _not_late(bench: DriveBench) -> Outcome:
    if not bench.setup.watchdog:
        return None, "--watchdog does not tell its time-out"
    told = _unfed(bench)
    alive = [at for at, alive, _ in told if alive]
    left = len(alive) < len(told)
    kept = left and (not alive or alive[-1] < 1.1 * bench.setup.watchdog + 0.02)
    until = f"{alive[-1] * 1e3:.1f} ms" if alive else "0 ms"
    return kept, f"in closed loop until {until}" if left else "it stayed in closed loop"


def _expired(bench: DriveBench) -> tuple[int, int, int]:
    """The state after the watchdog has expired. Raises DriveSilentError if it does not."""
    if not bench.setup.watchdog:
        raise DriveSilentError("--watchdog does not tell its time-out")
    beats = [f for _, _, f in _unfed(bench) if _is_beat(bench, f)]
    if not beats or _told(beats[-1])[1] == _CLOSED_LOOP:
        raise DriveSilentError("the axis did not leave closed loop without set-points")
    return _told(beats[-1])


def _watchdog_error(bench: DriveBench) -> Outcome:
    told = _expired(bench)
    return told[0] & _WATCHDOG != 0 and told[1] == _IDLE, _text(told)


def _latches(bench: DriveBench) -> Outcome:
    _expired(bench)
    told = _request(bench)
    return told[1] == _IDLE, f"{_text(told)}, after a request for closed loop"


def _clears(bench: DriveBench) -> Outcome:
    _expired(bench)
    _send(bench, _CLEAR, b"\0")
    told = _settled(bench)
    return told[:2] == (0, _IDLE), _text(told)


def _again(bench: DriveBench) -> Outcome:
    _expired(bench)
    _prepare(bench)
    return _closed(bench)


def _stop(bench: DriveBench) -> Outcome:
    _close(bench)
    _send(bench, _ESTOP)
    told = _settled(bench)
    return told[1] == _IDLE and told[0] & _ESTOPPED != 0, _text(told)


_RULES = numbered(
    "O",
    "ODrive CANSimple",
    (
        ("heartbeat", "Heartbeat (0x01)", "A heartbeat comes by itself within 0.35 s.",
         _beats, ""),
        ("regular heartbeats", "Heartbeat (0x01)",
         "No gap is longer than two of the usual ones.", _regular, "timed"),
        ("a known state", "Heartbeat (0x01), Axis_State", "The axis state is one of 0 to 14.",
         _state_known, ""),
        ("estimates", "Get_Encoder_Estimates (0x09)",
         "A remote frame is answered by two finite numbers within 100 ms.", _estimates, ""),
        ("version", "Get_Version (0x00)",
         "A remote frame is answered with protocol version 2 within 100 ms.", _version, ""),
        ("errors", "Get_Error (0x03)",
         "The active errors are those of the heartbeat.", _errors, ""),
        ("not for others", "node ID", "A request to another node is not answered.",
         _foreign, ""),
        ("idle", "Set_Axis_State (0x07)", "After a request for idle the axis state is 1.",
         _idle, "moves"),
        ("no errors", "Clear_Errors (0x18)", "After Clear_Errors there are none.",
         _no_errors, "moves"),
        ("no power without a request", "Set_Input_Torque (0x0E)",
         "Set-points leave an idle axis idle.", _rests, "moves"),
        ("closed loop", "Set_Axis_State (0x07)",
         "After a request for closed loop the axis state is 8 within 0.5 s, without errors.",
         _closed, "moves"),
        ("an invalid state", "Set_Axis_State (0x07)", "An unknown state leaves the axis idle.",
         _invalid, "moves"),
        ("fed", "watchdog", "With a set-point every 5 ms it stays in closed loop.",
         _stays, "moves timed"),
        ("idle again", "Set_Axis_State (0x07)",
         "A request for idle leaves closed loop, without errors.", _leaves, "moves"),
        ("watchdog not early", "watchdog_timeout",
         "Without set-points it stays in closed loop for 90 % of its time-out.",
         _not_early, "moves timed"),
        ("watchdog not late", "watchdog_timeout",
         "Without set-points it is idle after 110 % of its time-out and 20 ms.",
         _not_late, "moves timed"),
        ("watchdog error", "WATCHDOG_TIMER_EXPIRED",
         "After its time-out it is idle with the error 0x1000000.", _watchdog_error, "moves"),
        ("an error stays", "Set_Axis_State (0x07)",
         "With an error a request for closed loop is refused.", _latches, "moves"),
        ("clear errors", "Clear_Errors (0x18)", "Clear_Errors takes the error of the watchdog.",
         _clears, "moves"),
        ("closed loop after an error", "Clear_Errors (0x18)",
         "After Clear_Errors closed loop is reached again.", _again, "moves"),
        ("emergency stop", "Estop (0x02)",
         "Estop leaves closed loop for idle, with the error 0x2000000.", _stop, "moves"),
    ),
)  # fmt: skip
ODRIVE = DriveProtocol("odrive", _RULES, _disable, _prepare)
