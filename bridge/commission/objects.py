"""Objects of CiA 402 drives, read over SDO and compared with profile and deployment.

Uploads are those of CiA 301: up to four bytes in one answer, longer objects in segments of seven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import final

from bridge.commission.drive_line import DriveLine
from bridge.commission.interfaces import StepFinding
from bridge.commission.line_drives import LineDrive
from bridge.commission.settings import Setting, compared
from bridge.drives.cia402 import (
    CONSUMER_HEARTBEAT,
    PDOS,
    RATED_TORQUE,
    TORQUE_MODE,
    transmission,
)
from bridge.native.frame import Flags, Frame
from cosim.base.errors import CosimError

_REQUEST, _ANSWER = 0x600, 0x580
_UPLOAD, _SEGMENT, _ABORTED = 2, 0, 4  # command specifiers, bits 5 to 7
_TOGGLE = 0x10
_LONGEST = 100  # segments of a text
#: s for an answer.
WITHIN = 0.5
DEVICE_TYPE, IDENTITY, MODE_DISPLAY = 0x1000, 0x1018, 0x6061
MAX_TORQUE, PERIOD = 0x6072, 0x60C2
_NAMES = {0x1008: "name", 0x1009: "hardware", 0x100A: "firmware"}
_PROFILE = 402


class SdoError(CosimError, RuntimeError):
    """An object cannot be read: the drive aborts, or does not answer."""


@final
class SdoReader:
    """The objects of one drive, over its bus."""

    def __init__(self, line: DriveLine, drive: LineDrive) -> None:
        self._line, self._drive = line, drive

    def upload(self, index: int, sub: int = 0) -> bytes:
        """Read an object. Raises SdoError."""
        where = f"object {index:#06x}:{sub}"
        data = self._answer(bytes([0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0]), where)
        if data[0] & 2:  # expedited
            unused = data[0] >> 2 & 3 if data[0] & 1 else 0
            return data[4 : 8 - unused]
        found, toggle = b"", 0
        for _ in range(_LONGEST):
            segment = self._answer(bytes([0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]), where)
            if segment[0] >> 5 != _SEGMENT or segment[0] & _TOGGLE != toggle:
                raise SdoError(f"{where}: found segment {segment.hex(' ')}, expected the next one")
            found += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle ^= _TOGGLE
            if segment[0] & 1:
                return found
        raise SdoError(f"{where}: more than {7 * _LONGEST} bytes")

    def number(self, index: int, sub: int = 0) -> int:
        """An object as a number without sign. Raises SdoError."""
        return int.from_bytes(self.upload(index, sub), "little")

    def _answer(self, request: bytes, where: str) -> bytes:
        node = self._drive.foreign.node

        def read(frame: Frame) -> bytes | None:
            other = Flags.REMOTE | Flags.EXTENDED | Flags.ERROR
            fits = frame.id == _ANSWER + node and not frame.flags & other and frame.length == 8
            return frame.payload if fits else None

        data = self._line.ask(self._drive, Frame.of(_REQUEST + node, request), read, WITHIN)
        if data is None:
            raise SdoError(f"{where}: no answer within {WITHIN:g} s")
        if data[0] >> 5 == _ABORTED:
            code = int.from_bytes(data[4:8], "little")
            raise SdoError(f"{where}: the drive aborts with {code:#010x}")
        return data


def cia402_objects(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    """Identity and settings of a drive, from its object dictionary."""
    sdo, name = SdoReader(line, drive), f"{drive.name}: firmware"
    try:
        kind = sdo.number(DEVICE_TYPE)
    except SdoError as error:
        text, cure = f"not checked: {error}", "read its objects with the vendor's tool"
        yield StepFinding(name, "limited", text, cure)
        yield StepFinding(f"{drive.name}: settings", "limited", "not checked: no SDO", cure)
        return
    if kind & 0xFFFF != _PROFILE:
        text = f"device type (0x1000) {kind:#x} has profile {kind & 0xFFFF}, expected {_PROFILE}"
        yield StepFinding(name, "missing", text, "take the profile of this drive")
        return
    yield StepFinding(name, "good", _identity(sdo, kind))
    yield from _settings(sdo, line, drive)


def _identity(sdo: SdoReader, kind: int) -> str:
    said = [f"device type {kind:#x}"]
    for index, label in _NAMES.items():
        try:
            text = sdo.upload(index).split(b"\0")[0].decode("ascii", "replace")
            said.append(f"{label} {text}")
        except SdoError:
            continue  # an optional object
    for sub, label in enumerate(("vendor", "product", "revision", "serial number"), 1):
        try:
            said.append(f"{label} {sdo.number(IDENTITY, sub):#x}")
        except SdoError:
            continue
    return ", ".join(said)


def _settings(sdo: SdoReader, line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    """Settings that agree or not, then those that the drive does not have."""
    profile, host = drive.foreign.profile, line.deployment.nodes[drive.host].number
    timeout = profile.watchdog.raw(profile.timeout)
    found: list[Setting] = []
    absent: list[str] = []

    def add(name: str, read: Callable[[], str], expected: str) -> None:
        try:
            found.append(Setting(name, read(), expected))
        except SdoError as error:
            absent.append(str(error))

    add("heartbeat of the host (0x1016:1)", lambda: _heartbeat(sdo), f"node {host}, {timeout} ms")
    add("mode (0x6061)", lambda: str(sdo.number(MODE_DISPLAY)), str(TORQUE_MODE))
    rated = round(profile.rated_torque * 1e3)
    add("rated torque (0x6076)", lambda: f"{sdo.number(RATED_TORQUE)} mN.m", f"{rated} mN.m")
    for communication, mapping, cob_id, objects in PDOS:
        mapped = [index << 16 | bits for index, bits in objects]
        wanted = _pdo_text(cob_id + drive.foreign.node, transmission(communication), mapped)
        read = partial(_pdo, sdo, communication, mapping)
        add(f"PDO {communication:#x}", read, wanted)
    yield compared(drive, found, "configure in bridge/drives/cia402.py writes them")
    yield _torque_limit(sdo, drive)
    yield from _period(sdo, drive)
    if absent:
        text = f"not checked: {'; '.join(absent)}"
        yield StepFinding(f"{drive.name}: objects", "limited", text, "use the vendor's tool")


def _heartbeat(sdo: SdoReader) -> str:
    value = sdo.number(CONSUMER_HEARTBEAT, 1)
    return f"node {value >> 16 & 0x7F}, {value & 0xFFFF} ms"


def _pdo(sdo: SdoReader, communication: int, mapping: int) -> str:
    mapped = [sdo.number(mapping, sub) for sub in range(1, sdo.number(mapping) + 1)]
    return _pdo_text(sdo.number(communication, 1), sdo.number(communication, 2), mapped)


def _pdo_text(cob_id: int, kind: int, mapped: Sequence[int]) -> str:
    return f"{cob_id:#x} of type {kind:#x} with {' '.join(f'{x:08X}' for x in mapped)}"


def _period(sdo: SdoReader, drive: LineDrive) -> Iterator[StepFinding]:
    """The period that the drive expects of SYNC, where it has one."""
    try:
        value, power = sdo.number(PERIOD, 1), sdo.number(PERIOD, 2)
    except SdoError:
        return  # an optional object
    power -= 256 if power > 127 else 0
    text = f"not checked: expects SYNC every {value * 10.0**power * 1e3:g} ms (0x60C2)"
    cure = "that has to be the period of its torque messages"
    yield StepFinding(f"{drive.name}: period", "limited", text, cure)


def _torque_limit(sdo: SdoReader, drive: LineDrive) -> StepFinding:
    """The drive's own limit of the torque, in 1/1000 of the rated one."""
    name, profile = f"{drive.name}: torque limit", drive.foreign.profile
    most = profile.limits.get("tau_max")
    try:
        limit = sdo.number(MAX_TORQUE) * 1e-3 * profile.rated_torque
    except SdoError as error:
        return StepFinding(name, "limited", f"not checked: {error}", "use the vendor's tool")
    if most is None:
        text = f"{limit:g} N.m (0x6072); the profile has no tau_max"
        return StepFinding(name, "limited", f"not checked: {text}", "limits.tau_max in the profile")
    text = f"{limit:g} N.m (0x6072), the profile has {most:g} N.m"
    if limit > most * (1 + 1e-6):
        cure = f"write {round(most / profile.rated_torque * 1e3)} to 0x6072"
        return StepFinding(name, "missing", f"{text} at most", cure)
    return StepFinding(name, "good", text)
