"""A plan with another seed: drawn anew is what the seed decides, and nothing else is made again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cosim.base.copies import replace
from cosim.links.table import DrawnTable
from cosim.scenario.spec import has_many
from cosim.schedule.plan import Plan


def can_reseed(document: Mapping[str, Any], plan: Plan) -> bool:
    """True if only the tables of links depend on the seed, so that :func:`reseeded` is the plan.

    `document`: the scenario's, parsed. It is not so with buses, weights over time, and counted
    components, whose values may be drawn.
    """
    other = has_many(document) or document.get("bus") or plan.buses or plan.players or plan.gates
    return not other


def reseeded(plan: Plan, seed: int) -> Plan:
    """The plan of the same scenario with this seed. Raises ScenarioError."""
    links = tuple(
        replace(link, table=link.table.of(link.table.name, seed))
        if isinstance(link.table, DrawnTable)
        else link
        for link in plan.links
    )
    return replace(plan, links=links)
