"""CiA 402 drives over SDO: PDO mapping, mode, heartbeat watchdog.

Works on the SDO client of the package `canopen` (``network.add_node(n, ObjectDictionary()).sdo``),
which is an extra. Everything written is read back. Objects are those of CiA 301 and CiA 402-2.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from bridge.drives.profiles import DriveProfile
from cosim.base.errors import CosimError

CONTROLWORD, STATUSWORD, MODE, RATED_TORQUE = 0x6040, 0x6041, 0x6060, 0x6076
CONSUMER_HEARTBEAT = 0x1016
TORQUE_MODE = 10
#: Communication record, mapping record, COB-ID of node 0, objects (index, bits) as in the DBC.
PDOS = (
    (0x1400, 0x1600, 0x200, ((CONTROLWORD, 16), (MODE, 8), (0x6071, 16))),
    (0x1800, 0x1A00, 0x180, ((STATUSWORD, 16), (0x6064, 32), (0x6077, 16))),
    (0x1801, 0x1A01, 0x280, ((0x606C, 32),)),
)
_INVALID = 1 << 31  # of a COB-ID: the PDO is off
#: When PDOs are taken and sent: commands at once (also those that enable), feedback at each SYNC.
_AT_ONCE, _EVERY_SYNC, _FIRST_SENT = 0xFF, 1, 0x1800


class Sdo(Protocol):
    """An SDO client, as `canopen` has it."""

    def upload(self, index: int, subindex: int) -> bytes:
        """Read an object."""

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object."""


def configure(sdo: Sdo, profile: DriveProfile, node: int, host: int, timeout: float) -> None:
    """Prepare a drive for cyclic torque: mode, PDOs as in the profile's DBC file, heartbeat
    watchdog.

    `host`: node number whose heartbeats the drive monitors; `timeout`: time without them after
    which it reacts, s. Raises CosimError if an object does not contain the value written or if the
    rated torque (0x6076, mN.m) differs from the profile's, and ScenarioError for a time-out that is
    off.
    """
    watchdog = profile.watchdog.raw(timeout)
    rated = _read(sdo, RATED_TORQUE) * 1e-3
    if abs(rated - profile.rated_torque) > 1e-3:
        raise CosimError(
            f"node {node}: rated torque (0x6076) is {rated:g} N.m, expected "
            f"{profile.rated_torque:g} N.m, the rated_torque of {profile.path}"
        )
    _write(sdo, node, MODE, 0, TORQUE_MODE, 1)
    _write(sdo, node, CONSUMER_HEARTBEAT, 1, host << 16 | watchdog, 4)
    for communication, mapping, cob_id, objects in PDOS:
        _map(sdo, node, communication, mapping, cob_id + node, objects)


def transmission(communication: int) -> int:
    """The type of a PDO with this communication record: when it is taken or sent."""
    return _AT_ONCE if communication < _FIRST_SENT else _EVERY_SYNC


def _map(
    sdo: Sdo,
    node: int,
    communication: int,
    mapping: int,
    cob_id: int,
    objects: Iterable[tuple[int, int]],
) -> None:
    """Configure one PDO: disable it, map its objects, enable it; CiA 301 requires this order."""
    _put(sdo, communication, 1, cob_id | _INVALID, 4)
    _write(sdo, node, communication, 2, transmission(communication), 1)
    _put(sdo, mapping, 0, 0, 1)
    count = 0
    for index, bits in objects:
        count += 1
        _write(sdo, node, mapping, count, index << 16 | bits, 4)
    _write(sdo, node, mapping, 0, count, 1)
    _write(sdo, node, communication, 1, cob_id, 4)


def _write(sdo: Sdo, node: int, index: int, subindex: int, value: int, size: int) -> None:
    _put(sdo, index, subindex, value, size)
    found = _read(sdo, index, subindex)
    if found != value:
        raise CosimError(
            f"node {node}: object {index:#06x}:{subindex} reads {found:#x}, expected {value:#x}"
        )


def _put(sdo: Sdo, index: int, subindex: int, value: int, size: int) -> None:
    sdo.download(index, subindex, value.to_bytes(size, "little"))


def _read(sdo: Sdo, index: int, subindex: int = 0) -> int:
    return int.from_bytes(sdo.upload(index, subindex), "little")
