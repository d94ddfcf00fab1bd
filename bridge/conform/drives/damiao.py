"""Rules for a Damiao drive of the DM series in MIT mode.

From the vendor's documents: control frames, feedback frame, registers and error codes. The frames
are written here anew, apart from the profiles and the emulated drive.
"""

from __future__ import annotations

import math
import struct

from bridge.conform.drives.bench import CameFrame, DriveBench, DriveSilentError, shown
from bridge.conform.drives.kit import DriveProtocol, Outcome, numbered
from bridge.native.frame import Flags

_ENABLE, _DISABLE, _CLEAR = 0xFC, 0xFD, 0xFB
_REGISTERS, _READ, _WRITE, _REFRESH = 0x7FF, 0x33, 0x55, 0xCC
_MST_ID, _ESC_ID, _TIMEOUT, _MODE, _RANGES, _CAN_BR = 7, 8, 9, 10, (21, 22, 23), 35
_MIT, _CLASSIC_1M, _UNIT = 1, 4, 50e-6
_DISABLED, _ENABLED, _LOST = 0, 1, 0xD
#: s: an answer comes within this time; the power stage is on after so long.
_ANSWERS, _OBEYS = 0.05, 0.1
#: The period of commands that feed the watchdog, s.
_FEED = 0.01
#: No gains, the codes nearest to 0: a command that asks for nothing.
_NEUTRAL = bytes.fromhex("7fff7ff0000007ff")
#: TIMEOUT for the rules of the watchdog, s.
_WATCHDOG = 0.1


def _command(bench: DriveBench, data: bytes) -> list[CameFrame]:
    """The frames after one to the drive, within the time of an answer."""
    bench.send(bench.node, data)
    return bench.listen(_ANSWERS)


def _status(bench: DriveBench, data: bytes = _NEUTRAL) -> int:
    """The status nibble of the answer to a frame. Raises DriveSilentError without an answer."""
    told = [f for f in _command(bench, data) if _is_feedback(bench, f)]
    if not told:
        raise DriveSilentError("the drive did not answer a command")
    return told[-1].data[0] >> 4


def _special(what: int) -> bytes:
    return b"\xff" * 7 + bytes([what])


def _is_feedback(bench: DriveBench, frame: CameFrame) -> bool:
    mine = len(frame.data) == 8 and frame.data[0] & 15 == bench.node & 15
    return mine and frame.id not in (bench.node, _REGISTERS)


def _asked(
    bench: DriveBench, what: int, register: int, value: bytes = bytes(4)
) -> CameFrame | None:
    """The answer to a register request; None: none."""
    head = struct.pack("<HBB", bench.node, what, register)
    bench.send(_REGISTERS, head + value)
    found, _ = bench.find(lambda f: f.id != _REGISTERS and f.data[:4] == head, _ANSWERS)
    return found


def _read(bench: DriveBench, register: int) -> bytes:
    """The four bytes of a register. Raises DriveSilentError without an answer."""
    found = _asked(bench, _READ, register)
    if found is None or len(found.data) != 8:
        raise DriveSilentError(f"register {register} was not answered")
    return found.data[4:]


def _number(bench: DriveBench, register: int) -> int:
    return int.from_bytes(_read(bench, register), "little")


def _disable(bench: DriveBench) -> None:
    bench.send(bench.node, _special(_DISABLE))
    bench.listen(_ANSWERS)


def _prepare(bench: DriveBench) -> None:
    _disable(bench)
    bench.send(bench.node, _special(_CLEAR))
    bench.listen(_ANSWERS)


def _request(bench: DriveBench) -> None:
    """Ask it to enable, and feed its watchdog meanwhile."""
    bench.send(bench.node, _special(_ENABLE))
    bench.every(_OBEYS, _FEED, lambda: bench.send(bench.node, _NEUTRAL))


def _enable(bench: DriveBench) -> None:
    """Enable it, without torque. Raises DriveSilentError if it does not get there."""
    _request(bench)
    if (status := _status(bench)) != _ENABLED:
        raise DriveSilentError(f"the drive was not enabled: status 0x{status:X}")


# ---- rules that only read ----------------------------------------------------------------------


def _silent(bench: DriveBench) -> Outcome:
    found = [f for f in bench.listen(0.3) if _is_feedback(bench, f)]
    return not found, shown(found)


def _registers_answer(bench: DriveBench) -> Outcome:
    found = _asked(bench, _READ, _MODE)
    return found is not None and len(found.data) == 8, shown([found] if found else [])


def _mode(bench: DriveBench) -> Outcome:
    mode = _number(bench, _MODE)
    return mode == _MIT, f"CTRL_MODE {mode}"


def _numbers(bench: DriveBench) -> Outcome:
    master, own = _number(bench, _MST_ID), _number(bench, _ESC_ID)
    if not master and not own:
        return None, "registers 7 and 8 read 0: the drive does not tell its numbers"
    found = _asked(bench, _READ, _MODE)
    on = 0 if found is None else found.id
    came = f"MST_ID 0x{master:X}, ESC_ID 0x{own:X}, answers on 0x{on:X}"
    return (own, master) == (bench.node, on), came


def _ranges(bench: DriveBench) -> Outcome:
    values = [struct.unpack("<f", _read(bench, r))[0] for r in _RANGES]
    fine = all(math.isfinite(x) and 0.0 < x < 1e4 for x in values)
    return fine, f"P_MAX {values[0]:g}, V_MAX {values[1]:g}, T_MAX {values[2]:g}"


def _format(bench: DriveBench) -> Outcome:
    rate, found = _number(bench, _CAN_BR), _asked(bench, _READ, _MODE)
    fd = found is not None and bool(found.flags & Flags.FD)
    return fd == (rate > _CLASSIC_1M), f"can_br {rate}, {'CAN FD' if fd else 'classic'} answers"


def _foreign(bench: DriveBench) -> Outcome:
    other = bench.node + 0x70
    bench.send(_REGISTERS, struct.pack("<HBB4x", other, _READ, _MODE))
    found = [f for f in bench.listen(_ANSWERS) if f.id == 0x10 + bench.node]
    return not found, shown(found)


def _refresh(bench: DriveBench) -> Outcome:
    bench.send(_REGISTERS, struct.pack("<HB5x", bench.node, _REFRESH))
    found = [f for f in bench.listen(_ANSWERS) if f.id != _REGISTERS]
    if found and found[0].data[2:3] == bytes([_REFRESH]):
        return None, f"{shown(found)}: the drive takes it as a register request"
    told = [f for f in found if _is_feedback(bench, f)]
    return len(told) == 1, shown(found)


# ---- rules that switch it ----------------------------------------------------------------------


def _disabled(bench: DriveBench) -> Outcome:
    status = _status(bench, _special(_DISABLE))
    return status == _DISABLED, f"status 0x{status:X}"


def _one_answer(bench: DriveBench) -> Outcome:
    found = [f for f in _command(bench, _special(_DISABLE)) if f.id != bench.node]
    return len(found) == 1 and len(found[0].data) == 8, shown(found)


def _own_number(bench: DriveBench) -> Outcome:
    found = [f for f in _command(bench, _special(_DISABLE)) if f.id != bench.node]
    return bool(found) and _is_feedback(bench, found[0]), shown(found)


def _enabled(bench: DriveBench) -> Outcome:
    _request(bench)
    status = _status(bench)
    return status == _ENABLED, f"status 0x{status:X}"


def _leaves(bench: DriveBench) -> Outcome:
    _enable(bench)
    _disable(bench)
    status = _status(bench)
    return status == _DISABLED, f"status 0x{status:X}"


def _rests(bench: DriveBench) -> Outcome:
    status = _status(bench)
    return status == _DISABLED, f"status 0x{status:X} after a MIT command"


def _writes(bench: DriveBench) -> Outcome:
    before = _read(bench, _TIMEOUT)
    _set_timeout(bench, 0.123)
    after = _number(bench, _TIMEOUT)
    _asked(bench, _WRITE, _TIMEOUT, before)
    return after == round(0.123 / _UNIT), f"{after} of {round(0.123 / _UNIT)}"


def _set_timeout(bench: DriveBench, seconds: float) -> None:
    _asked(bench, _WRITE, _TIMEOUT, struct.pack("<I", round(seconds / _UNIT)))


def _after(bench: DriveBench, timeout: float, silence: float) -> int:
    """The status after a silence, with this TIMEOUT, which is then as before."""
    before = _read(bench, _TIMEOUT)
    _set_timeout(bench, timeout)
    try:
        _enable(bench)
        bench.send(bench.node, _NEUTRAL)
        bench.listen(silence)
        return _status(bench)
    finally:
        _asked(bench, _WRITE, _TIMEOUT, before)


def _not_early(bench: DriveBench) -> Outcome:
    status = _after(bench, _WATCHDOG, 0.8 * _WATCHDOG)
    return status == _ENABLED, f"status 0x{status:X} after {80 * _WATCHDOG / 0.1:g} ms"


def _not_late(bench: DriveBench) -> Outcome:
    status = _after(bench, _WATCHDOG, 1.2 * _WATCHDOG)
    return status == _LOST, f"status 0x{status:X} after {120 * _WATCHDOG / 0.1:g} ms"


def _off(bench: DriveBench) -> Outcome:
    status = _after(bench, 0.0, 0.5)
    return status == _ENABLED, f"status 0x{status:X} after 0.5 s"


def _lost(bench: DriveBench) -> None:
    """Bring it into the error of a lost communication. Raises DriveSilentError if it does not."""
    if (status := _after(bench, _WATCHDOG, 2 * _WATCHDOG)) != _LOST:
        raise DriveSilentError(f"the drive's watchdog did not expire: status 0x{status:X}")


def _latches(bench: DriveBench) -> Outcome:
    _lost(bench)
    _request(bench)
    status = _status(bench)
    return status == _LOST, f"status 0x{status:X} after a request to enable"


def _clears(bench: DriveBench) -> Outcome:
    _lost(bench)
    bench.send(bench.node, _special(_CLEAR))
    bench.listen(_ANSWERS)
    status = _status(bench)
    return status == _DISABLED, f"status 0x{status:X} after clear error"


def _again(bench: DriveBench) -> Outcome:
    _lost(bench)
    _prepare(bench)
    return _enabled(bench)


_RULES = numbered(
    "D",
    "Damiao DM-J manual",
    (
        ("silent unasked", "feedback frame", "It sends nothing unless it is asked.", _silent, ""),
        ("registers are answered", "read register (33)",
         "A read of register 10 is answered within 50 ms, with its request in front.",
         _registers_answer, ""),
        ("MIT mode", "register 10, CTRL_MODE", "CTRL_MODE is 1.", _mode, ""),
        ("its numbers", "registers 7 and 8",
         "ESC_ID is its number, and MST_ID the identifier of its answers.", _numbers, ""),
        ("its ranges", "registers 21 to 23", "P_MAX, V_MAX and T_MAX are positive.", _ranges, ""),
        ("format of answers", "register 35, can_br",
         "Answers are CAN FD if can_br is more than 1 Mbit/s, else classic.", _format, ""),
        ("not for others", "register request", "Requests for another number are not answered.",
         _foreign, ""),
        ("refresh", "refresh (CC)", "A request for its state has one feedback frame as answer.",
         _refresh, ""),
        ("one answer", "control frames", "A command is answered by one frame of 8 bytes.",
         _one_answer, "moves"),
        ("its number in the answer", "feedback frame, D0",
         "The low nibble of D0 is its number.", _own_number, "moves"),
        ("disabled", "disable (FD)", "The answer to FD has the status 0.", _disabled, "moves"),
        ("no power without a request", "feedback frame, ERR",
         "A MIT command to a disabled drive leaves it disabled: status 0.", _rests, "moves"),
        ("enabled", "enable (FC)", "After FC the status is 1 within 100 ms.", _enabled, "moves"),
        ("disabled again", "disable (FD)", "After FD an enabled drive has the status 0.",
         _leaves, "moves"),
        ("TIMEOUT is kept", "register 9, TIMEOUT",
         "A value that is written, in 50 us, is read back.", _writes, "moves"),
        ("watchdog not early", "register 9, TIMEOUT",
         "With a TIMEOUT of 100 ms it is still enabled after 80 ms without a command.",
         _not_early, "moves timed"),
        ("watchdog not late", "register 9, TIMEOUT",
         "With a TIMEOUT of 100 ms it has the error 0xD after 120 ms without a command.",
         _not_late, "moves timed"),
        ("watchdog off", "register 9, TIMEOUT",
         "With a TIMEOUT of 0 it stays enabled without commands.", _off, "moves"),
        ("an error stays", "error codes", "FC does not leave the error 0xD.", _latches, "moves"),
        ("clear error", "clear error (FB)", "FB leaves the error 0xD: status 0.",
         _clears, "moves"),
        ("enabled after an error", "clear error (FB)", "After FB and FC the status is 1.",
         _again, "moves"),
    ),
)  # fmt: skip
DAMIAO = DriveProtocol("damiao", _RULES, _disable, _prepare)
