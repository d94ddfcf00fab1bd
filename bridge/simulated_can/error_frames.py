"""Reports of a controller other than data frames, as error frames of Linux.

Source: linux/can/error.h. The identifier has the classes of the error; the eight bytes of data
hold the details, TEC in byte 6 and REC in byte 7.
"""

from __future__ import annotations

import can

from cosim.bus.frames import BusEvent, ControllerState, ErrorCode, ErrorRole

LOST_ARBITRATION, CONTROLLER, PROTOCOL = 0x2, 0x4, 0x8
NO_ACKNOWLEDGE, BUS_OFF, BUS_ERROR, RESTARTED, COUNTERS = 0x20, 0x40, 0x80, 0x100, 0x200
_ON_SENDING = 0x80
_ACK_SLOT, _CRC_SEQUENCE = 0x19, 0x08
_PROTOCOL = {ErrorCode.BIT: 0x01, ErrorCode.STUFF: 0x04, ErrorCode.FORM: 0x02}
_LIMITS = {ControllerState.ACTIVE: (0x40, 0x40), ControllerState.WARNING: (0x08, 0x04)}
_LIMITS[ControllerState.PASSIVE] = (0x20, 0x10)


def error_message(
    kind: int, code: int, role: int, bit: int, counters: tuple[int, int]
) -> can.Message | None:
    """The error frame of an event of `cosim.bus` at one node; None for events that have none.

    `kind`, `code`, `role`, `bit` (0: start of frame) are those of the event, `counters` TEC and REC
    of the node after it. Time stamp and channel are left to the caller.
    """
    if kind == BusEvent.ERROR:
        return _of(*_protocol(code, role), counters)
    if kind == BusEvent.LOST:
        return _of(LOST_ARBITRATION, {0: min(bit, 31)}, counters)
    if kind == BusEvent.STATE:
        return _state(code, counters)
    if kind == BusEvent.RECOVERED:
        return _of(RESTARTED, {}, counters)
    return None


def _protocol(code: int, role: int) -> tuple[int, dict[int, int]]:
    sending = _ON_SENDING if role & ErrorRole.SENDER else 0
    if code == ErrorCode.ACK:
        return NO_ACKNOWLEDGE | BUS_ERROR, {2: sending, 3: _ACK_SLOT}
    location = {3: _CRC_SEQUENCE} if code == ErrorCode.CRC else {}
    return PROTOCOL | BUS_ERROR, {2: _PROTOCOL.get(ErrorCode(code), 0) | sending, **location}


def _state(code: int, counters: tuple[int, int]) -> can.Message | None:
    if code == ControllerState.OFF:
        return _of(BUS_OFF, {}, counters)
    limits = _LIMITS.get(ControllerState(code))
    if limits is None:
        return None
    tec, rec = counters
    sending, receiving = limits
    bits = (sending if tec >= rec else 0) | (receiving if rec >= tec else 0)
    return _of(CONTROLLER, {1: bits}, counters)


def _of(classes: int, details: dict[int, int], counters: tuple[int, int]) -> can.Message:
    data = bytearray(8)
    for place, value in details.items():
        data[place] = value
    data[6], data[7] = (min(n, 255) for n in counters)
    return can.Message(
        arbitration_id=classes | COUNTERS,
        is_extended_id=False,
        is_error_frame=True,
        dlc=8,
        data=data,
    )
