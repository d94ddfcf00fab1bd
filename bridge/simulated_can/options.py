"""The options of a python-can bus on a simulated channel, checked: found, expected, where."""

from __future__ import annotations

import difflib
from collections.abc import Hashable, Iterable
from dataclasses import dataclass

import can

from cosim.base.errors import CosimError
from cosim.bus.settings import QueueKind
from cosim.bus.timing import BusTiming, TimingError

SIMULATED = "simulated"
"""The value of `speed` for a channel that reads no clock."""
MOST_QUEUED = 65535
"""Frames that a queue can hold."""


class ChannelOptionError(CosimError, can.CanInitializationError, ValueError):
    """An option of a simulated channel is wrong, or does not fit the channel that exists."""


class ChannelOperationError(CosimError, can.CanOperationError):
    """A simulated channel cannot do this: queue full, bus-off, closed, or no such frame."""


class ChannelTimeoutError(ChannelOperationError, can.CanTimeoutError):
    """A transmit queue stayed full."""


@dataclass(frozen=True, slots=True)
class ChannelOptions:
    """The common options of all buses of a channel. None: not said.

    `speed`: seconds of the channel in a second of the wall clock; 0: simulated time.
    """

    timing: BusTiming | None = None
    fd: bool | None = None
    data_bitrate: float | None = None
    speed: float | None = None
    error_rate: float | None = None
    seed: int | None = None


@dataclass(frozen=True, slots=True)
class PortOptions:
    """The options of each bus object. Lengths in frames; `rx_queue_size` 0: no limit."""

    queue: QueueKind = QueueKind.FIFO
    tx_queue_size: int = 1000
    rx_queue_size: int = 0
    receive_own_messages: bool = False
    bus_errors: bool = False
    auto_restart: bool = True
    one_shot: bool = False

    def __post_init__(self) -> None:
        for key, least in (("tx_queue_size", 1), ("rx_queue_size", 0)):
            found = getattr(self, key)
            if not least <= found <= MOST_QUEUED:
                raise ChannelOptionError(
                    f"found {key}={found}, expected {least} to {MOST_QUEUED} frames"
                )


def channel_options(
    name: Hashable,
    *,
    bitrate: float | str | None = None,
    data_bitrate: float | str | None = None,
    fd: bool | None = None,
    timing: can.BitTiming | can.BitTimingFd | None = None,
    speed: float | str | None = None,
    error_rate: float | None = None,
    seed: int | None = None,
) -> ChannelOptions:
    """Check the options of one bus object by themselves; bit rates in bit/s.

    Raises ChannelOptionError.
    """
    if isinstance(timing, can.BitTimingFd):
        if fd is False:
            raise ChannelOptionError(
                f"channel {name!r}: found fd=False with the timing of a CAN FD bus, expected "
                "fd=True"
            )
        fd, bitrate, data_bitrate = True, timing.nom_bitrate, timing.data_bitrate
    elif timing is not None:
        if fd:
            raise ChannelOptionError(
                f"channel {name!r}: found fd=True with the timing of a classic bus; expected a "
                "can.BitTimingFd"
            )
        fd, bitrate = False, timing.bitrate
    nominal = _number(name, "bitrate", bitrate)
    data = _number(name, "data_bitrate", data_bitrate)
    if data is not None and not fd:
        raise ChannelOptionError(
            f"channel {name!r}: found data_bitrate={data:g} on a classic bus, expected fd=True "
            "with it"
        )
    rate = _number(name, "error_rate", error_rate)
    if rate is not None and not 0 <= rate < 1:
        raise ChannelOptionError(
            f"channel {name!r}: found error_rate={rate:g}, expected 0 to less than 1"
        )
    return ChannelOptions(
        timing=None if nominal is None else _timing(name, nominal, data, bool(fd)),
        fd=fd,
        data_bitrate=data,
        speed=_speed(name, speed),
        error_rate=rate,
        seed=seed,
    )


def _timing(name: Hashable, nominal: float, data: float | None, fd: bool) -> BusTiming:
    try:
        return BusTiming(nominal, data, fd=fd)
    except TimingError as error:
        raise ChannelOptionError(f"channel {name!r}: {error}") from error


def _number(name: Hashable, key: str, value: float | str | None) -> float | None:
    if value is None:
        return None
    try:
        return float(value)
    except ValueError as error:
        raise ChannelOptionError(
            f"channel {name!r}: found {key}={value!r}, expected a number"
        ) from error


def _speed(name: Hashable, speed: float | str | None) -> float | None:
    if speed == SIMULATED:
        return 0.0
    try:
        number = None if speed is None else float(speed)
    except ValueError:
        number = 0.0
    if number is not None and not number > 0:
        raise ChannelOptionError(
            f'channel {name!r}: found speed={speed!r}, expected a number above 0 or "{SIMULATED}"'
        )
    return number


def queue_kind(name: Hashable, text: str) -> QueueKind:
    """The order of a transmit queue by its name; raises ChannelOptionError."""
    kinds = {kind.name.lower(): kind for kind in QueueKind}
    if text not in kinds:
        raise ChannelOptionError(
            f"channel {name!r}: found queue={text!r}, expected one of {', '.join(kinds)}"
        )
    return kinds[text]


def refuse_misspelt(name: Hashable, found: Iterable[str], known: Iterable[str]) -> None:
    """Raise ChannelOptionError for an unknown option that resembles a known one.

    Other unknown options are ignored: programs give options of other interfaces, too.
    """
    for key in found:
        near = difflib.get_close_matches(key, list(known), 1, 0.85)
        if near:
            raise ChannelOptionError(
                f"channel {name!r}: found the option {key!r}, expected {near[0]!r}"
            )


def agree(name: Hashable, there: ChannelOptions, new: ChannelOptions) -> None:
    """Raise ChannelOptionError where a further bus says something else than the channel is."""
    assert there.timing is not None
    said = {
        "bitrate": (there.timing.bitrate, new.timing and new.timing.bitrate, " bit/s"),
        "fd": (there.timing.fd, new.fd, ""),
        "data_bitrate": (there.data_bitrate, new.data_bitrate, " bit/s"),
        "speed": (there.speed, new.speed, ""),
        "error_rate": (there.error_rate, new.error_rate, ""),
        "seed": (there.seed, new.seed, ""),
    }
    for key, (old, other, unit) in said.items():
        if other is not None and other != old:
            raise ChannelOptionError(
                f"channel {name!r}: found {key}={_shown(key, other)}{unit}, expected "
                f"{_shown(key, old)}{unit} as the bus that opened the channel"
            )


def _shown(key: str, value: object) -> str:
    if key == "speed" and value == 0:
        return SIMULATED
    return f"{value:.15g}" if isinstance(value, float) else str(value)
