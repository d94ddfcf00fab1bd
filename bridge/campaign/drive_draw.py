"""A fault of a drive, drawn from a random generator: which drive, what it does, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bridge.deployment.drive_sequences import commanded_drives, own_torques
from bridge.deployment.system import System

#: Error codes with which drives of a vendor trip: the nibble of a Damiao drive, bits of an ODrive's
#: axis error, error codes of CiA 402 in its order of classes (current, voltage, temperature, ...).
CODES: Mapping[str, Sequence[int]] = {
    "damiao": (0x5, 0x6, 0x8, 0x9, 0xA, 0xB, 0xC, 0xD, 0xE),
    "odrive": tuple(1 << bit for bit in (0, 1, 2, 3, 4, 5, 6, *range(8, 17), 24, 25, 26, 27, 30)),
    "cia402": (
        *(0x2130, 0x2220, 0x2310, 0x2320, 0x3110, 0x3120, 0x3210, 0x3220, 0x4110, 0x4210, 0x4310),
        *(0x5113, 0x5441, 0x6010, 0x7121, 0x7300, 0x7305, 0x8130, 0x8611, 0xFF01),
    ),
}
#: What a drive may do, in the order of the documentation.
DOES = ("trip", "reboot", "unplug", "late", "other-id", "old", "hot", "drop")
#: The same for a drive of our own protocol, which is a node: its cable, and answers that are late,
#: are faults of frames.
OWN_DOES = ("trip", "reboot", "hot", "drop")
#: What is over after a time in one half of the cases, s; the other half lasts.
LASTS = (0.005, 0.4)
#: s: by how much later a drive answers.
LATE = (0.01, 0.15)


@dataclass(frozen=True, slots=True)
class Suffering:
    """A drive that may suffer a fault: its number on its bus; `vendor` "": of our own protocol."""

    bus: str
    node: int
    vendor: str = ""


def drives_of(system: System) -> list[Suffering]:
    """The drives that a deployment emulates, each once."""
    found = {
        (drive.bus, drive.node): Suffering(drive.bus, drive.node, drive.profile.vendor)
        for plan in system.nodes.values()
        for drive in commanded_drives(system.deployment, plan)
        if drive.profile.vendor in CODES
    }
    for name, plan in system.nodes.items():
        number = system.deployment.nodes[name].number
        for message in own_torques(system.deployment, name, plan):
            bus = system.messages[message].bus
            found[bus, number] = Suffering(bus, number)
    return list(found.values())


def draw_drive_fault(
    drives: Sequence[Suffering], random: np.random.Generator, low: float, high: float
) -> dict[str, Any]:
    """A table of a fault script: something that begins between two times, s.

    `drives`: one of them suffers. What ends does so before `high`.
    """
    drive = drives[int(random.integers(len(drives)))]
    does = str(random.choice(DOES if drive.vendor else OWN_DOES))
    at = round(float(random.uniform(low, high)), 4)
    table = {"kind": "drive", "bus": drive.bus, "drive": drive.node, "does": does, "at": at}
    if does == "trip" and drive.vendor:
        table["code"] = int(random.choice(np.array(CODES[drive.vendor])))
    if does == "hot":
        table["code"] = int(random.integers(1, 3))
    if does == "other-id":
        table["code"] = 32 if drive.vendor == "odrive" else 1  # as its neighbour has it
    if does == "late":
        table["by"] = round(float(random.uniform(*LATE)), 4)
    if does not in ("trip", "reboot") and random.random() < 0.5:
        table["for"] = round(min(float(random.uniform(*LASTS)), high - at), 4)
    return table
