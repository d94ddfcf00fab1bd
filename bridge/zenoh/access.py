"""Who may publish what, from the deployment: a node its own keys, everybody may listen.

Subjects are the common names of certificates, which are the names of the nodes. The rules are in
every listener, and in a router; what is not allowed is denied.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bridge.zenoh.names import Names

#: Who may send commands to nodes, and ask them: the common name of an operator's certificate.
OPERATOR = "operator"
BOTH = ["ingress", "egress"]


def access_control(names: Names, nodes: Iterable[str], operator: str = OPERATOR) -> dict[str, Any]:
    """The section ``access_control`` of a Zenoh configuration for these nodes."""
    listed = list(nodes)
    everything = f"{names.prefix}/**"
    rules = [
        _rule("hear", ["egress"], ["put", "delete", "reply"], [everything]),
        _rule(
            "declare",
            BOTH,
            [
                *("declare_subscriber", "declare_queryable"),
                *("liveliness_query", "declare_liveliness_subscriber"),
            ],
            [everything],
        ),
        _rule("present", ["egress"], ["liveliness_token"], [everything]),
        _rule("asked", ["egress"], ["query"], [everything]),
    ]
    policies = [{"rules": ["hear", "declare", "present", "asked"], "subjects": [*listed, operator]}]
    for node in listed:
        own = [f"{names.prefix}/{node}/**"]
        rules += [
            _rule(f"{node} says", ["ingress"], ["put", "delete", "reply"], own),
            _rule(f"{node} stops", ["ingress"], ["put"], [names.shared("estop")]),
            _rule(f"{node} is", ["ingress"], ["liveliness_token"], own),
        ]
        policies.append(
            {"rules": [f"{node} {x}" for x in ("says", "stops", "is")], "subjects": [node]}
        )
    commands = [names.shared("nmt"), names.shared("estop")]
    rules += [
        _rule("operator says", ["ingress"], ["put"], commands),
        _rule("operator asks", ["ingress"], ["query"], [everything]),
    ]
    policies.append({"rules": ["operator says", "operator asks"], "subjects": [operator]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": n, "cert_common_names": [n]} for n in (*listed, operator)],
        "policies": policies,
    }


def _rule(name: str, flows: list[str], messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": flows,
        "messages": messages,
        "key_exprs": keys,
    }
