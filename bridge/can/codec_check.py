"""The codec in C against cantools: bytes, values and checksums of the same vectors."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from bridge.can.codec import Codec, Vector
from bridge.can.dbc import CantoolsMessage
from bridge.can.layout import CodecError, LayoutError, Signal
from bridge.native.message import Decoded, FieldKind, Header


def verify(codec: Codec, n: int = 8, seed: int = 0) -> None:
    """Compare C with cantools: ends, beyond the ends, zero, invalid, and `n` random vectors.

    For messages of a DBC file. Raises CodecError at the first difference.
    """
    compare(codec, vectors(codec.signals, n, seed))


def vectors(signals: Iterable[Signal], n: int, seed: int) -> list[Vector]:
    """Return n + 6 vectors (signals,) of limits, special and random values.

    Values are in the units of the signals.
    """
    random = np.random.default_rng(seed)
    ends = [sorted((s.scale * r + s.offset) for r in s.raw_range) for s in signals]
    low, high = np.array([e[0] for e in ends]), np.array([e[1] for e in ends])
    span = np.minimum(high - low, 1e30)  # of a float32: as good as any
    middle = np.clip(0.0, low, high)
    start = np.where(span < 1e30, low, -0.5e30)
    found = [low, high, middle, low - 1e-3 * span, high + span, np.full(low.shape, np.nan)]
    found += [start + span * random.random(low.shape) for _ in range(n)]
    return found


def compare(codec: Codec, vectors: Iterable[Vector]) -> None:
    """Raise CodecError if C and cantools differ; the error names message and signal.

    `vectors`: values (n_signals,) to encode. Compares the bytes without the CRC, the CRC, and the
    values that C decodes from bytes of cantools. Raises LayoutError if the message is not from a
    DBC file.
    """
    if not codec.layout.source:
        raise LayoutError(
            f"{codec.layout.place} is not from a DBC file and cannot be compared with cantools"
        )
    reference = CantoolsMessage(codec.layout)
    for number, values in enumerate(vectors):
        header = Header(counter=37 * number + 11, status=73 * number + 5, t_us=number * 999_999_937)
        found = codec.frame(values, header).payload
        raw = _raw(codec, reference, values, header, found)
        _same_bytes(codec, reference, found, reference.encode(raw))
        _same_crc(codec, reference, found)
        _same_values(codec, reference, found)


def _raw(
    codec: Codec, reference: CantoolsMessage, values: Vector, header: Header, found: bytes
) -> dict[str, float]:
    """Every signal's raw value as it should be, by cantools' own conversion of what is in range."""
    layout = codec.layout
    raw = reference.initial()
    for signal, value in zip(codec.signals, values.tolist(), strict=True):
        low, high = signal.raw_range
        if not math.isfinite(value) and signal.invalid is not None:
            raw[signal.name] = math.nan if signal.kind is FieldKind.FLOAT else signal.invalid
        else:
            held = value if math.isfinite(value) else 0.0
            raw[signal.name] = min(max(reference.raw(signal.name, held), low), high)
    for part, number in ((layout.status, header.status), (layout.time, header.t_us)):
        if part is not None:
            raw[part.name] = int(number / part.scale) & (1 << part.length) - 1
    if layout.counter is not None and layout.crc is not None:
        raw[layout.counter.name] = header.counter & (1 << layout.counter.length) - 1
        raw[layout.crc.name] = int.from_bytes(found[: layout.crc.length // 8], "little")
    return raw


def _same_bytes(codec: Codec, reference: CantoolsMessage, found: bytes, expected: bytes) -> None:
    if found == expected:
        return
    theirs = reference.decode(expected, scaling=False)
    for name, value in reference.decode(found, scaling=False).items():
        if _text(value) != _text(theirs[name]):
            raise CodecError(
                f"{codec.layout.place}: signal {name}: encoded as raw {value}; cantools: "
                f"{theirs[name]}"
            )
    raise CodecError(f"{codec.layout.place}: encoded as {found.hex()}; cantools: {expected.hex()}")


def _same_crc(codec: Codec, reference: CantoolsMessage, found: bytes) -> None:
    layout = codec.layout
    if layout.crc is None:
        return
    ours, theirs = int.from_bytes(found[: layout.crc.length // 8], "little"), reference.crc(found)
    if ours != theirs:
        raise CodecError(
            f"{layout.place}: {layout.profile.name} CRC {ours:#x}; cantools: {theirs:#x}"
        )


def _same_values(codec: Codec, reference: CantoolsMessage, data: bytes) -> None:
    result, values, _ = codec.decode(data)
    theirs, raw = (reference.decode(data, scaling=scaling) for scaling in (True, False))
    usable = all(_usable(signal, raw[signal.name]) for signal in codec.signals)
    if (result is Decoded.OK) != usable:
        raise CodecError(f"{codec.layout.place}: {data.hex()} is decoded as {result.name}")
    for signal, value in zip(codec.signals, values, strict=True):
        if usable and float(theirs[signal.name]) != value:
            raise CodecError(
                f"{codec.layout.place}: signal {signal.name}: decoded as {value!r}; cantools: "
                f"{theirs[signal.name]!r}"
            )


def _usable(signal: Signal, raw: float) -> bool:
    low, high = signal.raw_range
    return low <= raw <= high


def _text(value: float) -> str:
    return "nan" if math.isnan(value) else repr(value)
