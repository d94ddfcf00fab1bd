"""Scenarios written in tests: a document as TOML would give it, and the plan of it."""

from __future__ import annotations

from pathlib import Path

from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan

BLOCKS = "tests.cosim.blocks"


def document(components, links=(), step=0.25, stop=2.0, extra=None, **run):
    """A document; component models without a colon or dot are blocks of the tests."""
    components = {
        name: {
            **spec,
            "model": spec["model"] if "." in spec["model"] else f"{BLOCKS}:{spec['model']}",
        }
        for name, spec in components.items()
    }
    return {
        "run": {"step": step, "stop": stop, **run},
        "components": components,
        "links": [{"delay": {"law": "constant", "delay": 0.5}, **link} for link in links],
        **(extra or {}),
    }


def scenario(components, links=(), path="test.toml", **run) -> Scenario:
    """A scenario of a document."""
    return build(document(components, links, **run), Path(path))


def plan(components, links=(), **run) -> Plan:
    """The plan of a document."""
    return assemble(scenario(components, links, **run))
