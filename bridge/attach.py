"""A node's buses, opened as its deployment says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.can.socket import BusError
from bridge.deploy import BusSpec, Deployment
from bridge.journal import Journal
from bridge.native.frame import DATA, frame_dtype
from bridge.system import System
from bridge.wiring import Wired


class Stoppable(Protocol):
    """What stops a node: :class:`bridge.node.Control`."""

    def stop(self) -> None:
        """Ramp down and stop."""


#: Multicast groups for buses whose channel is no address (administratively scoped, RFC 2365).
GROUP = "239.74.163.{}"
#: Frames a second a log has room for, a bus and node.
FRAMES = 8000


def can_spec(deployment: Deployment, name: str) -> interface.BusSpec:
    """A CAN bus of the deployment as :mod:`bridge.can.interface` opens it."""
    spec = deployment.buses[name]
    channel = spec.channel
    if spec.interface == "udp_multicast" and "." not in channel and ":" not in channel:
        channel = GROUP.format(2 + list(deployment.buses).index(name))
    return interface.BusSpec(
        name,
        interface=spec.interface,
        channel=channel,
        fd=spec.fd,
        bitrate=spec.bitrate if _has_bitrate(spec) else None,
        data_bitrate=spec.data_bitrate if spec.fd and _has_bitrate(spec) else None,
        local=spec.local,
        options=spec.options,
    )


def _has_bitrate(spec: BusSpec) -> bool:
    """Whether the interface is told its bit rate: not those that have none, or the kernel's."""
    return spec.interface not in ("socketcan", "virtual", "udp_multicast")


def log_rows(seconds: float) -> int:
    """Rows of the log of a bus for a run of so many seconds."""
    return int(min(FRAMES * (seconds + 10.0), 4e6))


@contextmanager
def attached(system: System, node: str, folder: Path, life: str) -> Iterator[dict[str, Attachment]]:
    """All buses of a node, every frame logged in ``FOLDER/LIFE.BUS.frames``. Raises BusError."""
    rows = log_rows(system.plan.ticks * system.plan.h)
    with ExitStack() as stack:
        found: dict[str, Attachment] = {}
        opened: Attachment
        for number, name in enumerate(system.buses_of(node)):
            zenoh = system.deployment.buses[name].kind == "zenoh"
            size = DATA if zenoh else 64
            log = Journal.create(folder / f"{life}.{name}.frames", frame_dtype(size), rows)
            stack.callback(log.close)
            if zenoh:
                opened = _zenoh(system, name, node, number, log)
            else:
                opened = interface.attach(can_spec(system.deployment, name), number=number, log=log)
            stack.callback(opened.close)
            found[name] = opened
        yield found


def _zenoh(system: System, bus: str, node: str, number: int, log: Journal) -> Attachment:
    """A Zenoh bus, all peers there. Raises ScenarioError, BusError, also without Zenoh."""
    try:
        from bridge.zenoh.attach import open_bus
    except ImportError as error:
        raise BusError(
            f"bus {bus}: no Zenoh here ({error}); install cosim-bridge[zenoh]"
        ) from error
    opened = open_bus(system, bus, node, number=number, log=log)
    try:
        opened.wait_for_peers()
    except BaseException:
        opened.close()
        raise
    return opened


def answer(wired: Wired, buses: Mapping[str, Attachment], control: Stoppable) -> None:
    """Let a node be asked and told over its Zenoh buses, as long as they are open."""
    for name, end in buses.items():
        if wired.system.deployment.buses[name].kind == "zenoh":
            from bridge.zenoh import channel
            from bridge.zenoh import remote as answering

            assert isinstance(end, channel.ZenohAttachment)
            answering.serve(end, wired, control)
