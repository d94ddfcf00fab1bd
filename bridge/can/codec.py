"""Values to bytes and back by the tables of ``bridge/c/message.c``, in a chosen order."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.can.layout import LayoutError, MessageLayout, Signal, check
from bridge.native import message as native
from bridge.native.frame import Frame
from bridge.native.message import Decoded, Field, FieldKind, Header, Message

Vector = NDArray[np.float64]


@final
class Codec:
    """One message that carries `signals` in this order; its other signals have their start values.

    Header signals (status, time stamp, counter, CRC) are not values. Values of integer signals
    saturate and are rounded to the nearest (ties to even); a value that is not finite becomes the
    invalid code. `exact`: a frame that this codec would not have written is invalid.

    Raises LayoutError for unknown or repeated signals, and for a layout that the C code does not
    support.
    """

    def __init__(
        self, layout: MessageLayout, signals: Sequence[str] | None = None, *, exact: bool = False
    ) -> None:
        names = [signal.name for signal in layout.signals] if signals is None else list(signals)
        self.layout = layout
        self.signals = tuple(layout.signal(name) for name in names)
        _check_names(layout, names)
        check(layout)
        header = [signal for signal in (layout.status, layout.time) if signal]
        self._fields = (Field * max(1, len(names)))(*map(_field, self.signals))
        self._header = (Field * max(1, len(header)))(*map(_field, header))
        self.message = Message(
            id=layout.identifier,
            length=layout.length,
            flags=int(layout.flags),
            e2e=int(layout.profile),
            data_ids=(c.c_uint8 * 16)(*layout.data_ids),
            n_fields=len(names),
            status=0 if layout.status else -1,
            time=len(header) - 1 if layout.time else -1,
            exact=exact,
            fields=self._fields,
            header=self._header,
            fill=(c.c_uint8 * 64)(*_fill(layout, self.signals)),
        )

    def encode(
        self, values: ArrayLike, status: int = 0, t_us: int = 0, counter: int = 0, t_ns: int = 0
    ) -> bytes:
        """The data of one message. `values` (n,), in the signals' units; the rest is truncated."""
        return self.frame(values, Header(counter, status, t_us), t_ns).payload

    def frame(self, values: ArrayLike, header: Header, t_ns: int = 0) -> Frame:
        """The frame; `header.saturated` becomes the number of values that did not fit."""
        array = np.ascontiguousarray(values, dtype=np.float64)
        if array.shape != (len(self.signals),):
            raise LayoutError(
                f"{self.layout.place}: values of shape {array.shape}; expected "
                f"({len(self.signals)},)"
            )
        frame = Frame(t_ns=t_ns)
        native.encode(self.message, array.ctypes.data, header, frame)
        return frame

    def decode(self, data: bytes) -> tuple[Decoded, Vector, Header]:
        """Return the result, the values (n,), each in the unit of its signal, and the header.

        The values are NaN unless the result is OK.
        """
        values = np.full(len(self.signals), np.nan)
        header = Header()
        frame = Frame.of(self.layout.identifier, data, self.message.flags)
        result = native.decode(self.message, frame, values.ctypes.data, header)
        return result, values, header


def _check_names(layout: MessageLayout, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LayoutError(f"{layout.place}: signal {', '.join(twice)} is carried twice")
    if len(names) > native.FIELDS:
        raise LayoutError(
            f"{layout.place}: {len(names)} signals; at most {native.FIELDS} are possible"
        )


def _field(signal: Signal) -> Field:
    low, high = signal.raw_range
    if signal.kind is FieldKind.FLOAT:
        low, high = np.array([low, high]).view(np.int64).tolist()
    return Field(
        start=signal.start,
        length=signal.length,
        motorola=signal.motorola,
        kind=int(signal.kind),
        has_invalid=signal.invalid is not None,
        scale=signal.scale,
        offset=signal.offset,
        low=int(low),
        high=int(high),
        invalid=signal.invalid or 0,
    )


def _fill(layout: MessageLayout, carried: tuple[Signal, ...]) -> bytes:
    """The bytes under the values: start values of the signals that carry none."""
    data = bytearray(max(layout.length, 64))
    for signal in layout.signals:
        if signal not in carried:
            for place, bit in enumerate(signal.bits()):
                data[bit // 8] |= (signal.initial >> place & 1) << bit % 8
    if any(data[64:]):
        raise LayoutError(f"{layout.place}: start values other than 0 beyond byte 63")
    return bytes(data[:64])
