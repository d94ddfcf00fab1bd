"""A passive listener on a Zenoh bus: it publishes nothing, has no token and answers no query.

A node becomes ready when each of its messages has a subscriber, including this listener. The
listener therefore first subscribes only to tokens and heartbeats. A node that sends heartbeats no
longer waits, so its messages are subscribed to from its first heartbeat until its token disappears.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import final

import zenoh

from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import Names, names_of
from bridge.native.bus import TrafficStruct, traffic_add
from bridge.native.frame import DATA, Frame, Ring
from bridge.native.mail import frame_writer, keep_thread
from bridge.zenoh.access import MONITOR
from bridge.zenoh.batches import samples_of
from bridge.zenoh.node_channel import rules_of, traffic_of
from bridge.zenoh.options import ZenohOptions, check_endpoint, endpoints_of, options_of
from bridge.zenoh.presence import Presence
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError

#: Samples kept between two looks, a power of two.
CAPACITY = 8192


@final
class ZenohEar:
    """A separate session that receives the messages of nodes on a bus.

    `says`: keys and numbers of frames, by node; `rules`: permissions of publishers. Raises
    ScenarioError, BusError.
    """

    def __init__(
        self,
        bus: str,
        names: Names,
        says: Mapping[str, Mapping[str, int]],
        options: ZenohOptions,
        rules: Mapping[str, object],
        who: str = MONITOR,
    ) -> None:
        self._says, self._options = says, options
        beats = {node: names.of(node, "heartbeat") for node in says}
        self._beats = {says[n][key]: n for n, key in beats.items() if key in says[n]}
        self._beating: set[str] = set()
        self._ring = Ring(CAPACITY)
        self.traffic = TrafficStruct()
        self.session = open_session(_configured(options, who, rules), bus)
        self.presence = Presence(self.session, names, "")  # it declares no token
        self._first = [self._subscribe(beats[n], number) for number, n in self._beats.items()]
        self._messages: dict[str, list[zenoh.Subscriber[None]]] = {}

    @property
    def nodes(self) -> Mapping[str, bool]:
        """The nodes of the bus whose tokens are present."""
        there = self.presence.there
        return {node: node in there for node in self._says}

    @property
    def note(self) -> str:
        """The connected sessions, or the endpoints that it tries."""
        found = len(self.session.info.peers_zid()) + len(self.session.info.routers_zid())
        if not found:
            tried = ", ".join(self._options.connect) or "whom scouting finds"
            return f"nobody connected; tries {tried}"
        blind = "; lock-step: only who is there" if self._options.lockstep else ""
        return f"{found} connected{blind}"

    def drain(self) -> list[Frame]:
        """All frames that have come since the last time."""
        found: list[Frame] = []
        while self._ring.get(frame := Frame()):
            found.append(frame)
            traffic_add(self.traffic, frame)
            if frame.id in self._beats:
                self._beating.add(self._beats[frame.id])
        return found

    def follow(self) -> bool:
        """Subscribe to nodes that wait no more, leave those that have gone; whether any came."""
        self._beating &= self.presence.there
        new = self._beating - self._messages.keys()
        for node in new:
            others = {k: n for k, n in self._says[node].items() if n not in self._beats}
            self._messages[node] = [self._subscribe(k, n) for k, n in others.items()]
        for node in self._messages.keys() - self._beating:
            for subscriber in self._messages.pop(node):
                subscriber.undeclare()  # type: ignore[no-untyped-call]
        return bool(new)

    def close(self) -> None:
        """Close the session."""
        close_session(self.session)

    def _subscribe(self, key: str, number: int) -> zenoh.Subscriber[None]:
        """Subscribe to a key, whose payloads are frames of this number."""
        bring = frame_writer(self._ring, number)

        def receive(sample: zenoh.Sample) -> None:
            keep_thread()
            for data in samples_of(sample):
                bring(data[:DATA])

        return self.session.declare_subscriber(
            key,
            zenoh.handlers.Callback(receive, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )


def open_listener(
    system: System, bus: str, connect: Sequence[str] = (), who: str = MONITOR
) -> ZenohEar:
    """Listen to all nodes of a Zenoh bus. `connect`: endpoints other than the deployment's.

    `who`: name of the certificate, if TLS is enabled. Raises ScenarioError, BusError.
    """
    d = system.deployment
    names = names_of(d, bus)
    nodes = [n for n in d.nodes if bus in system.buses_of(n)]
    shared = {names.shared(what) for what in ("estop", "nmt", "epoch")}
    says = {
        node: {k: n for k, n in traffic_of(system, bus, node).publishes.items() if k not in shared}
        for node in nodes
    }
    options = options_of(d, bus, who)
    for endpoint in connect:
        check_endpoint(endpoint, "--connect", insecure=options.insecure)
    where = tuple(connect) or endpoints_of(d, bus)
    options = replace(options, listen=(), connect=where)
    return ZenohEar(bus, names, says, options, rules_of(system, bus), who)


def _configured(options: ZenohOptions, who: str, rules: Mapping[str, object]) -> zenoh.Config:
    """Listens nowhere; a peer also of routers, since a client waits for one before it opens."""
    config = configure(options, who, rules)
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", "[]")
    scouts = json.loads(config.get_json("scouting/multicast/enabled"))
    if not json.loads(config.get_json("connect/endpoints")) and not scouts:
        raise ScenarioError(
            "no address to connect to; expected options.listen or options.connect, or --connect",
            options.place,
        )
    return config
