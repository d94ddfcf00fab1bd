"""Permissions to publish, derived from the deployment: a node has its own keys; all receive.

Subjects are the common names of certificates, which are the names of the nodes. Every listener and
every router has these rules and denies everything else.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from bridge.deployment.zenoh_keys import Names

#: Who may send commands to nodes, and ask them: the common name of an operator's certificate.
OPERATOR = "operator"
#: Who may hear everything and say nothing, besides: of ``cosim monitor --listen``.
MONITOR = "monitor"
BOTH = ["ingress", "egress"]
Table = dict[str, Any]


def access_control(
    names: Names,
    nodes: Iterable[str],
    operator: str = OPERATOR,
    monitor: str = MONITOR,
    gateways: Collection[str] = (),
) -> Table:
    """The section ``access_control`` of a Zenoh configuration for these nodes.

    `gateways`: those of them that pass on commands from their other buses.
    """
    listed = list(nodes)
    everybody = list(dict.fromkeys((*listed, operator, monitor)))
    rules, policies = _everybody(names, everybody)
    for node in listed:
        own = [f"{names.prefix}/{node}/**"]
        mine = [
            _rule(f"{node} says", ["ingress"], ["put", "delete", "reply"], own),
            _rule(f"{node} stops", ["ingress"], ["put"], [names.shared("estop")]),
            _rule(f"{node} dates", ["ingress"], ["put"], [names.shared("epoch")]),
            _rule(f"{node} is", ["ingress"], ["liveliness_token"], own),
        ]
        if node in gateways:
            mine.append(_rule(f"{node} passes on", ["ingress"], ["put"], [names.shared("nmt")]))
        rules += mine
        policies.append(_policy(mine, [node]))
    commands = [names.shared(what) for what in ("nmt", "estop", "epoch")]
    told = [
        _rule("operator says", ["ingress"], ["put"], commands),
        _rule("operator asks", ["ingress"], ["query"], [f"{names.prefix}/**"]),
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules + told,
        "subjects": [{"id": n, "cert_common_names": [n]} for n in everybody],
        "policies": [*policies, _policy(told, [operator])],
    }


def _everybody(names: Names, subjects: list[str]) -> tuple[list[Table], list[Table]]:
    """Rules and policies common to all nodes: to receive, and to see present nodes."""
    everything = [f"{names.prefix}/**"]
    declared = ["declare_subscriber", "declare_queryable"]
    declared += ["liveliness_query", "declare_liveliness_subscriber"]
    rules = [
        _rule("hear", ["egress"], ["put", "delete", "reply"], everything),
        _rule("declare", BOTH, declared, everything),
        _rule("present", ["egress"], ["liveliness_token"], everything),
        _rule("asked", ["egress"], ["query"], everything),
    ]
    return rules, [_policy(rules, subjects)]


def _policy(rules: list[Table], subjects: list[str]) -> Table:
    return {"rules": [rule["id"] for rule in rules], "subjects": subjects}


def _rule(name: str, flows: list[str], messages: list[str], keys: list[str]) -> Table:
    return {
        "id": name,
        "permission": "allow",
        "flows": flows,
        "messages": messages,
        "key_exprs": keys,
    }
