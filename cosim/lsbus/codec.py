"""The bytes of the CAN operations of FMI-LS-BUS 1.0.

A Binary variable holds any number of operations, one after the other, packed and little endian.
Each begins with its code (UInt32) and its length in bytes, this header included (UInt32). The
layouts are those of the chapter "Supported Operations" for CAN of the layered standard.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from typing import NamedTuple, TypeVar

from cosim.lsbus.operations import (
    ArbitrationLost,
    BusErrorCode,
    BusErrorFlag,
    BusFault,
    CanFdTransmit,
    CanTransmit,
    Configuration,
    ConfigurationParameter,
    Confirm,
    FormatError,
    LostArbitration,
    LsBusError,
    NodeStatus,
    Operation,
    OperationCode,
    StatusReport,
    Wakeup,
)

#: Longest data of a classic frame, bytes; and what an FD frame can have on the wire.
CLASSIC_BYTES = 8
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_HEADER = struct.Struct("<II")
_Code = TypeVar("_Code", bound=IntEnum)


class Malformed(NamedTuple):
    """Bytes that are no operation, and the sentence that says why, with the place in the buffer."""

    raw: bytes
    reason: str


def encode(operations: Iterable[Operation]) -> bytes:
    """The bytes of the operations, one after the other.

    Raises LsBusError for values that the layout or CAN cannot hold.
    """
    return b"".join(map(_encode, operations))


def decode(buffer: bytes, origin: str = "") -> list[Operation]:
    """The operations of a Binary variable, `origin` in messages.

    Raises LsBusError for the first bytes that are none: found, expected, at which byte.
    """
    found: list[Operation] = []
    for item in split(buffer):
        if isinstance(item, Malformed):
            raise LsBusError(f"{origin}: {item.reason}" if origin else item.reason)
        found.append(item)
    return found


def split(buffer: bytes) -> list[Operation | Malformed]:
    """All operations of a Binary variable; those that cannot be decoded as :class:`Malformed`.

    What follows a length that cannot be true cannot be separated: it is part of that item.
    """
    found: list[Operation | Malformed] = []
    at = 0
    while at < len(buffer):
        rest = buffer[at:]
        if len(rest) < _HEADER.size:
            reason = f"found {len(rest)} bytes at byte {at}, expected a header of 8 bytes"
            return [*found, Malformed(rest, reason)]
        code, length = _HEADER.unpack_from(rest)
        if not _HEADER.size <= length <= len(rest):
            reason = (
                f"found an operation of length {length} at byte {at}, expected 8 to {len(rest)}"
                " bytes, which is what is left"
            )
            return [*found, Malformed(rest, reason)]
        raw = rest[:length]
        try:
            found.append(_decode(code, raw))
        except LsBusError as error:
            found.append(Malformed(raw, f"operation at byte {at}: {error}"))
        at += length
    return found


# ---- one operation --------------------------------------------------------------------------


def _encode(operation: Operation) -> bytes:
    code, body = _body(operation)
    raw = _HEADER.pack(code, _HEADER.size + len(body)) + body
    _decode(code, raw)
    return raw


def _body(operation: Operation) -> tuple[OperationCode, bytes]:
    """Code, and what follows the header. Raises LsBusError for numbers out of their field."""
    try:
        return _packed(operation)
    except struct.error as error:
        raise LsBusError(f"found {operation}, expected values that fit: {error}") from None


def _packed(operation: Operation) -> tuple[OperationCode, bytes]:
    code = OperationCode
    match operation:
        case FormatError(raw):
            return code.FORMAT_ERROR, struct.pack("<H", len(raw)) + raw
        case CanTransmit(i, extended, remote, data):
            return code.CAN_TRANSMIT, struct.pack("<IBBH", i, extended, remote, len(data)) + data
        case CanFdTransmit(i, extended, brs, esi, data):
            head = struct.pack("<IBBBH", i, extended, brs, esi, len(data))
            return code.CAN_FD_TRANSMIT, head + data
        case Confirm(i):
            return code.CONFIRM, struct.pack("<I", i)
        case ArbitrationLost(i):
            return code.ARBITRATION_LOST, struct.pack("<I", i)
        case BusFault(i, error, flag, sender):
            return code.BUS_ERROR, struct.pack("<IBBB", i, error, flag, sender)
        case Configuration(parameter, value):
            lost = parameter == ConfigurationParameter.ARBITRATION_LOST_BEHAVIOR
            return code.CONFIGURATION, struct.pack("<BB" if lost else "<BI", parameter, value)
        case StatusReport(status):
            return code.STATUS, struct.pack("<B", status)
        case Wakeup():
            return code.WAKEUP, b""


def _decode(code: int, raw: bytes) -> Operation:
    if code not in _DECODERS:
        known = ", ".join(f"{c:#04x}" for c in sorted(_DECODERS))
        what = "CAN XL Transmit, which is not simulated" if code == 0x12 else f"code {code:#x}"
        raise LsBusError(f"found {what}, expected one of the codes {known}")
    return _DECODERS[code](raw)


def _fields(raw: bytes, layout: str, name: str, exact: bool = True) -> tuple[int, ...]:
    """The fields behind the header; `exact`: with nothing after them."""
    fields = struct.Struct("<" + layout)
    least = _HEADER.size + fields.size
    if len(raw) < least or (exact and len(raw) != least):
        more = "" if exact else " or more"
        raise LsBusError(f"found {name} of {len(raw)} bytes, expected {least}{more}")
    return fields.unpack_from(raw, _HEADER.size)


def _data(raw: bytes, start: int, length: int, name: str) -> bytes:
    if len(raw) != start + length:
        raise LsBusError(
            f"found {name} of {len(raw)} bytes with {length} bytes of data, expected"
            f" {start + length} bytes"
        )
    return raw[start:]


def _flag(value: int, name: str) -> bool:
    if value not in (0, 1):
        raise LsBusError(f"found {name} = {value}, expected 0 or 1")
    return bool(value)


def _identifier(value: int, extended: bool | None = None) -> int:
    """`extended` None: the operation does not say whether it has 11 or 29 bits."""
    width = 11 if extended is False else 29
    if value >> width:
        raise LsBusError(f"found identifier {value:#x}, expected {width} bits")
    return value


def _one_of(kind: type[_Code], value: int, name: str) -> _Code:
    try:
        return kind(value)
    except ValueError:
        expected = ", ".join(f"{m.value} {m.name}" for m in kind)
        raise LsBusError(f"found {name} {value}, expected {expected}") from None


def _format_error(raw: bytes) -> Operation:
    (length,) = _fields(raw, "H", "Format Error", exact=False)
    return FormatError(_data(raw, 10, length, "Format Error"))


def _can_transmit(raw: bytes) -> Operation:
    i, ide, rtr, length = _fields(raw, "IBBH", "CAN Transmit", exact=False)
    data = _data(raw, 16, length, "CAN Transmit")
    if length > CLASSIC_BYTES:
        raise LsBusError(f"found CAN Transmit with {length} bytes of data, expected 0 to 8")
    extended = _flag(ide, "IDE")
    return CanTransmit(_identifier(i, extended), extended, _flag(rtr, "RTR"), data)


def _can_fd_transmit(raw: bytes) -> Operation:
    i, ide, brs, esi, length = _fields(raw, "IBBBH", "CAN FD Transmit", exact=False)
    data = _data(raw, 17, length, "CAN FD Transmit")
    if length not in FD_LENGTHS:
        expected = ", ".join(map(str, FD_LENGTHS[8:]))
        raise LsBusError(
            f"found CAN FD Transmit with {length} bytes of data, expected 0 to 7, {expected}"
        )
    extended = _flag(ide, "IDE")
    flags = _flag(brs, "BRS"), _flag(esi, "ESI")
    return CanFdTransmit(_identifier(i, extended), extended, *flags, data)


def _confirm(raw: bytes) -> Operation:
    (identifier,) = _fields(raw, "I", "Confirm")
    return Confirm(_identifier(identifier))


def _arbitration_lost(raw: bytes) -> Operation:
    (identifier,) = _fields(raw, "I", "Arbitration Lost")
    return ArbitrationLost(_identifier(identifier))


def _bus_error(raw: bytes) -> Operation:
    i, code, flag, sender = _fields(raw, "IBBB", "Bus Error")
    return BusFault(
        _identifier(i),
        _one_of(BusErrorCode, code, "error code"),
        _one_of(BusErrorFlag, flag, "error flag"),
        _flag(sender, "is sender"),
    )


def _configuration(raw: bytes) -> Operation:
    (number,) = _fields(raw, "B", "Configuration", exact=False)
    parameter = _one_of(ConfigurationParameter, number, "parameter")
    lost = parameter == ConfigurationParameter.ARBITRATION_LOST_BEHAVIOR
    _, value = _fields(raw, "BB" if lost else "BI", f"Configuration of {parameter.name}")
    if lost:
        value = _one_of(LostArbitration, value, "arbitration lost behavior")
    elif value == 0:
        raise LsBusError(f"found {parameter.name} 0, expected 1 bit/s or more")
    return Configuration(parameter, value)


def _status(raw: bytes) -> Operation:
    (status,) = _fields(raw, "B", "Status")
    return StatusReport(_one_of(NodeStatus, status, "status"))


def _wakeup(raw: bytes) -> Operation:
    _fields(raw, "", "Wake-up")
    return Wakeup()


_DECODERS: Mapping[int, Callable[[bytes], Operation]] = {
    OperationCode.FORMAT_ERROR: _format_error,
    OperationCode.CAN_TRANSMIT: _can_transmit,
    OperationCode.CAN_FD_TRANSMIT: _can_fd_transmit,
    OperationCode.CONFIRM: _confirm,
    OperationCode.ARBITRATION_LOST: _arbitration_lost,
    OperationCode.BUS_ERROR: _bus_error,
    OperationCode.CONFIGURATION: _configuration,
    OperationCode.STATUS: _status,
    OperationCode.WAKEUP: _wakeup,
}
