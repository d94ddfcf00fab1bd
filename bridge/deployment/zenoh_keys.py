"""Keys and numbers of what travels on a Zenoh bus.

=====================================  ======================================================
``PREFIX/NODE/COMPONENT/MESSAGE``      a message of the deployment
``PREFIX/NODE/heartbeat``              state of a node
``PREFIX/NODE/alive``                  liveliness token: there while the node's session is
``PREFIX/NODE/ready``                  the same: the node has heard all it needs, and may start
``PREFIX/NODE/state`` ...              queryables, see :mod:`bridge.zenoh.remote_control`
``PREFIX/nmt``, ``PREFIX/estop``       commands to nodes; stop, everybody
``PREFIX/epoch``                       which run this is, and when its t = 0 was
=====================================  ======================================================

Inside a process a frame has a number instead of a key; it does not travel.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bridge.can.codec import Codec
from bridge.can.layout import stream
from bridge.deployment.spec import Deployment, NodeSpec
from bridge.native.epoch import IDENTITY as EPOCH_IDENTITY
from bridge.native.epoch import SIGNALS as EPOCH_SIGNALS
from cosim.base.errors import ScenarioError

#: Numbers of messages begin here, above all 11-bit identifiers.
FIRST = 0x1000
NMT, ESTOP, EPOCH, HEARTBEAT = 0x000, 0x001, 0x002, 0x700
_CHUNK = re.compile(r"[A-Za-z0-9_.-]+")


@dataclass(frozen=True, slots=True)
class Names:
    """Keys of one bus below `prefix`."""

    prefix: str

    def message(self, node: str, component: str, message: str) -> str:
        """Key of a message of the deployment."""
        return f"{self.prefix}/{node}/{component}/{message}"

    def of(self, node: str, what: str) -> str:
        """Key of something of one node: heartbeat, alive, state, arm, stop, parameters."""
        return f"{self.prefix}/{node}/{what}"

    def shared(self, what: str) -> str:
        """Key of something that all nodes share: nmt, estop, epoch."""
        return f"{self.prefix}/{what}"

    def senders(self, keys: Iterable[str]) -> dict[str, str]:
        """The node that publishes each key; keys without a fixed publisher are not included."""
        chunks = {key: key.removeprefix(f"{self.prefix}/").split("/") for key in keys}
        return {key: found[0] for key, found in chunks.items() if len(found) > 1}


def names_of(deployment: Deployment, bus: str) -> Names:
    """The keys of a bus; the default prefix is the deployment's name.

    Raises ScenarioError for characters that are not allowed in a key.
    """
    prefix = deployment.buses[bus].prefix or deployment.name
    for chunk in prefix.split("/"):
        check_chunk(chunk, deployment.place("buses", bus, "prefix"))
    for node, spec in deployment.nodes.items():
        for name in (node, *spec.components):
            check_chunk(name, deployment.place("nodes", node))
    for name in deployment.messages:
        check_chunk(name, deployment.place("messages", name))
    return Names(prefix)


def check_chunk(chunk: str, place: str) -> None:
    """Raise ScenarioError for what cannot be part of a key."""
    if not _CHUNK.fullmatch(chunk):
        raise ScenarioError(
            f"{chunk!r} cannot be part of a key; expected letters, digits, '_', '.' or '-'", place
        )


def data_id(key: str) -> int:
    """The number that identifies the message of a key: CRC-32 (IEEE 802.3) of the key in UTF-8."""
    return zlib.crc32(key.encode())


def codec(key: str, number: int, signals: Sequence[str]) -> Codec:
    """A message of this key: Profile 4, status, time stamp, float64 values."""
    return Codec(stream(key, number, data_id(key), signals))


def numbers(deployment: Deployment, bus: str) -> Mapping[str, int]:
    """The numbers of the messages on a bus, by name, in their order."""
    there = sorted(name for name, m in deployment.messages.items() if m.bus == bus)
    return {name: FIRST + i for i, name in enumerate(there)}


def heartbeat(names: Names, node: str, spec: NodeSpec) -> Codec:
    """State, reasons, boots, armed of a node."""
    signals = ("state", "reasons", "boots", "armed")
    return codec(names.of(node, "heartbeat"), HEARTBEAT + spec.number, signals)


def nmt(names: Names) -> Codec:
    """A command (``NMT_`` of ``node.h``) to the node of a number, 0: all."""
    return codec(names.shared("nmt"), NMT, ("command", "node"))


def estop(names: Names) -> Codec:
    """Stop, from the node of a number, for these reasons."""
    return codec(names.shared("estop"), ESTOP, ("node", "reasons"))


def epoch(names: Names) -> Codec:
    """The message on which run this is, and when its t = 0 was: ``bridge/c/epoch.h``."""
    return codec(names.shared("epoch"), EPOCH, (*EPOCH_SIGNALS, *EPOCH_IDENTITY))
