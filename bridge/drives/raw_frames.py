"""Frames of foreign drives that no DBC file describes, as bytes with what varies in them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bridge.safety.limits import to_si
from cosim.base.errors import ScenarioError

_HEX = re.compile(r"[0-9A-Fa-f]{2}|NN|U[124]")


@dataclass(frozen=True, slots=True)
class Raw:
    """A frame as hexadecimal bytes; ``NN``: the node, ``U4``: a value of 4 bytes, little endian."""

    id: int
    data: str
    step: int = 0

    def check(self, place: str) -> None:
        """Raise ScenarioError unless the text describes a frame of up to 8 bytes."""
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
    """The watchdog inside a drive. Without `write` and `read` it is set by other means."""

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

    def check(self, timeout: float, node: int, identifier: int, data: bytes) -> bool:
        """Whether a frame is the answer to `read`, with `timeout` (s) in it.

        Raises ScenarioError if it has another time-out: such a drive must not be armed.
        """
        found = None if self.reply is None else self.reply.value(node, identifier, data)
        if found is None:
            return False
        if found != self.raw(timeout):
            unit = to_si(self.unit, "s", "watchdog.unit")
            said = f"{found * unit:g} s" if found else "0, off"
            raise ScenarioError(f"node {node}: {self.register} reads {said}, not {timeout:g} s")
        return True
