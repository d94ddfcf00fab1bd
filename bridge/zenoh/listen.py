"""Somebody who only listens on a Zenoh bus: publishes nothing, has no token, answers nothing.

A node is ready once somebody subscribes to each of its messages, and anybody counts. So at first
only tokens and heartbeats are listened to: a node that sends heartbeats waits no more, and its
messages are subscribed to from the first one until its token has gone.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import final

import zenoh

from bridge.native import pace
from bridge.native.bus import Traffic, traffic_add
from bridge.native.frame import DATA, Frame
from bridge.system import System
from bridge.zenoh.access import MONITOR, access_control
from bridge.zenoh.attach import traffic_of
from bridge.zenoh.names import Names, names_of
from bridge.zenoh.options import Options, check_endpoint, endpoints_of, options_of
from bridge.zenoh.presence import Presence
from bridge.zenoh.session import configure, open_session
from cosim.errors import ScenarioError

#: Samples kept between two looks.
CAPACITY = 65536


@final
class ZenohEar:
    """A session of its own that hears what nodes say on a bus.

    `says`: keys and numbers of frames, by node. Raises ScenarioError, BusError.
    """

    def __init__(
        self,
        bus: str,
        names: Names,
        says: Mapping[str, Mapping[str, int]],
        options: Options,
        who: str = MONITOR,
    ) -> None:
        self._names, self._says, self._options = names, says, options
        self._frames: deque[Frame] = deque(maxlen=CAPACITY)
        self._beating: set[str] = set()
        self._lock = threading.Lock()
        self.traffic = Traffic()
        self.session = open_session(_configured(options, who, names, says), bus)
        self.presence = Presence(self.session, names, "")  # it declares no token
        self._beats = [
            self._subscribe(key, says[node][key], node)
            for node in says
            if (key := names.of(node, "heartbeat")) in says[node]
        ]
        self._messages: dict[str, list[zenoh.Subscriber[None]]] = {}

    @property
    def nodes(self) -> Mapping[str, bool]:
        """Whose tokens are there, of all nodes of the bus."""
        there = self.presence.there
        return {node: node in there for node in self._says}

    @property
    def note(self) -> str:
        """Who is connected, or what is tried."""
        found = len(self.session.info.peers_zid()) + len(self.session.info.routers_zid())
        if not found:
            tried = ", ".join(self._options.connect) or "whom scouting finds"
            return f"nobody connected; tries {tried}"
        blind = "; lock-step: only who is there" if self._options.lockstep else ""
        return f"{found} connected{blind}"

    def drain(self) -> list[Frame]:
        """All frames that have come since the last time."""
        found = [self._frames.popleft() for _ in range(len(self._frames))]
        for frame in found:
            traffic_add(self.traffic, frame)
        return found

    def follow(self) -> bool:
        """Subscribe to nodes that wait no more, leave those that have gone; whether any came."""
        there, new = self.presence.there, False
        for node in self._says:
            with self._lock:
                if node not in there:
                    self._beating.discard(node)
                runs = node in self._beating
            if runs and node not in self._messages:
                beat = self._names.of(node, "heartbeat")
                own = {k: n for k, n in self._says[node].items() if k != beat}
                self._messages[node] = [self._subscribe(k, n, node) for k, n in own.items()]
                new = True
            elif not runs:
                for subscriber in self._messages.pop(node, []):
                    subscriber.undeclare()  # type: ignore[no-untyped-call]
        return new

    def close(self) -> None:
        """Close the session."""
        self.session.close()  # type: ignore[no-untyped-call]

    def _subscribe(self, key: str, number: int, node: str) -> zenoh.Subscriber[None]:
        """Frames of one key; of a heartbeat also that its node runs."""
        beat = key == self._names.of(node, "heartbeat")

        def receive(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()[:DATA]
            self._frames.append(Frame.of(number, data, 0, pace.now()))
            if beat and node not in self._beating:
                with self._lock:
                    self._beating.add(node)

        return self.session.declare_subscriber(
            key,
            zenoh.handlers.Callback(receive, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )


def open_ear(system: System, bus: str, connect: Sequence[str] = (), who: str = MONITOR) -> ZenohEar:
    """Listen to all nodes of a Zenoh bus. `connect`: endpoints other than the deployment's.

    `who`: name of the certificate, where there are any. Raises ScenarioError, BusError.
    """
    d = system.deployment
    names = names_of(d, bus)
    nodes = [n for n in d.nodes if bus in system.buses_of(n)]
    shared = {names.shared("estop"), names.shared("nmt")}
    says = {
        node: {k: n for k, n in traffic_of(system, bus, node).publishes.items() if k not in shared}
        for node in nodes
    }
    options = options_of(d, bus, who)
    for endpoint in connect:
        check_endpoint(endpoint, "--connect", insecure=options.insecure)
    where = tuple(connect) or endpoints_of(d, bus)
    options = replace(options, listen=(), connect=where)
    return ZenohEar(bus, names, says, options, who)


def _configured(
    options: Options, who: str, names: Names, nodes: Mapping[str, object]
) -> zenoh.Config:
    """Listens nowhere; a peer also of routers, since a client waits for one before it opens."""
    config = configure(options, who, access_control(names, nodes))
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", "[]")
    scouts = json.loads(config.get_json("scouting/multicast/enabled"))
    if not json.loads(config.get_json("connect/endpoints")) and not scouts:
        raise ScenarioError(
            "nowhere to connect to; expected options.listen or options.connect, or --connect",
            options.place,
        )
    return config
