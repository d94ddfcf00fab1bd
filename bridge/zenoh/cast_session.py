"""One session that stands for all nodes of a bus but one: raw payloads out, and those of that node.

It listens where the other nodes listen, connects to where the one node listens, has the tokens of
the others, and subscribes to everything that the one node publishes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import final

import zenoh

from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import names_of
from bridge.native.frame import DATA, Frame
from bridge.zenoh.channel import control_publisher
from bridge.zenoh.node_channel import rules_of, traffic_of
from bridge.zenoh.options import options_of
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.clock import monotonic_ns
from cosim.base.copies import replace


@final
class CastSession:
    """All nodes of `bus` but `node`. `arrived(frame, t_ns)` gets what `node` publishes.

    Frames have the numbers of :mod:`bridge.deployment.zenoh_keys`. Raises BusError, ScenarioError.
    """

    def __init__(
        self, system: System, bus: str, node: str, arrived: Callable[[Frame, int], None]
    ) -> None:
        d, names = system.deployment, names_of(system.deployment, bus)
        others = [n for n in d.nodes if n != node and bus in system.buses_of(n)]
        ends = {n: options_of(d, bus, n) for n in (node, *others)}
        options = replace(
            ends[others[0]] if others else ends[node],
            listen=tuple(e for n in others for e in ends[n].listen),
            connect=tuple(
                dict.fromkeys((*ends[node].listen, *(e for n in others for e in ends[n].connect)))
            ),
        )
        own = {e for n in others for e in ends[n].listen}
        options = replace(options, connect=tuple(e for e in options.connect if e not in own))
        config = configure(options, others[0] if others else node, rules_of(system, bus))
        if not options.listen:
            config.insert_json5("listen/endpoints", json.dumps([]))
        self._session = open_session(config, bus)
        self._reliability = options.reliability
        self._publishers: dict[str, zenoh.Publisher] = {}
        theirs = traffic_of(system, bus, node)
        self._keys = {number: key for key, number in theirs.hears.items()}
        self._subscribers = [
            self._session.declare_subscriber(
                key, _receiver(number, arrived), allowed_origin=zenoh.Locality.REMOTE
            )
            for key, number in theirs.publishes.items()
        ]
        for key in self._keys.values():
            self._publisher(key)
        token = self._session.liveliness().declare_token
        self._tokens = [token(names.of(n, what)) for n in others for what in ("alive", "ready")]

    def _publisher(self, key: str) -> zenoh.Publisher:
        if key not in self._publishers:
            self._publishers[key] = control_publisher(self._session, key, self._reliability)
        return self._publishers[key]

    def send(self, frame: Frame) -> None:
        """Publish the data of a frame under the key of its number; unknown ones under a new key."""
        number = int(frame.id)
        self._publisher(self._keys.get(number, f"foreign/{number}")).put(frame.payload)

    def close(self) -> None:
        """Close the session."""
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        close_session(self._session)


def _receiver(
    number: int, arrived: Callable[[Frame, int], None]
) -> zenoh.handlers.Callback[zenoh.Sample]:
    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        arrived(Frame.of(number, sample.payload.to_bytes()[:DATA], 0, t_ns), t_ns)

    return zenoh.handlers.Callback(came, indirect=False)
