"""A message of a deployment, and the subscriptions of a node on a bus."""

from __future__ import annotations

from dataclasses import dataclass

from bridge.deployment.cut import Outlet
from bridge.deployment.gateways import Forward
from bridge.deployment.services import Encoding
from bridge.native.bus import Accept


@dataclass(frozen=True, slots=True)
class Carried:
    """A message of the deployment: its sender, its times and its encoding.

    `offset_ns`: phase of the sender, ns; `period_ns`: time between two samples, ns. `forward`: the
    message from which a gateway makes it; numbers, phase and period are then those of the first
    sender.
    """

    name: str
    bus: str
    node: str
    outlet: Outlet
    encoding: Encoding
    period_ns: int
    offset_ns: int
    max_age_ns: int
    forward: Forward | None = None


@dataclass(frozen=True, slots=True)
class Subscription:
    """A message or service that a node listens to on a bus, and which frames are it."""

    bus: str
    name: str
    accept: Accept
