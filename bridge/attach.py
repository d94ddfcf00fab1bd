"""A node's buses, opened as its deployment says."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deploy import BusSpec, Deployment
from bridge.journal import Journal
from bridge.native.frame import frame_dtype
from bridge.system import System
from cosim.errors import ScenarioError

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
        for number, name in enumerate(system.buses_of(node)):
            if system.deployment.buses[name].kind != "can":
                raise ScenarioError(
                    f'kind = "{system.deployment.buses[name].kind}" is not known here',
                    system.deployment.place("buses", name),
                )
            log = Journal.create(folder / f"{life}.{name}.frames", frame_dtype(64), rows)
            stack.callback(log.close)
            opened = interface.attach(can_spec(system.deployment, name), number=number, log=log)
            stack.callback(opened.close)
            found[name] = opened
        yield found
