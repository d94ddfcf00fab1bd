"""The CAN operations of FMI-LS-BUS 1.0 as values; :mod:`cosim.lsbus.codec` has their bytes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from cosim.base.errors import CosimError


class LsBusError(CosimError, ValueError):
    """Bytes that are no bus operation, or an operation that the bus cannot carry out."""


class OperationCode(IntEnum):
    """The number that an operation begins with."""

    FORMAT_ERROR = 0x01
    CAN_TRANSMIT = 0x10
    CAN_FD_TRANSMIT = 0x11
    CAN_XL_TRANSMIT = 0x12
    CONFIRM = 0x20
    ARBITRATION_LOST = 0x30
    BUS_ERROR = 0x31
    CONFIGURATION = 0x40
    STATUS = 0x41
    WAKEUP = 0x42


class ConfigurationParameter(IntEnum):
    """The setting of a Configuration operation: bit rates, bit/s, or behaviour after lost
    arbitration.
    """

    CAN_BAUDRATE = 1
    CAN_FD_BAUDRATE = 2
    CAN_XL_BAUDRATE = 3
    ARBITRATION_LOST_BEHAVIOR = 4


class LostArbitration(IntEnum):
    """Values of ARBITRATION_LOST_BEHAVIOR: the bus sends the frame again, or the node does."""

    BUFFER_AND_RETRANSMIT = 1
    DISCARD_AND_NOTIFY = 2


class BusErrorCode(IntEnum):
    """Codes of a Bus Error operation."""

    BIT = 1
    STUFF = 2
    FORM = 3
    CRC = 4
    ACK = 5
    BROKEN_ERROR_FRAME = 6


class BusErrorFlag(IntEnum):
    """PRIMARY: the addressed node detected the error; SECONDARY: another node did."""

    PRIMARY = 1
    SECONDARY = 2


class NodeStatus(IntEnum):
    """A node's statement on its controller in a Status operation."""

    ERROR_ACTIVE = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


@dataclass(frozen=True, slots=True)
class FormatError:
    """Sent back to the sender of `operation`, bytes that the receiver could not decode."""

    operation: bytes


@dataclass(frozen=True, slots=True)
class CanTransmit:
    """A classic frame. `data` of a remote frame: as many bytes as it asks for, values unused."""

    identifier: int
    extended: bool = False
    remote: bool = False
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class CanFdTransmit:
    """An FD frame; `data` is what is on the wire, with padding."""

    identifier: int
    extended: bool = False
    brs: bool = False
    esi: bool = False
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Confirm:
    """To the sender of a frame: at least one node has received it."""

    identifier: int


@dataclass(frozen=True, slots=True)
class ArbitrationLost:
    """To a node that asked for it: its frame lost the arbitration and was discarded."""

    identifier: int


@dataclass(frozen=True, slots=True)
class BusFault:
    """The Bus Error operation: an error in the frame with this identifier, as a node saw it."""

    identifier: int
    code: BusErrorCode
    flag: BusErrorFlag
    is_sender: bool


@dataclass(frozen=True, slots=True)
class Configuration:
    """A setting of the sender: bit/s, or a :class:`LostArbitration`."""

    parameter: ConfigurationParameter
    value: int


@dataclass(frozen=True, slots=True)
class StatusReport:
    """The state of the sender's error confinement."""

    status: NodeStatus


@dataclass(frozen=True, slots=True)
class Wakeup:
    """Wakes all other nodes."""


Operation = (
    FormatError | CanTransmit | CanFdTransmit | Confirm | ArbitrationLost | BusFault
    | Configuration | StatusReport | Wakeup
)  # fmt: skip
