"""Comparison of arm positions before the start: arms too far apart are not coupled.

``nodes.X.apart = { of = "master.q", other = "slave.q", within = "0.1 rad" }``: messages carry both
outputs; X receives both, and refuses to start (``WHY_APART``) while any entry differs by more.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from bridge.deployment.carried import Carried
from bridge.deployment.spec import ApartSpec, Deployment
from bridge.native import node as native
from cosim.base.convert import number
from cosim.base.errors import ScenarioError


def messages(
    d: Deployment, node: str, carried: Mapping[str, Carried], buses: Collection[str]
) -> set[str]:
    """Messages that a node must receive for the comparison, if they are on one of its `buses`.

    Raises ScenarioError if no message carries a port.
    """
    spec = d.nodes[node].apart
    if spec is None:
        return set()
    near = dict(sorted(carried.items(), key=lambda item: item[1].bus not in buses))
    return {_find(d, node, near, port)[0] for port in (spec.of, spec.other)}


def _find(
    d: Deployment, node: str, carried: Mapping[str, Carried], port: str
) -> tuple[str, int, int]:
    """(message, first of its values, how many)."""
    for name, message in carried.items():
        first = 0
        for part in message.outlet.parts:
            if f"{part.component}.{part.port}" == port:
                return name, first, part.size
            first += part.size
    raise ScenarioError(f"no message carries {port!r}", d.place("nodes", node, "apart"))


def structs(
    d: Deployment,
    node: str,
    carried: Mapping[str, Carried],
    receptions: Mapping[str, native.Reception],
) -> list[native.Apart]:
    """The comparisons as C structs. Raises ScenarioError unless both are positions of one shape."""
    spec = d.nodes[node].apart
    return [] if spec is None else [_struct(d, node, spec, carried, receptions)]


def _struct(
    d: Deployment,
    node: str,
    spec: ApartSpec,
    carried: Mapping[str, Carried],
    receptions: Mapping[str, native.Reception],
) -> native.Apart:
    place = d.place("nodes", node, "apart")
    heard = {name: message for name, message in carried.items() if name in receptions}
    (a, first_a, n), (b, first_b, m) = (
        _find(d, node, heard, port) for port in (spec.of, spec.other)
    )
    if n != m:
        raise ScenarioError(f"{spec.of} has {n} values, {spec.other} {m}", place)
    within = number(spec.within, "rad", f"{place}.within")
    if not within > 0:
        raise ScenarioError(f"is {within:g} rad, expected more than 0", f"{place}.within")
    found = native.Apart(first_a=first_a, first_b=first_b, count=n, within=within)
    found.a.contents, found.b.contents = receptions[a], receptions[b]
    return found
