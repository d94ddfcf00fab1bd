"""Frames of foreign drives that no DBC file describes, as bytes with what varies in them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bridge.safety.limits import to_si
from cosim.base.errors import ScenarioError

_HEX = re.compile(r"[0-9A-Fa-f]{2}|NN|U[124]")


@dataclass(frozen=True, slots=True)
class Raw:
    """A frame as hexadecimal bytes; ``NN``: the node, ``U4``: a value of 4 bytes, little endian.

    In a sequence: `expect`: the states (names or kinds of the profile's ``[status]``) of which one
    has to follow; `within`: the time for it; `again`: the frame is sent again after so long.
    """

    id: int
    data: str
    step: int = 0
    expect: tuple[str, ...] = ()
    within: str | float = "0.3 s"
    again: str | float = "50 ms"

    def check(self, place: str) -> None:
        """Raise ScenarioError unless the text describes a frame of up to 8 bytes."""
        for name in ("within", "again"):
            if not to_si(getattr(self, name), "s", f"{place}.{name}") >= 0:
                raise ScenarioError("is below 0, expected a time", f"{place}.{name}")
        wrong = [token for token in self.data.split() if not _HEX.fullmatch(token)]
        if wrong or len(self.at(0)[1]) > 8:
            raise ScenarioError(
                f"data {self.data!r}: expected at most 8 bytes in hexadecimal, NN, U1, U2 or U4",
                place,
            )

    def at(self, node: int, value: int = 0) -> tuple[int, bytes]:
        """(identifier, data) for a node."""
        data = bytearray()
        for token in self.data.split():
            if token[0] == "U":
                data += value.to_bytes(int(token[1]), "little")
            else:
                data.append(node & 0xFF if token == "NN" else int(token, 16))
        return self.id + self.step * node, bytes(data)

    def value_mask(self, node: int) -> int:
        """Bits of the value at ``U4`` in the data, taken as one number, little endian."""
        zero, ones = (
            self.at(node, (1 << 8 * size) - 1 if size else 0)[1] for size in (0, self._size)
        )
        return int.from_bytes(zero, "little") ^ int.from_bytes(ones, "little")

    @property
    def _size(self) -> int:
        """Bytes of its value; 0: it has none."""
        return sum(int(token[1]) for token in self.data.split() if token[0] == "U")

    def value(self, node: int, identifier: int, data: bytes) -> int | None:
        """The value at ``U4`` in a frame, or None for another frame."""
        number, at = 0, 0
        for token in self.data.split():
            size = int(token[1]) if token[0] == "U" else 1
            if token[0] == "U":
                number = int.from_bytes(data[at : at + size], "little")
            elif data[at : at + 1] != bytes([node & 0xFF if token == "NN" else int(token, 16)]):
                return None
            at += size
        same = identifier == self.id + self.step * node and len(data) == at
        return number if same else None


@dataclass(frozen=True, slots=True)
class OwnWatchdog:
    """The watchdog inside a drive. Without `write` and `read` it is set by other means.

    `fed_by`: any ``frame`` to the drive, ``torque``, or the ``heartbeat`` of its host; ``link``:
    torques and heartbeats of this project's own protocol.
    """

    fed_by: str
    register: str = ""
    unit: str = "1 s"
    write: Raw | None = None
    read: Raw | None = None
    reply: Raw | None = None

    def raw(self, timeout: float) -> int:
        """The register's value for a time-out, s. Raises ScenarioError where that is off."""
        value = round(timeout / to_si(self.unit, "s", "watchdog.unit"))
        if value < 1:
            raise ScenarioError(f"time-out {timeout:g} s is off, expected at least {self.unit}")
        return value

    def wrong_value(self, timeout: float, node: int, identifier: int, data: bytes) -> str:
        """The sentence on an answer to `read` that has another time-out than `timeout` (s)."""
        found = None if self.reply is None else self.reply.value(node, identifier, data)
        if found is None or found == self.raw(timeout):
            return ""
        unit = to_si(self.unit, "s", "watchdog.unit")
        said = f"{found * unit:g} s" if found else "0, off"
        return f"{self.register} reads {said}, not {timeout:g} s"
