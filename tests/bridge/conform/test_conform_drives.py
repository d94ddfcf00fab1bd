"""The kit of drives: ours and strict ones pass, each mutant of a strict one breaks its rule."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

import pytest

from bridge.conform.drives.bench import DriveBench, DriveSetup
from bridge.conform.drives.cia402 import CIA402
from bridge.conform.drives.damiao import DAMIAO
from bridge.conform.drives.kit import DriveKit, DriveProtocol
from bridge.conform.drives.lines import EmulatedDriveLine, JudgedLine
from bridge.conform.drives.odrive import ODRIVE
from bridge.conform.rules import Conformity, ConformityReport
from bridge.native.frame import Frame
from bridge.native.vendor import VendorKind
from tests.bridge.conform.strict_line import StrictLine, nothing
from tests.strict_drives import cia402, damiao, odrive
from tests.strict_drives.core import EventLog, Joint, Setup, StrictDrive

N, WATCHDOG = 3, 0.1
PROTOCOLS = {protocol.name: protocol for protocol in (DAMIAO, ODRIVE, CIA402)}
STRICT: dict[str, Callable[[int, Setup, Joint, EventLog], StrictDrive]] = {
    "damiao": damiao.Damiao, "odrive": odrive.ODrive, "cia402": cia402.Cia402,
}  # fmt: skip
RULES = [(name, rule.rule.number) for name, p in PROTOCOLS.items() for rule in p.rules]


def strict(name: str) -> StrictDrive:
    setup = Setup(timeout=WATCHDOG, enable=0.004, answer=0.0004, jitter=0.0003, host=1)
    return STRICT[name](N, setup, Joint(), EventLog(nothing()))


def judge(
    protocol: DriveProtocol, line: JudgedLine, rules: str = "", *, may_move: bool = True
) -> ConformityReport:
    bench = DriveBench(line, DriveSetup(N, WATCHDOG))
    kit = DriveKit(protocol, bench, may_move=may_move)
    return kit.judge(protocol.book.selected(rules), lambda _: None)


def verdicts(report: ConformityReport) -> dict[str, str]:
    return {j.rule.number: f"{j.verdict}: {j.came}" for j in report.judged
            if j.verdict is not Conformity.PASSED}  # fmt: skip


@pytest.mark.parametrize("name", PROTOCOLS)
def test_our_emulated_drive_keeps_every_rule(name: str) -> None:
    line = EmulatedDriveLine(VendorKind[name.upper()], N, WATCHDOG)
    assert verdicts(judge(PROTOCOLS[name], line)) == {}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_strict_drive_keeps_every_rule(name: str) -> None:
    assert verdicts(judge(PROTOCOLS[name], StrictLine(strict(name)))) == {}


class Recorded:
    """A line with the frames that were sent."""

    def __init__(self, line: JudgedLine) -> None:
        self.line, self.sent, self.late_ns = line, list[Frame](), 0
        self.now, self.receive, self.close = line.now, line.receive, line.close

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)
        self.line.send(frame)


#: Requests that change nothing: reads of registers, remote frames.
READS = {
    "damiao": lambda f: f.id == 0x7FF and f.payload[2] in (0x33, 0xCC),
    "odrive": lambda f: bool(f.flags & 4) or f.length == 0,
    "cia402": lambda f: False,
}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_without_may_move_a_drive_is_only_read(name: str) -> None:
    line = Recorded(StrictLine(strict(name)))
    report = judge(PROTOCOLS[name], line, may_move=False)
    assert [f.id for f in line.sent if not READS[name](f)] == []
    assert report.verdict is Conformity.PASSED
    moving = {rule.rule.number for rule in PROTOCOLS[name].rules if rule.moves}
    skipped = {j.rule.number for j in report.judged if j.verdict is Conformity.NOT_APPLICABLE}
    assert moving == skipped
    assert all("--may-move" in j.came for j in report.judged if j.rule.number in moving)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_drive_is_disabled_at_the_end_also_of_a_kit_that_fails(name: str) -> None:
    drive = strict(name)

    def fail(_: object) -> None:
        raise KeyboardInterrupt

    bench = DriveBench(StrictLine(drive), DriveSetup(N, WATCHDOG))
    enabling = {"damiao": "D-13", "odrive": "O-11", "cia402": "K-13"}[name]
    kit = DriveKit(PROTOCOLS[name], bench, may_move=True)
    with pytest.raises(KeyboardInterrupt):
        kit.judge(PROTOCOLS[name].book.selected(enabling), fail)
    assert drive.counts["enabled"] == 1
    assert not drive.enabled


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_torque_never_goes_to_a_drive(name: str) -> None:
    """Commands of the kit ask for no torque, also from drives that are enabled."""
    drive = strict(name)
    judge(PROTOCOLS[name], StrictLine(drive))
    assert drive.counts["enabled"] > 3
    assert (drive.counts["torques"], drive.counts["off"]) == (0, 0)


def test_a_silent_drive_is_told_so() -> None:
    drive = strict("damiao")
    drive.silent_until = float("inf")
    report = judge(DAMIAO, StrictLine(drive))
    by = {j.rule.number: j for j in report.judged}
    assert by["D-02"].verdict is Conformity.FAILED
    assert by["D-16"].verdict is Conformity.INCONCLUSIVE
    assert "not answered" in by["D-16"].came
    assert report.exit_code == 1


def test_a_late_kit_does_not_judge_times() -> None:
    line = StrictLine(strict("damiao"))
    line.drive.setup.timeout = 0.0
    line.drive.expired = lambda now: None  # type: ignore[method-assign]

    class Slow(Recorded):
        @property
        def late_ns(self) -> int:
            return 50_000_000

        @late_ns.setter
        def late_ns(self, _: int) -> None:
            pass

    report = judge(DAMIAO, Slow(line), "D-17")
    assert report.judged[0].verdict is Conformity.INCONCLUSIVE
    assert judge(DAMIAO, line, "D-17").judged[0].verdict is Conformity.FAILED


# ---- mutants -----------------------------------------------------------------------------------


def _method(drive: StrictDrive, name: str, function: Callable[..., object]) -> None:
    """Replace a method by a function of the drive, the old method and the arguments."""
    setattr(drive, name, partial(function, drive, getattr(drive, name)))


def _unasked(d: StrictDrive, old: Callable[..., object], now: float) -> None:
    old(now)
    d._answer(now)  # type: ignore[attr-defined]


def _scaled(factor: float) -> Callable[[StrictDrive], None]:
    """Its watchdog counts another unit of time."""

    def mutate(drive: StrictDrive) -> None:
        for name in ("fed", "starving"):
            _method(drive, name, lambda d, old, now, timeout: old(now, timeout * factor))

    return mutate


def _heeded(d: StrictDrive, old: Callable[..., object], m: object, now: float) -> None:
    """A request for another drive is taken as its own."""
    if m.arbitration_id == 0x7FF:  # type: ignore[attr-defined]
        m.data[0] = N  # type: ignore[attr-defined]
    old(m, now)


def _enabled_by_torque(d: StrictDrive, old: Callable[..., object], *a: object) -> None:
    d._be(damiao.ENABLED, a[-1], "by torque")  # type: ignore[attr-defined]
    old(*a)


def _from_error(d: StrictDrive, old: Callable[..., object], what: int, now: float) -> None:
    if what == 0xFC:
        d.nibble = damiao.DISABLED  # type: ignore[attr-defined]
    old(what, now)


def _without(what: int) -> Callable[..., None]:
    def special(d: StrictDrive, old: Callable[..., object], asked: int, now: float) -> None:
        if asked != what:
            old(asked, now)

    return special


def _replaced(name: str, function: Callable[..., object]) -> Callable[[StrictDrive], None]:
    return lambda drive: _method(drive, name, function)


def _set(name: str, value: object) -> Callable[[StrictDrive], None]:
    return lambda drive: setattr(drive, name, value)


def _register(number: int, value: int) -> Callable[[StrictDrive], None]:
    return lambda drive: drive.registers.update({number: value})  # type: ignore[attr-defined]


def _twice(d: StrictDrive, old: Callable[..., object], now: float) -> None:
    old(now)
    old(now)


def _no_write(d: StrictDrive, old: Callable[..., object], data: bytes, now: float) -> None:
    old(bytes([*data[:2], 0x33, *data[3:]]) if data[2] == 0x55 else data, now)


def _skip(condition: Callable[..., bool]) -> Callable[..., None]:
    """A call of the old method unless a condition of its arguments holds."""

    def call(d: StrictDrive, old: Callable[..., object], *a: object) -> None:
        if not condition(*a):
            old(*a)

    return call


def _other_ids(d: StrictDrive, old: Callable[..., object], m: object, now: float) -> None:
    m.arbitration_id = N << 5 | m.arbitration_id & 31  # type: ignore[attr-defined]
    old(m, now)


def _odrive_invalid(d: StrictDrive, old: Callable[..., object], wanted: int, now: float) -> None:
    old(odrive.CLOSED_LOOP if wanted == 77 else wanted, now)


def _odrive_closes(d: StrictDrive, old: Callable[..., object], tau: float, now: float) -> None:
    if not d.enabled:
        d._close(now)  # type: ignore[attr-defined]
    old(tau, now)


def _odrive_forgives(d: StrictDrive, old: Callable[..., object], wanted: int, now: float) -> None:
    d.errors = 0  # type: ignore[attr-defined]
    old(wanted, now)


def _no_error(d: StrictDrive, old: Callable[..., object], *a: object) -> None:
    old(*a)
    d.errors = 0  # type: ignore[attr-defined]


def _beats_sometimes(d: StrictDrive, old: Callable[..., object], now: float) -> None:
    d.beats_count = getattr(d, "beats_count", 0) + 1  # type: ignore[attr-defined]
    if d.beats_count % 5 not in (3, 4, 0):  # type: ignore[attr-defined]
        old(now)


def _tells(errors: int) -> Callable[..., None]:
    def beat(d: StrictDrive, old: Callable[..., object], now: float) -> None:
        kept, d.errors = d.errors, errors  # type: ignore[attr-defined]
        old(now)
        d.errors = kept  # type: ignore[attr-defined]

    return beat


def _silent(identifier: int, first: int | None = None) -> Callable[[StrictDrive], None]:
    """It does not send an identifier; or only not with this first byte."""
    return _replaced(
        "send",
        lambda d, old, now, i, data, **more: (
            None if i == identifier and first in (None, data[0]) else old(now, i, data, **more)
        ),
    )


def _says(identifier: int, change: Callable[[bytes], bytes]) -> Callable[[StrictDrive], None]:
    def mutate(drive: StrictDrive) -> None:
        old = drive.send
        drive.send = lambda now, i, data, tells=True: old(  # type: ignore[method-assign]
            now, i, change(data) if i == identifier else data, tells=tells
        )

    return mutate


def _sync_always(d: StrictDrive, old: Callable[..., object], now: float) -> None:
    kept, d.nmt = d.nmt, cia402.OPERATIONAL  # type: ignore[attr-defined]
    old(now)
    d.nmt = kept  # type: ignore[attr-defined]


def _all_nodes(d: StrictDrive, old: Callable[..., object], m: object, now: float) -> None:
    if m.arbitration_id == 0:  # type: ignore[attr-defined]
        m.data[1] = N  # type: ignore[attr-defined]
    old(m, now)


def _next(change: Callable[..., str | None]) -> Callable[[StrictDrive], None]:
    """Another transition where `change` (state, word, edge) gives one."""

    def mutate(drive: StrictDrive) -> None:
        old = drive._next  # type: ignore[attr-defined]
        drive._next = lambda edge, now: (  # type: ignore[attr-defined]
            change(drive.state, drive.word & 0x8F, edge) or old(edge, now)  # type: ignore[attr-defined]
        )

    return mutate


def _long(d: StrictDrive, old: Callable[..., object], data: bytes, now: float) -> None:
    old(data.ljust(5, b"\0") if len(data) < 5 else data, now)


def _boots_running(d: StrictDrive, old: Callable[..., object], now: float) -> None:
    old(now)
    d.nmt = cia402.OPERATIONAL  # type: ignore[attr-defined]


def _word(before: int, after: int) -> Callable[[StrictDrive], None]:
    """A bit of the status word that is another one."""
    return _says(
        0x180 + N,
        lambda data: (
            struct.pack("<H", int.from_bytes(data[:2], "little") & ~before | after) + data[2:]
        ),
    )


OFF, READY, ON, ENABLED, FAULT = (
    cia402.OFF, cia402.READY, cia402.ON, cia402.ENABLED, cia402.FAULT,
)  # fmt: skip
MUTANTS: dict[str, tuple[str, Callable[[StrictDrive], None]]] = {
    "it talks unasked": ("D-01", _replaced("tick", _unasked)),
    "it answers no register": ("D-02", _replaced("_register", lambda *_: None)),
    "it is in another mode": ("D-03", _register(10, 2)),
    "its master number is another": ("D-04", _register(7, 0x44)),
    "its range is zero": ("D-05", _set("told_ranges", {22: bytes(4)})),
    "it says a rate of FD": ("D-06", _register(35, 9)),
    "it answers for others": ("D-07", _replaced("receive", _heeded)),
    "it answers twice": ("D-09", _replaced("_answer", _twice)),
    "it has another number": ("D-10", _set("told_number", N + 1)),
    "it says it is enabled": ("D-11", _says(0x10 + N, lambda d: bytes([d[0] & 15 | 16]) + d[1:])),
    "torque enables it": ("D-12", _replaced("_torque", _enabled_by_torque)),
    "it does not enable": ("D-13", _set("refuses", True)),
    "it ignores disable": ("D-14", _replaced("_special", _without(0xFD))),
    "it keeps no TIMEOUT": ("D-15", _replaced("_register", _no_write)),
    "its unit is 25 us": ("D-16", _scaled(0.5)),
    "its unit is 100 us": ("D-17", _scaled(2.0)),
    "TIMEOUT 0 is 0.2 s": (
        "D-18",
        lambda d: [
            _method(d, n, lambda d, old, now, t: old(now, t or 0.2)) for n in ("fed", "starving")
        ],
    ),
    "enable leaves an error": ("D-19", _replaced("_special", _from_error)),
    "clear does nothing": ("D-20", _replaced("_special", _without(0xFB))),
    "it has no heartbeat": ("O-01", _replaced("_beat", lambda *_: None)),
    "its heartbeat limps": ("O-02", _replaced("_beat", _beats_sometimes)),
    "its state is no state": ("O-03", _says(N << 5 | 1, lambda d: d[:4] + b"\x30" + d[5:])),
    "its position is no number": ("O-04", _says(N << 5 | 9, lambda d: b"\xff" * 8)),
    "it has no version": ("O-05", _silent(N << 5)),
    "its errors differ": ("O-06", _replaced("_beat", _tells(64))),
    "it hears all nodes": ("O-07", _replaced("receive", _other_ids)),
    "set-points enable it": ("O-10", _replaced("_torque", _odrive_closes)),
    "no closed loop": ("O-11", _set("refuses", True)),
    "77 is closed loop": ("O-12", _replaced("_state", _odrive_invalid)),
    "idle is ignored": ("O-14", _replaced("_state", _skip(lambda wanted, _: wanted == 1))),
    "its watchdog is early": ("O-15", _scaled(0.5)),
    "its watchdog is late": ("O-16", _scaled(2.5)),
    "its watchdog says nothing": ("O-17", _replaced("trip", _no_error)),
    "closed loop forgives": ("O-18", _replaced("_state", _odrive_forgives)),
    "it forgets no error": (
        "O-19",
        _replaced("receive", _skip(lambda m, _: m.arbitration_id & 31 == 0x18)),
    ),
    "it does not stop": (
        "O-21",
        _replaced("receive", _skip(lambda m, _: m.arbitration_id & 31 == 2)),
    ),
    "no CANopen heartbeat": ("K-01", _silent(0x700 + N)),
    "no boot-up": ("K-02", _silent(0x700 + N, 0)),
    "it boots into operational": ("K-03", _replaced("reboot", _boots_running)),
    "start is ignored": ("K-04", _replaced("_network", _skip(lambda command, _: command == 1))),
    "pre-operational is ignored": (
        "K-05",
        _replaced("_network", _skip(lambda command, _: command == 0x80)),
    ),
    "PDOs before the start": ("K-06", _replaced("_sync", _sync_always)),
    "NMT of others": ("K-07", _replaced("receive", _all_nodes)),
    "two TPDO1": ("K-08", _replaced("_sync", _twice)),
    "bit 6 is missing": ("K-09", _word(0x40, 0)),
    "it skips states": (
        "K-10",
        _next(lambda s, w, _: ENABLED if s == OFF and w == 15 else None),
    ),
    "6 is ignored": ("K-11", _next(lambda s, w, _: OFF if s == OFF and w == 6 else None)),
    "7 is ignored": ("K-12", _next(lambda s, w, _: READY if s == READY and w == 7 else None)),
    "F is ignored": ("K-13", _set("refuses", True)),
    "7 does not disable": ("K-14", _next(lambda s, w, _: s if s == ENABLED and w == 7 else None)),
    "6 does not shut down": ("K-15", _next(lambda s, w, _: s if s == ENABLED and w == 6 else None)),
    "0 does not switch off": (
        "K-16",
        _next(lambda s, w, _: s if s == ENABLED and w == 0 else None),
    ),
    "no quick stop": ("K-17", _next(lambda s, w, _: s if s == ENABLED and w == 2 else None)),
    "a short RPDO counts": ("K-18", _replaced("_command", _long)),
    "heartbeats are missed early": ("K-19", _scaled(0.5)),
    "heartbeats are missed late": ("K-20", _scaled(2.0)),
    "no emergency": ("K-21", _replaced("_emergency", lambda *_: None)),
    "a fault looks like ready": (
        "K-22",
        _says(0x180 + N, lambda d: (b"\x31\x02" if d[0] & 0x4F == 8 else d[:2]) + d[2:]),
    ),
    "6 leaves a fault": ("K-23", _next(lambda s, w, _: READY if s == FAULT and w == 6 else None)),
    "no reset of faults": ("K-24", _next(lambda s, w, _: FAULT if s == FAULT else None)),
}
NAMES = {"D": "damiao", "O": "odrive", "K": "cia402"}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_a_mutant_breaks_the_rule_that_names_it(mutant: str) -> None:
    number, mutate = MUTANTS[mutant]
    name = NAMES[number[0]]
    drive = strict(name)
    mutate(drive)
    report = judge(PROTOCOLS[name], StrictLine(drive), number)
    assert report.judged[0].verdict is Conformity.FAILED, verdicts(report) or "passed"


def test_every_rule_has_a_mutant() -> None:
    """Excepted: what another rule's mutant breaks as well."""
    also = {"D-08", "D-21", "O-08", "O-09", "O-13", "O-20"}
    assert {number for _, number in RULES} - {number for number, _ in MUTANTS.values()} == also
