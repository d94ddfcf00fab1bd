"""Opening of a node's buses according to its deployment."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deployment.spec import BusSpec, Deployment
from bridge.deployment.system import System
from bridge.native.frame import DATA, frame_dtype
from bridge.native.journal import Journal
from bridge.node.control import Control
from bridge.node.missing_inputs import missing_before_start
from bridge.records.node_lives import Life
from bridge.simulated_can.attachment import SimulatedAttachment
from bridge.wiring.wiring import WiredNode

if TYPE_CHECKING:
    from bridge.zenoh.remote_control import Stoppable


#: The interface of a simulated bus.
SIMULATED = "cosim"
#: Multicast groups for buses whose channel is no address (administratively scoped, RFC 2365).
GROUP = "239.74.163.{}"


def can_spec(deployment: Deployment, name: str) -> interface.CanBusSpec:
    """A CAN bus of the deployment as :mod:`bridge.can.interface` opens it."""
    spec = deployment.buses[name]
    channel = spec.channel
    if spec.interface == "udp_multicast" and "." not in channel and ":" not in channel:
        channel = GROUP.format(2 + list(deployment.buses).index(name))
    options = spec.options
    if spec.interface == SIMULATED:
        options = {"queue": spec.queue, "tx_queue_size": spec.queue_length, **options}
    return interface.CanBusSpec(
        name,
        interface=spec.interface,
        channel=channel,
        fd=spec.fd,
        bitrate=spec.bitrate if _has_bitrate(spec) else None,
        data_bitrate=spec.data_bitrate if spec.fd and _has_bitrate(spec) else None,
        local=spec.local,
        options=options,
    )


def _has_bitrate(spec: BusSpec) -> bool:
    """True if the interface needs a bit rate; some have none, or the kernel sets it."""
    return spec.interface not in ("socketcan", "virtual", "udp_multicast")


@contextmanager
def open_buses(system: System, life: Life, folder: Path) -> Iterator[dict[str, Attachment]]:
    """All buses of a life's node, frames logged in ``FOLDER/LIFE.BUS.frames``. Raises BusError."""
    node = life.node
    with ExitStack() as stack:
        found: dict[str, Attachment] = {}
        opened: Attachment
        for number, name in enumerate(system.buses_of(node)):
            zenoh = system.deployment.buses[name].kind == "zenoh"
            size = DATA if zenoh else 64
            path, rows = folder / life.frames(name), system.log_rows(name)
            log = Journal.create(path, frame_dtype(size), rows)
            stack.callback(log.close)
            if zenoh:
                opened = _zenoh(system, name, node, number, log)
            elif system.deployment.clock == "simulated":
                opened = SimulatedAttachment(can_spec(system.deployment, name), number, log)
            else:
                opened = interface.attach(can_spec(system.deployment, name), number=number, log=log)
            if system.nodes[node].forwards:
                stack.callback(give_bell(opened))
            stack.callback(opened.close)
            found[name] = opened
        yield found


def give_bell(end: Attachment) -> Callable[[], None]:
    """Let a frame that another thread receives wake who waits for it; the function that ends this.

    Only Linux has it: elsewhere a gateway polls its rings every 0.5 ms (``bus_wait.c``).
    """
    if end.bus.rx is None or sys.platform != "linux":
        return lambda: None
    bell = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
    end.bus.rx.struct.bell = bell
    return lambda: os.close(bell)


def _zenoh(system: System, bus: str, node: str, number: int, log: Journal) -> Attachment:
    """A Zenoh bus, all peers there. Raises ScenarioError, BusError."""
    from bridge.zenoh.node_channel import open_bus

    opened = open_bus(system, bus, node, number=number, log=log)
    try:
        opened.wait_for_peers()
    except BaseException:
        opened.close()
        raise
    return opened


def announce(buses: Mapping[str, Attachment]) -> None:
    """Let it be seen on Zenoh buses that this node is ready."""
    for end in buses.values():
        if (ready := getattr(end, "ready", None)) is not None:
            ready()


def answer(wired: WiredNode, buses: Mapping[str, Attachment], control: Stoppable) -> None:
    """Let a node answer queries and accept commands on its Zenoh buses while they are open."""
    for name, end in buses.items():
        if wired.system.deployment.buses[name].kind == "zenoh":
            from bridge.zenoh import channel
            from bridge.zenoh import remote_control as answering

            assert isinstance(end, channel.ZenohAttachment)
            answering.serve(end, wired, control, missing_before_start)


def join_run(wired: WiredNode, buses: Mapping[str, Attachment], control: Control) -> bool:
    """Let a node join a run without a common date, by offsets measured over Zenoh.

    Returns False if no other node knows t = 0. It is never used with real drives.
    """
    for name, end in buses.items():
        if wired.system.deployment.buses[name].kind == "zenoh" and wired.struct.simulated:
            from bridge.zenoh import channel, offsets

            assert isinstance(end, channel.ZenohAttachment)
            found = offsets.measured_origin(end.session, end.names, wired.system)
            if found is not None:
                wired.struct.epoch.told, wired.struct.epoch.origin_ns = found
                control.start(found[1])
                return True
    return False
