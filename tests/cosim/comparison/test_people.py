"""Operators with their own components, and links with different directions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison.documents import Case, scenario
from cosim.comparison.variants_file import read
from cosim.scenario.assemble import assemble
from tests.cosim.comparison.parts import SMALL, compared, loaded, written

PERSON = """
[operators.person]
master = { k_p = 80.0, k_d = 8.0 }
feeds.master = { q_h = "intent.q_h" }
[operators.person.components.intent]
model = "fmus.models.reaction"
preset = "felt"
inputs = { q = "master.q" }
[links.apart]
semantics = "newest-stamp"
slave = { delay = { law = "constant", delay = "200 ms" } }
master = { delay = { law = "preset", name = "wifi5" } }
"""


def test_a_person_moves_the_hand_after_the_reaction_time(tmp_path: Path) -> None:
    variants, base = loaded(written(tmp_path, SMALL + PERSON))
    plan = assemble(scenario(base, variants, Case("pd", "person", "constant", 0)))
    assert "intent" in [step.name for step in plan.components]
    wires = {(w.source.name, w.target.name) for w in plan.wires}
    assert {("intent.q_h", "master.q_h"), ("master.q", "intent.q")} <= wires
    found = compared(written(tmp_path, SMALL + PERSON), ["pd"], ["light", "person"], ["constant"])
    hard, soft = (o.numbers["effort"][0] for o in found.outcomes)
    assert all(o.verdict.ended for o in found.outcomes)
    assert np.isfinite([hard, soft]).all() and hard != soft


def test_both_ways_of_a_link_may_differ(tmp_path: Path) -> None:
    variants, base = loaded(written(tmp_path, SMALL + PERSON))
    plan = assemble(scenario(base, variants, Case("pd", "light", "apart", 0)))
    laws = {x.target.component: x.table.facts()["delay"]["law"] for x in plan.links}
    assert laws == {"slave_control": "constant", "master_control": "gamma"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("slave = { delay", "slave = { dealy"), "no key 'dealy'"),
        (("feeds.master", "feeds.mastr"), "no role 'mastr'"),
        (
            ('master = { delay = { law = "preset", name = "wifi5" } }', ""),
            "the key 'delay' is missing",
        ),
    ],
)
def test_what_the_file_cannot_say(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    text = SMALL + PERSON
    assert change[0] in text
    with pytest.raises(ScenarioError, match=says):
        read(written(tmp_path, text.replace(*change)))


def test_a_component_of_an_operator_has_a_name_of_its_own(tmp_path: Path) -> None:
    path = written(tmp_path, SMALL + PERSON.replace("components.intent", "components.slave"))
    variants, base = loaded(path)
    with pytest.raises(ScenarioError, match="has a component 'slave' already"):
        scenario(base, variants, Case("pd", "person", "constant", 0))
