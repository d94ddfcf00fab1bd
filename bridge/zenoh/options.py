"""Options of a Zenoh bus in a deployment, in addition to its configuration file, checked.

``options`` of ``[buses.NAME]``:

``listen``       endpoints by node: ``{ master = "tcp/127.0.0.1:7461" }``, one or a list
``connect``      endpoints, by node or for all; not said: those the nodes before it listen on
``keys``         folder of certificates, beside the deployment (``{keys}`` in the configuration)
``reliability``  ``best-effort`` (default) or ``reliable``, of the messages
``wait``         how long a node waits for its peers before it says ready; 0: not at all.
                 In lock-step also for a sample
``lockstep``     no clock: nodes advance as samples arrive, of which none is dropped
``lookahead``    in lock-step: nodes run ahead by the least delay of their links (default: true)
``insecure``     allow endpoints beyond this machine without TLS
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bridge.deployment.spec import Deployment
from cosim.base.errors import ScenarioError

PROTOCOLS = ("tcp", "udp", "tls", "quic", "unixsock-stream", "ws")
ENCRYPTED = ("tls", "quic")
RELIABILITY = ("best-effort", "reliable")
KNOWN = ("listen", "connect", "keys", "reliability", "wait", "insecure", "lockstep", "lookahead")


@dataclass(frozen=True, slots=True)
class ZenohOptions:
    """The options of one node's end of a bus; `place`: their position in the file."""

    place: str
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    config: Path | None = None
    keys: Path = field(default_factory=Path)
    reliability: str = "best-effort"
    wait: float = 30.0
    insecure: bool = False
    lockstep: bool = False
    lookahead: bool = True


def options_of(deployment: Deployment, bus: str, node: str) -> ZenohOptions:
    """The options a node opens a bus with. Raises ScenarioError with the place of what is wrong."""
    spec, place = deployment.buses[bus], deployment.place("buses", bus, "options")
    given = spec.options
    for key in given:
        if key not in KNOWN:
            raise ScenarioError(f"unknown key {key!r}; expected one of {', '.join(KNOWN)}", place)
    listen = _by_node(given.get("listen", {}), deployment, f"{place}.listen")
    config = deployment.file(spec.zenoh) if spec.zenoh else None
    if config is not None and not config.is_file():
        raise ScenarioError(
            f"no file {config}; expected a Zenoh configuration (JSON5)",
            deployment.place("buses", bus, "zenoh"),
        )
    found = ZenohOptions(
        place,
        listen=listen.get(node, ()),
        connect=_connect(given.get("connect"), deployment, node, listen, f"{place}.connect"),
        config=config,
        keys=deployment.file(_text(given.get("keys", "keys"), f"{place}.keys")),
        reliability=_text(given.get("reliability", "best-effort"), f"{place}.reliability"),
        wait=deployment.seconds(given.get("wait", 30.0), "buses", bus, "options", "wait"),
        insecure=_switch(given.get("insecure", False), f"{place}.insecure"),
        lockstep=_switch(given.get("lockstep", False), f"{place}.lockstep"),
        lookahead=_switch(given.get("lookahead", True), f"{place}.lookahead"),
    )
    if found.reliability not in RELIABILITY:
        raise ScenarioError(
            f"{found.reliability!r}; expected {' or '.join(RELIABILITY)}", f"{place}.reliability"
        )
    for endpoint in found.listen:
        check_endpoint(endpoint, f"{place}.listen.{node}", insecure=found.insecure)
    for endpoint in found.connect:
        check_endpoint(endpoint, f"{place}.connect", insecure=found.insecure)
    return found


def _text(value: object, place: str) -> str:
    if not isinstance(value, str):
        raise ScenarioError(f"{value!r}; expected a text", place)
    return value


def _switch(value: object, place: str) -> bool:
    if not isinstance(value, bool):
        raise ScenarioError(f"{value!r}; expected true or false", place)
    return value


def _endpoints(value: object, place: str) -> tuple[str, ...]:
    listed = [value] if isinstance(value, str) else value
    if not isinstance(listed, Sequence) or not all(isinstance(x, str) for x in listed):
        raise ScenarioError(f"{value!r}; expected an endpoint or a list of endpoints", place)
    return tuple(listed)


def _by_node(value: object, deployment: Deployment, place: str) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, dict):
        raise ScenarioError(f"{value!r}; expected endpoints by node", place)
    for node in value:
        if node not in deployment.nodes:
            known = ", ".join(sorted(deployment.nodes))
            raise ScenarioError(f"no node {node!r}; there are: {known}", place)
    return {node: _endpoints(x, f"{place}.{node}") for node, x in value.items()}


def _connect(
    value: Any,
    deployment: Deployment,
    node: str,
    listen: Mapping[str, tuple[str, ...]],
    place: str,
) -> tuple[str, ...]:
    """The given endpoints; else those of earlier nodes, so that each pair connects once."""
    if isinstance(value, dict):
        return _by_node(value, deployment, place).get(node, ())
    if value is not None:
        return _endpoints(value, place)
    order = list(deployment.nodes)
    before = order[: order.index(node)] if node in order else order
    return tuple(e for other in before for e in listen.get(other, ()))


def endpoints_of(deployment: Deployment, bus: str) -> tuple[str, ...]:
    """Endpoints for a client that is not a node. Raises ScenarioError.

    A router to which all nodes connect, else the endpoints on which they listen, else those to
    which they connect.
    """
    given, place = deployment.buses[bus].options, deployment.place("buses", bus, "options")
    value = given.get("connect")
    if value is not None and not isinstance(value, dict):
        return _endpoints(value, f"{place}.connect")
    found = _by_node(given.get("listen", {}), deployment, f"{place}.listen")
    if not any(found.values()):
        found = _by_node(value or {}, deployment, f"{place}.connect")
    return tuple(dict.fromkeys(e for endpoints in found.values() for e in endpoints))


def check_endpoint(endpoint: str, place: str, *, insecure: bool) -> None:
    """Check protocol and address; unless `insecure`, other machines need encryption to reach it.

    Raises ScenarioError.
    """
    protocol, slash, rest = endpoint.partition("/")
    if not slash or protocol not in PROTOCOLS:
        raise ScenarioError(
            f"{endpoint!r}: unknown protocol {protocol!r}; expected PROTOCOL/ADDRESS with one of "
            f"{', '.join(PROTOCOLS)}",
            place,
        )
    address = rest.partition("?")[0].partition("#")[0]
    if protocol == "unixsock-stream":
        if not address:
            raise ScenarioError(f"{endpoint!r} has no path", place)
        return
    host, colon, port = address.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise ScenarioError(f"{endpoint!r}: {address!r}; expected HOST:PORT", place)
    if protocol not in ENCRYPTED and not insecure and not is_loopback(host):
        raise ScenarioError(
            f"{endpoint!r} is reachable from other machines without encryption; "
            "expected tls/ or quic/, or insecure = true",
            place,
        )


def is_loopback(host: str) -> bool:
    """True if an address is of this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
