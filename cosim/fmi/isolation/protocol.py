"""Calls between a run and the process of an isolated FMU, other than steps: MessagePack with types.

The types are those of the functions that are called: members of
:class:`cosim.fmi.library.Instance`, and of :class:`WorkerCalls`. Nothing else can be received.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Protocol, get_type_hints

import msgspec

from cosim.base.errors import FmuError
from cosim.fmi.layout import StepLayout
from cosim.fmi.library import Instance, Setup


class WorkerCalls(Protocol):
    """The calls of the process beside those of its FMU."""

    def ready(self) -> None:
        """It runs."""

    def start(self, setup: Setup, room: int, limit: int) -> None:
        """Instantiate; `room`: bytes of the log, `limit`: MB of memory more than now, 0 for any."""

    def rest(self) -> bool:
        """Free the FMU; whether this process may have another instance: nothing went wrong."""

    def bind(self, layout: StepLayout) -> None:
        """Get ready to step."""

    def serialized(self) -> bytes:
        """The state of the FMU as bytes, after that of the structs which step it."""

    def set_serialized(self, data: bytes) -> None:
        """Go to a state that was serialized."""

    def late_clock_ticks(self) -> tuple[int, float]:
        """Number of late clock ticks, and their greatest delay (s)."""


def is_own(name: str) -> bool:
    """True if the process itself executes a call, and not its FMU."""
    return name in vars(WorkerCalls)


@cache
def _types(name: str) -> tuple[Any, Any]:
    """Types of a function's arguments and of what it returns. Raises FmuError for no such."""
    owner: Any = WorkerCalls if is_own(name) else Instance
    if name.startswith("_") or name not in vars(owner):
        raise FmuError(f"no call {name!r} of an isolated FMU is known")
    hints = get_type_hints(vars(owner)[name])
    result = hints.pop("return")
    return tuple[tuple(hints.values())] if hints else tuple[()], result  # type: ignore[misc]


def _path(kind: Any, value: Any) -> Any:
    """The only type that MessagePack lacks."""
    if kind is not Path:
        raise NotImplementedError(kind)
    return Path(value)


def request(name: str, arguments: tuple[Any, ...]) -> bytes:
    """The message that asks for a call."""
    return name.encode() + b"\0" + msgspec.msgpack.encode(arguments, enc_hook=str)


def requested(message: bytes) -> tuple[str, tuple[Any, ...]]:
    """The call that a message asks for. Raises FmuError or msgspec.ValidationError."""
    name, _, packed = message.partition(b"\0")
    types, _ = _types(name.decode())
    return name.decode(), msgspec.msgpack.decode(packed, type=types, dec_hook=_path)


def answer(value: Any) -> bytes:
    """The message with what a call returned."""
    return b"r" + msgspec.msgpack.encode(value, enc_hook=str)


def refusal(text: str) -> bytes:
    """The message that a call failed."""
    return b"e" + text.encode()


def answered(name: str, message: bytes) -> Any:
    """The result of a call. Raises FmuError with the text if it failed."""
    if message[:1] == b"e":
        raise FmuError(message[1:].decode("utf-8", "replace"))
    return msgspec.msgpack.decode(message[1:], type=_types(name)[1], dec_hook=_path)
