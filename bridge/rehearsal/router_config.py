"""Zenoh configurations of the routers of hosts, and of the nodes behind them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: s for which a busy host may stop a node or a router.
BUSY = 30.0
#: TLS between routers: each has a certificate of one authority, and so must the other.
_TLS: Mapping[str, Any] = {
    "root_ca_certificate": "{keys}/ca.pem",
    "enable_mtls": True,
    "verify_name_on_connect": True,
    "listen_certificate": "{keys}/{node}.pem",
    "listen_private_key": "{keys}/{node}.key",
    "connect_certificate": "{keys}/{node}.pem",
    "connect_private_key": "{keys}/{node}.key",
}


def client_config(silence: float) -> Mapping[str, Any]:
    """The configuration of a node behind the router of its host: a busy host stops it for seconds.

    `silence`: the longest outage of the network, for which what is sent has to wait, s.
    """
    wait = max(BUSY, silence)
    queue = {
        "size": {"real_time": 16},
        "congestion_control": {"block": {"wait_before_close": round(wait * 1e6)}},
    }
    return {
        "mode": "client",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}, "delay": 50},
        "transport": {
            "unicast": {"open_timeout": 20000, "accept_timeout": 20000},
            "link": {"tx": {"lease": round(wait * 1e3), "keep_alive": 4, "queue": queue}},
        },
    }


def router_config(silence: float, *, tls: bool) -> Mapping[str, Any]:
    """The same for the router: it accepts all its nodes at once.

    `silence`: after so long without a sign of another router the connection is lost, s.
    """
    client = client_config(silence)
    transport = client["transport"]
    tx = {**transport["link"]["tx"], "lease": round(silence * 1e3)}
    return {
        **client,
        "mode": "router",
        "transport": {
            "unicast": {**transport["unicast"], "accept_pending": 10000},
            "link": {"tx": tx, **({"tls": _TLS} if tls else {})},
        },
    }
