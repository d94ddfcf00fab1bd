"""Rules for a CiA 402 drive in cyclic synchronous torque mode.

From CiA 301 (network management, heartbeat, emergency) and CiA 402-2 (state machine, control and
status word). The PDOs are mapped as for our profile: RPDO1 has control word, mode and target
torque; TPDO1, sent at each SYNC, begins with the status word.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

from bridge.conform.drives.bench import CameFrame, DriveBench, DriveSilentError, shown
from bridge.conform.drives.kit import DriveProtocol, Outcome, numbered

_START, _STOP, _PRE, _RESET_NODE = 0x01, 0x02, 0x80, 0x81
_BOOT, _STOPPED, _OPERATIONAL, _PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
#: Status words by state: mask, value (CiA 402-2, status word).
_SWITCH_ON_DISABLED, _READY, _SWITCHED_ON, _ENABLED = (
    (0x4F, 0x40), (0x6F, 0x21), (0x6F, 0x23), (0x6F, 0x27),
)  # fmt: skip
_QUICK_STOP, _FAULT = (0x6F, 0x07), (0x4F, 0x08)
#: Control words.
_SHUTDOWN, _SWITCH_ON, _ENABLE, _NO_VOLTAGE, _QUICK, _RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80
_TORQUE_MODE = 10
#: s: a heartbeat comes at least so often; a boot, an answer to SYNC, a transition take so long.
_BEAT, _BOOTS, _ANSWERS, _OBEYS = 1.1, 3.0, 0.02, 0.3
_CYCLE = 0.005


def _nmt(bench: DriveBench, command: int, node: int | None = None) -> None:
    bench.send(0x000, bytes([command, bench.node if node is None else node]))


def _host_beat(bench: DriveBench) -> None:
    bench.send(0x700 + bench.setup.host, bytes([_OPERATIONAL]))


def _is_beat(bench: DriveBench, frame: CameFrame) -> bool:
    return frame.id == 0x700 + bench.node and len(frame.data) == 1


def _cycle(bench: DriveBench, word: int, seconds: float, *, beats: bool = True) -> list[CameFrame]:
    """All frames of a while with a control word, no torque, and a SYNC every 5 ms."""

    def send() -> None:
        if beats:
            _host_beat(bench)
        bench.send(0x200 + bench.node, struct.pack("<Hbh", word, _TORQUE_MODE, 0))
        bench.send(0x080)

    return bench.every(seconds, _CYCLE, send)


def _words(bench: DriveBench, frames: Iterable[CameFrame]) -> list[int]:
    mine = (f for f in frames if f.id == 0x180 + bench.node and len(f.data) >= 2)
    return [int.from_bytes(f.data[:2], "little") for f in mine]


def _word(bench: DriveBench, frames: Iterable[CameFrame]) -> int:
    """The last status word. Raises DriveSilentError without one."""
    if not (words := _words(bench, frames)):
        raise DriveSilentError("no TPDO1 with a status word came")
    return words[-1]


def _is(word: int, state: tuple[int, int]) -> bool:
    mask, value = state
    return word & mask == value


def _go(bench: DriveBench, *words: int) -> int:
    """The status word after control words, each held for a while."""
    word = -1
    for control in words:
        word = _word(bench, _cycle(bench, control, _OBEYS / 3))
    return word


def _reach(bench: DriveBench, state: tuple[int, int], *words: int) -> None:
    """Bring it into a state by control words. Raises DriveSilentError if it does not get there."""
    word = _go(bench, *words)
    if not _is(word, state):
        raise DriveSilentError(f"status word 0x{word:04X} after the control words before")


def _disable(bench: DriveBench) -> None:
    _cycle(bench, _NO_VOLTAGE, 0.05)
    _nmt(bench, _PRE)


def _prepare(bench: DriveBench) -> None:
    """Operational, without voltage and without a fault."""
    _host_beat(bench)
    _nmt(bench, _START)
    _cycle(bench, _NO_VOLTAGE, 0.05)
    _cycle(bench, _RESET, 0.05)
    _cycle(bench, _NO_VOLTAGE, 0.05)


# ---- rules that only listen --------------------------------------------------------------------


def _beats(bench: DriveBench) -> Outcome:
    found, seen = bench.find(lambda f: f.id == 0x700 + bench.node, _BEAT)
    if found is None:
        return False, shown(seen)
    known = (_BOOT, _STOPPED, _OPERATIONAL, _PRE_OPERATIONAL)
    return len(found.data) == 1 and found.data[0] in known, shown([found])


# ---- rules that switch it ----------------------------------------------------------------------


def _boots(bench: DriveBench) -> Outcome:
    _nmt(bench, _RESET_NODE)
    found, seen = bench.find(lambda f: f.id == 0x700 + bench.node and f.data == b"\0", _BOOTS)
    return found is not None, shown([found] if found else seen)


def _after_boot(bench: DriveBench) -> Outcome:
    _nmt(bench, _RESET_NODE)
    bench.find(lambda f: f.id == 0x700 + bench.node and f.data == b"\0", _BOOTS)
    found, _ = bench.find(lambda f: _is_beat(bench, f), _BEAT)
    return found is not None and found.data[0] == _PRE_OPERATIONAL, shown([found] if found else [])


def _network(bench: DriveBench, command: int, state: int) -> Outcome:
    _nmt(bench, command)
    bench.listen(0.02)
    found, _ = bench.find(lambda f: _is_beat(bench, f), _BEAT)
    return found is not None and found.data[0] == state, shown([found] if found else [])


def _starts(bench: DriveBench) -> Outcome:
    return _network(bench, _START, _OPERATIONAL)


def _pre(bench: DriveBench) -> Outcome:
    return _network(bench, _PRE, _PRE_OPERATIONAL)


def _no_pdo(bench: DriveBench) -> Outcome:
    _nmt(bench, _PRE)
    bench.listen(0.05)
    bench.send(0x080)
    found = [f for f in bench.listen(0.05) if f.id in (0x180 + bench.node, 0x280 + bench.node)]
    return not found, shown(found)


def _foreign(bench: DriveBench) -> Outcome:
    _nmt(bench, _PRE)
    bench.listen(0.05)
    _nmt(bench, _START, bench.node % 127 + 1)
    bench.listen(0.02)
    found, _ = bench.find(lambda f: _is_beat(bench, f), _BEAT)
    kept = found is not None and found.data[0] == _PRE_OPERATIONAL
    return kept, shown([found] if found else [])


def _sync(bench: DriveBench) -> Outcome:
    counts = []
    for _ in range(5):
        bench.send(0x080)
        counts.append(len(_words(bench, bench.listen(_ANSWERS))))
    return counts == [1] * 5, f"{', '.join(map(str, counts))} TPDO1 for five SYNC"


def _rests(bench: DriveBench) -> Outcome:
    word = _go(bench, _NO_VOLTAGE)
    return _is(word, _SWITCH_ON_DISABLED), f"status word 0x{word:04X}"


def _skips(bench: DriveBench) -> Outcome:
    word = _go(bench, _ENABLE)
    return not _is(word, _ENABLED) and not _is(word, _SWITCHED_ON), f"status word 0x{word:04X}"


def _step(
    before: tuple[int, ...], word: int, state: tuple[int, int]
) -> Callable[[DriveBench], Outcome]:
    """The check of a transition: control words that lead to it, its own, the state that follows."""

    def check(bench: DriveBench) -> Outcome:
        if before:
            _reach(bench, (_READY, _SWITCHED_ON, _ENABLED)[len(before) - 1], *before)
        told = _go(bench, word)
        return _is(told, state), f"status word 0x{told:04X} after control word 0x{word:X}"

    return check


def _stops(bench: DriveBench) -> Outcome:
    _reach(bench, _ENABLED, _SHUTDOWN, _SWITCH_ON, _ENABLE)
    word = _go(bench, _QUICK)
    kept = _is(word, _QUICK_STOP) or _is(word, _SWITCH_ON_DISABLED)
    return kept, f"status word 0x{word:04X}"


def _unheard(bench: DriveBench) -> list[tuple[float, CameFrame]]:
    """The frames after the last heartbeat of the host: s since it."""
    _reach(bench, _ENABLED, _SHUTDOWN, _SWITCH_ON, _ENABLE)
    _host_beat(bench)
    begin = bench.line.now()
    found = _cycle(bench, _ENABLE, bench.setup.watchdog + 0.2, beats=False)
    return [((f.t_ns - begin) * 1e-9, f) for f in found]


def _left(bench: DriveBench) -> tuple[float, list[CameFrame]]:
    """The time when it was last enabled, s after the host's last heartbeat, and what came."""
    came = _unheard(bench)
    on = [at for at, f in came for word in _words(bench, [f]) if _is(word, _ENABLED)]
    return on[-1] if on else 0.0, [f for _, f in came]


def _not_early(bench: DriveBench) -> Outcome:
    if not bench.setup.watchdog:
        return None, "--watchdog does not tell its time-out"
    at, _ = _left(bench)
    return at > 0.9 * bench.setup.watchdog - _CYCLE, f"enabled for {at * 1e3:.1f} ms"


def _not_late(bench: DriveBench) -> Outcome:
    if not bench.setup.watchdog:
        return None, "--watchdog does not tell its time-out"
    at, _ = _left(bench)
    return at < 1.1 * bench.setup.watchdog + 0.02, f"enabled for {at * 1e3:.1f} ms"


def _lost(bench: DriveBench) -> list[CameFrame]:
    """Let its host fall silent. Raises DriveSilentError if it stays enabled."""
    if not bench.setup.watchdog:
        raise DriveSilentError("--watchdog does not tell its time-out")
    at, came = _left(bench)
    if at > bench.setup.watchdog + 0.15:
        raise DriveSilentError("the drive stayed enabled without heartbeats of its host")
    return came


def _emergency(bench: DriveBench) -> Outcome:
    found = [f for f in _lost(bench) if f.id == 0x080 + bench.node]
    kept = bool(found) and len(found[0].data) == 8 and found[0].data[:2] == b"\x30\x81"
    return kept, shown(found)


def _in_fault(bench: DriveBench) -> int:
    _lost(bench)
    _nmt(bench, _START)
    return _go(bench, _ENABLE)


def _faults(bench: DriveBench) -> Outcome:
    word = _in_fault(bench)
    return _is(word, _FAULT), f"status word 0x{word:04X}"


def _latches(bench: DriveBench) -> Outcome:
    if not _is(word := _in_fault(bench), _FAULT):
        raise DriveSilentError(f"the drive is not in fault: status word 0x{word:04X}")
    word = _go(bench, _SHUTDOWN, _SWITCH_ON, _ENABLE)
    return _is(word, _FAULT), f"status word 0x{word:04X} after 6, 7, F"


def _resets(bench: DriveBench) -> Outcome:
    if not _is(word := _in_fault(bench), _FAULT):
        raise DriveSilentError(f"the drive is not in fault: status word 0x{word:04X}")
    word = _go(bench, _NO_VOLTAGE, _RESET, _NO_VOLTAGE)
    return _is(word, _SWITCH_ON_DISABLED), f"status word 0x{word:04X}"


def _short(bench: DriveBench) -> Outcome:
    _reach(bench, _READY, _SHUTDOWN)
    _host_beat(bench)
    bench.send(0x200 + bench.node, struct.pack("<H", _SWITCH_ON))
    bench.listen(0.02)
    bench.send(0x080)
    word = _word(bench, bench.listen(_ANSWERS))
    return not _is(word, _SWITCHED_ON), f"status word 0x{word:04X} after two bytes of RPDO1"


_UP = (_SHUTDOWN, _SWITCH_ON, _ENABLE)
_MACHINE, _STATUS = "CiA 402-2, state machine, transition", "CiA 402-2, status word (6041h)"
_RULES = numbered(
    "K",
    "CANopen",
    (
        ("heartbeat", "CiA 301, heartbeat (1017h)",
         "A heartbeat of one byte with a known state comes within 1.1 s.", _beats, ""),
        ("boot-up", "CiA 301, boot-up", "After a reset by NMT it sends 0x700 + n with 00.",
         _boots, "moves"),
        ("pre-operational", "CiA 301, NMT state machine",
         "After its boot-up it is pre-operational, 7F.", _after_boot, "moves"),
        ("start", "CiA 301, NMT start (01)", "After NMT start it is operational, 05.",
         _starts, "moves"),
        ("enter pre-operational", "CiA 301, NMT (80)", "After NMT 80 it is pre-operational.",
         _pre, "moves"),
        ("no PDO before the start", "CiA 301, NMT state machine",
         "Pre-operational, it answers no SYNC.", _no_pdo, "moves"),
        ("not for others", "CiA 301, NMT", "NMT for another node does not start it.",
         _foreign, "moves"),
        ("SYNC", "CiA 301, SYNC, transmission type 1",
         "Operational, it answers each SYNC by one TPDO1 within 20 ms.", _sync, "moves"),
        ("switch on disabled", _STATUS,
         "With control word 0 the status word is x1xx 0000.", _rests, "moves"),
        ("no transition is skipped", "CiA 402-2, state machine",
         "Control word F does not enable a drive that is not ready.", _skips, "moves"),
        ("ready to switch on", f"{_MACHINE} 2", "Control word 6 leads to x01x 0001.",
         _step((), _SHUTDOWN, _READY), "moves"),
        ("switched on", f"{_MACHINE} 3", "Control word 7 leads to x01x 0011.",
         _step(_UP[:1], _SWITCH_ON, _SWITCHED_ON), "moves"),
        ("operation enabled", f"{_MACHINE} 4", "Control word F leads to x01x 0111.",
         _step(_UP[:2], _ENABLE, _ENABLED), "moves"),
        ("operation disabled", f"{_MACHINE} 5",
         "Control word 7 leads from operation enabled to switched on.",
         _step(_UP, _SWITCH_ON, _SWITCHED_ON), "moves"),
        ("shutdown", f"{_MACHINE} 8", "Control word 6 leads from operation enabled to ready.",
         _step(_UP, _SHUTDOWN, _READY), "moves"),
        ("no voltage", f"{_MACHINE} 9",
         "Control word 0 leads from operation enabled to switch on disabled.",
         _step(_UP, _NO_VOLTAGE, _SWITCH_ON_DISABLED), "moves"),
        ("quick stop", f"{_MACHINE} 11",
         "Control word 2 leads from operation enabled to quick stop, and off.", _stops, "moves"),
        ("a short RPDO", "CiA 301, PDO length", "An RPDO1 of two bytes changes no state.",
         _short, "moves"),
        ("watchdog not early", "CiA 301, consumer heartbeat time (1016h)",
         "It stays enabled for 90 % of the time after the host's last heartbeat.",
         _not_early, "moves timed"),
        ("watchdog not late", "CiA 301, consumer heartbeat time (1016h)",
         "It is not enabled any more after 110 % of the time and 20 ms.",
         _not_late, "moves timed"),
        ("emergency", "CiA 301, emergency (8130h)",
         "A lost heartbeat is told by an emergency 8130h of eight bytes.", _emergency, "moves"),
        ("fault", f"{_MACHINE} 13", "After a lost heartbeat the status word is x0xx 1000.",
         _faults, "moves"),
        ("a fault stays", "CiA 402-2, state machine", "Control words 6, 7, F do not leave a fault.",
         _latches, "moves"),
        ("fault reset", f"{_MACHINE} 15",
         "A rising edge of bit 7 leads from fault to switch on disabled.", _resets, "moves"),
    ),
)  # fmt: skip
CIA402 = DriveProtocol("cia402", _RULES, _disable, _prepare)
