"""A message of a deployment, and the subscriptions of a node on a bus."""

from __future__ import annotations

from dataclasses import dataclass

from bridge.deployment.cut import Outlet
from bridge.deployment.gateways import Forward
from bridge.deployment.services import Encoding
from bridge.native.bus import Accept


@dataclass(frozen=True, slots=True)
class Carried:
    """A message of the deployment: who sends it when, and how it is encoded.

    `offset_ns`: the sender's phase; `period_ns`: between two samples. `forward`: what it is made
    of, where a gateway sends it; numbers, phase and period are then its first sender's.
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
