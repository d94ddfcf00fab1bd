"""A bus by name and options as python-can users know them, attached to a node.

``socketcan`` goes the native way: the tick reads and writes the socket. Everything else is a
python-can bus between two threads and two rings: one thread receives (arrival is stamped when
python-can gives the frame), one sends. Options come from the deployment, then from the environment
(``CAN_INTERFACE``, ``CAN_CHANNEL`` ...) and python-can's files (``can.conf``, ``~/.canrc``).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from socket import socket as Socket
from typing import Any, NoReturn, Protocol, final

import can
from can.cli import add_bus_arguments
from can.util import load_config

from bridge.can.health import BusHealth, bus_health
from bridge.can.multicast import open_group
from bridge.can.socket import BusError, open_socket
from bridge.can.threaded import RingedInterface
from bridge.native.bus import Accept, Bus
from bridge.native.frame import Flags
from bridge.native.journal import Journal


@dataclass(frozen=True)
class CanBusSpec:
    """A bus by python-can's names. What is "" or None comes from python-can's configuration."""

    name: str
    """In the deployment, for messages and logs."""
    interface: str = ""
    channel: str = ""
    fd: bool = False
    bitrate: int | None = None
    """bit/s; of a socketcan interface the kernel's (`ip link`) is used."""
    data_bitrate: int | None = None
    local: bool = True
    """udp_multicast stays on the loopback interface."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the python-can bus."""
    capacity: int = 8192
    """Frames that fit into each ring (not socketcan), a power of two."""


class Attachment(Protocol):
    """An open bus: `bus` for the tick, `health` for all other code."""

    @property
    def bus(self) -> Bus:
        """The bus as the tick sees it."""

    def health(self, now_ns: int) -> BusHealth:
        """State and counts at `now_ns` (monotonic)."""

    def close(self) -> None:
        """Send what waits, and let go of it."""


def attach(
    spec: CanBusSpec,
    *,
    number: int = 0,
    log: Journal | None = None,
    accepts: Sequence[Accept] | None = None,
) -> Attachment:
    """Open a bus. `number`: of the bus in its node; `accepts`: accepted frames, None: all.

    Without a log, driver and kernel drop the other frames; with a log, these are logged first.

    Raises BusError, which names what is missing: interface, channel, driver, permission.
    """
    config = configuration(spec)
    if config["interface"] == "socketcan":
        return SocketAttachment(spec.name, config, number, log, accepts)
    return InterfaceAttachment(spec, config, number, log, accepts)


def configuration(spec: CanBusSpec) -> dict[str, Any]:
    """The arguments of `can.Bus` for a bus, combined with python-can's own configuration.

    Raises BusError if the interface is missing or unknown to python-can.
    """
    given = {
        "interface": spec.interface or None, "channel": spec.channel or None,
        "bitrate": spec.bitrate, "data_bitrate": spec.data_bitrate, "fd": spec.fd or None,
    }  # fmt: skip
    given = {key: value for key, value in given.items() if value is not None}
    try:
        config = dict(load_config(config={**given, **spec.options}))
    except (can.CanError, ValueError, KeyError) as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise BusError(f"bus {spec.name}: {error}; python-can supports {known}") from error
    if config["interface"] == "socketcan" and not config.get("channel"):
        raise BusError(f'bus {spec.name}: socketcan without a channel; expected one like "can0"')
    return config


def parse_spec(name: str, arguments: Sequence[str], prefix: str | None = None) -> CanBusSpec:
    """A bus from python-can's command-line options (``-i``, ``-c``, ``--fd`` and so on).

    Raises BusError for what python-can's parser does not take.
    """
    parser = _Parser(prog=name, add_help=False, exit_on_error=False)
    add_bus_arguments(parser, prefix=prefix)
    try:
        found = vars(parser.parse_args(list(arguments)))
    except argparse.ArgumentError as error:
        raise BusError(f"bus {name}: {error}") from error
    start = f"{prefix}_" if prefix else ""
    values = {key.removeprefix(start): value for key, value in found.items()}
    options: dict[str, Any] = dict(values.pop("bus_kwargs", {}))
    own = ("interface", "channel", "fd", "bitrate", "data_bitrate")
    known = {key: values.pop(key) for key in own if key in values}
    if "local" in options:
        known["local"] = bool(options.pop("local"))
    return CanBusSpec(name, **known, options={**values, **options})


@final
class SocketAttachment:
    """A SocketCAN interface, read and written by the tick itself."""

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any],
        number: int,
        log: Journal | None,
        accepts: Sequence[Accept] | None,
    ) -> None:
        self._name, self._channel = name, str(config["channel"])
        fd = bool(config.get("fd", False))
        early = accepts if log is None else None
        self._socket: Socket = open_socket(self._channel, fd=fd, accepts=early)
        self.bus = Bus.from_socket(self._socket.fileno(), number, log, accepts=accepts)

    def health(self, now_ns: int) -> BusHealth:
        """State and counts at `now_ns` (monotonic), with the interface's own."""
        return bus_health(self.bus, self._name, now_ns, self._channel)

    def close(self) -> None:
        """Close the socket; what was sent has gone to the kernel."""
        self._socket.close()


@final
class InterfaceAttachment:
    """Any other python-can bus."""

    def __init__(
        self,
        spec: CanBusSpec,
        config: Mapping[str, Any],
        number: int,
        log: Journal | None,
        accepts: Sequence[Accept] | None,
    ) -> None:
        self._name = spec.name
        device = open_device(spec, config)
        if accepts is not None and log is None:
            device.set_filters([_filter(accept) for accept in accepts])
        self._ringed = RingedInterface(device, number, log, accepts, spec.capacity)
        self.bus = self._ringed.bus

    def health(self, now_ns: int) -> BusHealth:
        """State and counts at `now_ns` (monotonic)."""
        return self._ringed.health(self._name, now_ns)

    def close(self) -> None:
        """Send what waits, end the threads, shut the python-can bus down."""
        self._ringed.close()


def open_device(spec: CanBusSpec, config: Mapping[str, Any]) -> can.BusABC:
    """The python-can bus of `spec`; `config`: of :func:`configuration`. Raises BusError."""
    arguments = {key: value for key, value in config.items() if key != "interface"}
    try:
        if config["interface"] == "udp_multicast" and ":" not in str(config.get("channel") or ""):
            return open_group(**{"fd": spec.fd, **arguments, "local": spec.local})
        if config["interface"] == "udp_multicast" and spec.local:
            raise BusError(
                f"udp_multicast {config['channel']}: an IPv6 group does not stay on the loopback "
                "interface; expected an IPv4 group, or local = false"
            )
        return can.Bus(**config)
    except Exception as error:  # drivers raise what they like: NameError for a missing library
        raise BusError(f"bus {spec.name} ({config['interface']}): {error}") from error


def _filter(accept: Accept) -> Any:
    found = {"can_id": accept.id, "can_mask": accept.mask}
    if accept.flag_mask & Flags.EXTENDED:
        found["extended"] = bool(accept.flags & Flags.EXTENDED)
    return found


@final
class _Parser(argparse.ArgumentParser):
    """Errors are raised, not printed."""

    def error(self, message: str) -> NoReturn:
        raise argparse.ArgumentError(None, message)
