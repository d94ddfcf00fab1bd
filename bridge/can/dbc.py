"""DBC files, read by cantools (this module is the only one that imports it).

Two attributes of a message define its protection: ``E2EProfile`` (None, P02, P05) and ``E2EDataId``
(hexadecimal: 16 bytes for P02, 16 bits for P05). The signals `crc` and `counter` of a protected
message are at the positions of the profile, and `status` and `t_us`, if present, belong to the
header, too. The attribute ``InvalidRaw`` of a signal defines the raw value that is not a number.
"""

from __future__ import annotations

import re
import struct
from functools import lru_cache
from pathlib import Path
from typing import Any, final

from cantools import database
from cantools.autosar.end_to_end import compute_profile2_crc, compute_profile5_crc
from cantools.database.can import Database, Message
from cantools.database.can import Signal as CanSignal
from cantools.database.errors import Error

from bridge.can.layout import LayoutError, MessageLayout, Signal
from bridge.native.frame import Flags
from bridge.native.message import E2EProfile, FieldKind
from cosim.base.files import regular

#: Where a profile has its CRC and its counter: start bit and length, Intel.
_PLACES = {
    E2EProfile.P02: {"crc": (0, 8), "counter": (8, 4)},
    E2EProfile.P05: {"crc": (0, 16), "counter": (16, 8)},
}
_PROFILES = {"None": E2EProfile.NONE, "P02": E2EProfile.P02, "P05": E2EProfile.P05}
#: Longest message of a DBC file, bytes: one of J1939 in several frames.
LONGEST = 1785
_BYTES = re.compile(rb"^\s*BO_\s+\d+\s+(\w+)\s*:\s*(-?\d+)", re.MULTILINE)
_BITS = re.compile(rb"^\s*SG_\s+(\w+)[^:\n]*:\s*(-?\d+)\|(-?\d+)", re.MULTILINE)
_HEADER = ("crc", "counter", "status", "t_us")


def load(path: str | Path) -> tuple[MessageLayout, ...]:
    """All messages of a file, in its order.

    Raises LayoutError when the file cannot be read, when two messages have one identifier, one
    name or one data ID, and when the protection of a message is incomplete.
    """
    layouts = tuple(_layout(message, str(path)) for message in read(str(path)).messages)
    _differ(layouts, "name", [layout.name for layout in layouts])
    _differ(layouts, "identifier", [hex(layout.identifier) for layout in layouts])
    ids = [f"{x.profile.name} {x.data_ids.hex()}" if x.profile else x.name for x in layouts]
    _differ(layouts, "E2EDataId", ids)
    return layouts


@lru_cache(maxsize=8)
def read(path: str) -> Database:
    """The file as cantools sees it. Raises LayoutError."""
    _check_sizes(path)
    try:
        found = database.load_file(regular(Path(path)), database_format="dbc")
    except (OSError, UnicodeDecodeError, Error, ValueError) as error:
        raise LayoutError(f"{path}: not a DBC file that can be used: {error}") from error
    assert isinstance(found, Database)
    return found


def _check_sizes(path: str) -> None:
    """Refuse sizes for which cantools would make masks of as many bits. Raises LayoutError."""
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise LayoutError(f"{path}: not a DBC file that can be used: {error}") from error
    for pattern, most, unit in ((_BYTES, LONGEST, "bytes"), (_BITS, 8 * LONGEST, "bits")):
        for found in pattern.finditer(text):
            sizes = [int(size) for size in found.groups()[1:] if len(size) < 10]
            if len(sizes) < found.re.groups - 1 or not 0 <= min(sizes) <= max(sizes) <= most:
                name = found[1].decode(errors="replace")
                raise LayoutError(
                    f"{path}: {name}: found {found[0][-60:].decode(errors='replace')!r}; expected "
                    f"0 to {most} {unit}"
                )


@final
class CantoolsMessage:
    """One message of a file, as cantools reads it. Raw values are numbers by signal name."""

    def __init__(self, layout: MessageLayout) -> None:
        self._message = read(layout.source).get_message_by_name(layout.name)
        self._layout = layout

    def initial(self) -> dict[str, float]:
        """Raw start values of all signals: the bits on the bus, before factor and offset."""
        return {signal.name: signal.raw_initial or 0 for signal in self._message.signals}

    def raw(self, name: str, value: float) -> float:
        """The raw value, before factor and offset, of a value in the DBC's unit; any range."""
        conversion = self._message.get_signal_by_name(name).conversion
        return conversion.numeric_scaled_to_raw(value)

    def encode(self, raw: dict[str, float]) -> bytes:
        """The data of these raw values, which must fit their bits."""
        return self._message.encode(raw, scaling=False, strict=False)

    def decode(self, data: bytes, scaling: bool) -> dict[str, float]:
        """Values of all signals in the DBC's units, or without `scaling` the raw values."""
        found = self._message.decode(data, decode_choices=False, scaling=scaling)
        assert isinstance(found, dict)
        return {n: v for n, v in found.items() if isinstance(v, int | float)}

    def crc(self, data: bytes) -> int:
        """The CRC of a protected message; its own place in `data` is not read."""
        ids = self._layout.data_ids
        if self._layout.profile is E2EProfile.P02:
            found = compute_profile2_crc(data, ids[data[1] & 15])
        else:
            found = compute_profile5_crc(data, int.from_bytes(ids[:2], "little"))
        return -1 if found is None else found


def _differ(layouts: tuple[MessageLayout, ...], what: str, values: list[str]) -> None:
    seen: dict[str, str] = {}
    for layout, value in zip(layouts, values, strict=True):
        if value in seen:
            raise LayoutError(
                f"{layout.source}: messages {seen[value]} and {layout.name} have the same {what} "
                f"{value}; expected different ones"
            )
        seen[value] = layout.name


def _layout(message: Message, path: str) -> MessageLayout:
    attributes = _attributes(message)
    place = f"{path}: message {message.name}"
    profile = _profile(message, attributes, place)
    signals = {s.name: _signal(s, place) for s in message.signals if not s.multiplexer_ids}
    header = {n: signals.pop(n) for n in _HEADER if profile and n in signals}
    brs = str(attributes.get("CANFD_BRS", 0)) in ("1", "1.0")
    flags = Flags.FD * message.is_fd | Flags.BRS * (message.is_fd and brs)
    for name, expected in _PLACES.get(profile, {}).items():
        found = header.get(name)
        if found is None or found.motorola or (found.start, found.length) != expected:
            raise LayoutError(
                f"{place} is protected by {profile.name} but has no signal {name} at bit "
                f"{expected[0]} of {expected[1]} bits (Intel)"
            )
    return MessageLayout(
        *(message.name, message.frame_id, message.length, tuple(signals.values())),
        flags=int(flags | Flags.EXTENDED * message.is_extended_frame),
        profile=profile,
        data_ids=_data_ids(profile, attributes, place),
        status=header.get("status"),
        time=header.get("t_us"),
        crc=header.get("crc"),
        counter=header.get("counter"),
        period=_period(message, place),
        source=path,
        multiplexed=tuple(s.name for s in message.signals if s.multiplexer_ids),
    )


def _period(message: Message, place: str) -> float | None:
    """The cycle time, s; None without one. Raises LayoutError for what is no time."""
    found: object = message.cycle_time
    if not found:
        return None
    if not isinstance(found, int | float) or not 0 < found < 1e12:
        raise LayoutError(f"{place}: found the cycle time {found!r}; expected ms above 0")
    return found / 1000


def _attributes(owner: Message | CanSignal) -> dict[str, Any]:
    """Attributes that are given (not their defaults)."""
    if owner.dbc is None or owner.dbc.attributes is None:
        return {}
    return {name: attribute.value for name, attribute in owner.dbc.attributes.items()}


def _profile(message: Message, attributes: dict[str, Any], place: str) -> E2EProfile:
    value = attributes.get("E2EProfile", "None")
    if not isinstance(value, str) and message.dbc is not None:  # the number of an ENUM's entry
        choices = message.dbc.attributes["E2EProfile"].definition.choices or []
        value = choices[int(value)] if int(value) < len(choices) else value
    if value in _PROFILES:
        return _PROFILES[value]
    raise LayoutError(f"{place}: E2EProfile {value!r}; expected one of {', '.join(_PROFILES)}")


def _data_ids(profile: E2EProfile, attributes: dict[str, Any], place: str) -> bytes:
    if profile is E2EProfile.NONE:
        return bytes(16)
    digits = 32 if profile is E2EProfile.P02 else 4
    text = str(attributes.get("E2EDataId", "")).replace(" ", "")
    try:
        number = int(text, 16) if len(text) == digits else -1
    except ValueError:
        number = -1
    if number < 0:
        raise LayoutError(
            f"{place} is protected by {profile.name}: E2EDataId {text!r}; expected {digits} "
            "hexadecimal digits"
        )
    return number.to_bytes(16, "big") if digits == 32 else struct.pack("<H14x", number)


def _signal(signal: CanSignal, place: str) -> Signal:
    raw = signal.raw_initial or 0
    kind = (
        FieldKind.FLOAT
        if signal.is_float
        else FieldKind.SIGNED
        if signal.is_signed
        else FieldKind.UNSIGNED
    )
    if kind is FieldKind.FLOAT:
        code = {32: "<f", 64: "<d"}.get(signal.length)
        if code is None:
            raise LayoutError(
                f"{place}: signal {signal.name} is a float of {signal.length} bits; expected 32 "
                "or 64"
            )
        raw = int.from_bytes(struct.pack(code, raw), "little")
    invalid = _attributes(signal).get("InvalidRaw")
    return Signal(
        *(signal.name, signal.start, signal.length, kind),
        motorola=signal.byte_order == "big_endian",
        scale=float(signal.scale),
        offset=float(signal.offset),
        low=-float("inf") if signal.minimum is None else float(signal.minimum),
        high=float("inf") if signal.maximum is None else float(signal.maximum),
        unit=signal.unit or "",
        initial=int(raw),
        invalid=None if invalid is None else int(invalid),
    )
