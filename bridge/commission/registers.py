"""Firmware and settings of drives, read back and compared with profile and deployment.

Nothing is written. A setting that a protocol cannot tell is named as not checked.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial

from bridge.commission.drive_line import DriveLine
from bridge.commission.interfaces import StepFinding
from bridge.commission.line_drives import LineDrive
from bridge.commission.objects import cia402_objects
from bridge.commission.settings import Setting, compared
from bridge.drives.raw_frames import Raw
from bridge.native.frame import Flags, Frame
from bridge.wiring.motors import damiao_ranges


def registers(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    """The firmware of a drive, and its settings next to those expected."""
    vendor = drive.foreign.profile.vendor
    read = {"damiao": _damiao, "odrive": _odrive, "cia402": cia402_objects}.get(vendor)
    if read is None:
        timeout = drive.foreign.profile.timeout
        text = f"not checked: its profile has no vendor; expected a watchdog of {timeout:g} s"
        yield StepFinding(f"{drive.name}: settings", "limited", text, "use the vendor's tool")
        return
    yield from read(line, drive)


# ---- Damiao -------------------------------------------------------------------------------------

_VERSIONS = {13: "hardware", 14: "firmware", 15: "serial number"}
_WHOLE = {7: "MST_ID", 8: "ESC_ID", 10: "CTRL_MODE", 35: "can_br"}
_RANGES = {21: ("PMAX", "p_max"), 22: ("VMAX", "v_max"), 23: ("TMAX", "t_max")}
#: can_br by bit rate, bit/s; rates above 1 Mbit/s are those of the data of CAN FD.
_RATES = {125_000: 0, 200_000: 1, 250_000: 2, 500_000: 3, 1_000_000: 4, 2_000_000: 5,
          2_500_000: 6, 3_200_000: 7, 4_000_000: 8, 5_000_000: 9, 8_000_000: 10,
          10_000_000: 11}  # fmt: skip
_MIT = 1


def _damiao(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    read = {number: _register(line, drive, number) for number in (*_VERSIONS, *_WHOLE, *_RANGES)}
    told = [f"{_VERSIONS[n]} {read[n]}" for n in _VERSIONS if read[n] is not None]
    name = f"{drive.name}: firmware"
    if not told:
        yield StepFinding(name, "limited", "not checked: registers 13 to 15 gave no answer")
    else:
        yield StepFinding(name, "good", ", ".join(told))
    profile, node = drive.foreign.profile, drive.foreign.node
    spec = line.deployment.buses[drive.foreign.bus]
    fd = Flags.FD in profile.format
    answers = profile.layout(profile.feedback[0], node).identifier
    rate = _RATES.get(spec.data_bitrate if fd else spec.bitrate)
    expected: dict[int, object] = {7: answers, 8: node, 10: _MIT, 35: rate}
    settings = [Setting(f"{_WHOLE[n]} ({n})", read[n], expected[n]) for n in _WHOLE]
    ranges = damiao_ranges(profile)
    for number, (label, key) in _RANGES.items():
        value = read[number]
        real = None if value is None else _real(value)
        settings.append(Setting(f"{label} ({number})", real, ranges[key]))
    cure = "write them with the vendor's tool, or take the profile of this motor"
    yield compared(drive, settings, cure)


def _register(line: DriveLine, drive: LineDrive, number: int) -> int | None:
    """The 32 bits of a register; None: no answer."""
    node = drive.foreign.node
    asked = Raw(0x7FF, f"NN 00 33 {number:02X} 00 00 00 00")
    reply = Raw(0x010, f"NN 00 33 {number:02X} U4", step=1)
    frame = drive.foreign.frame(*asked.at(node))
    return line.ask(drive, frame, lambda f: reply.value(node, f.id, f.payload))


def _real(value: int) -> float:
    return float(struct.unpack("<f", value.to_bytes(4, "little"))[0])


# ---- ODrive -------------------------------------------------------------------------------------

_VERSION = 0x00


def _odrive(line: DriveLine, drive: LineDrive) -> Iterator[StepFinding]:
    identifier = drive.foreign.node << 5 | _VERSION
    asked = Frame.of(identifier, b"", Flags.REMOTE)
    data = line.ask(drive, asked, partial(_payload, identifier))
    name = f"{drive.name}: firmware"
    if data is None:
        text = "not checked: no answer to Get_Version"
        yield StepFinding(name, "limited", text, "read it with odrivetool")
    else:
        hardware, firmware = (".".join(map(str, data[a : a + 3])) for a in (1, 4))
        text = f"hardware {hardware}, firmware {firmware}, protocol {data[0]}"
        yield StepFinding(name, "good", text)
    yield StepFinding(
        f"{drive.name}: settings",
        "limited",
        "not checked: the numbers of its settings depend on the firmware",
        "odrivetool: axis0.config.watchdog_timeout, enable_watchdog, torque_soft_max, "
        "can.heartbeat_msg_rate_ms",
    )


def _payload(identifier: int, frame: Frame) -> bytes | None:
    """The eight bytes of a data frame with this identifier."""
    fits = frame.id == identifier and not frame.flags & Flags.REMOTE and frame.length == 8
    return frame.payload if fits else None
