"""The table of pairs: every one of them can be wired, on both sides, as its modules say."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.fmus.bilateral import PAIRS, Pair, controls, links
from tests.fmus.pairs import ARMS, CONSTANT, JITTER, document, run

MODULES = sorted({side.model for pair in PAIRS.values() for side in (pair.first, pair.second)})


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_every_pair_is_a_scenario(pair: Pair) -> None:
    plan = assemble(build(document(pair, stop=1.0), Path("pair.toml")))
    assert len(plan.components) == 4
    sent = {(x.source.name.partition(".")[0], x.target.name.partition(".")[0]) for x in plan.links}
    assert all(a.startswith(("master", "slave")) and a[:5] != b[:5] for a, b in sent)
    for name in ("master_control", "slave_control"):
        fed = {w.target.port for w in plan.wires if w.target.component == name}
        fed |= {x.target.port for x in plan.links if x.target.component == name}
        needed = {slot.port for slot in plan.component(name).inputs}
        assert needed - fed <= {"w", "age"}  # weight of the edge and age have defaults


@pytest.mark.parametrize("name", MODULES)
def test_what_a_module_sends_is_there_and_its_values_are_parameters(name: str) -> None:
    model = import_module(name).model()
    outputs = {port.name for port in model.outputs()}
    parameters = {parameter.name for parameter in model.parameters()}
    for pair in PAIRS.values():
        for side, other in ((pair.first, pair.second), (pair.second, pair.first)):
            if side.model != name:
                continue
            taken = {port.name for port in import_module(other.model).model().inputs()}
            for source, target in side.sends:
                owner, _, port = source.partition(".")
                assert port in (outputs if owner == "control" else {"q", "dq"})
                assert target.partition(".")[2].partition("[")[0] in taken
            assert set(side.values) <= parameters


def test_what_goes_one_way_travels_together() -> None:
    made = links(PAIRS["tdpa"], ARMS, JITTER, semantics="newest-stamp")
    channels = {link["channel"] for link in made}
    assert len(channels) == 2
    for link in made:
        assert link["from"].startswith(link["channel"].partition("->")[0])
        assert link["to"].startswith(link["channel"].partition("->")[2])
        assert link["delay"] == JITTER and link["semantics"] == "newest-stamp"


def test_velocity_and_position_of_one_packet_have_one_delay() -> None:
    free = run(PAIRS["pd"], stop=4.0, delay=JITTER)
    sent = {tuple(row): k for k, row in enumerate(free["slave.q"].tolist())}
    for k in range(1500, 4000, 35):
        j = sent[tuple(free["master_control.q_j"][k].tolist())]
        assert (free["master_control.dq_j"][k] == free["slave.dq"][j]).all()


def test_controllers_are_called_like_their_arms() -> None:
    made = controls(PAIRS["wave"], ("left", "right"), "2 ms")
    assert list(made) == ["left_control", "right_control"]
    assert made["left_control"]["inputs"] == {"dq": "left.dq"}
    assert made["right_control"]["inputs"] == {"q": "right.q", "dq": "right.dq"}
    assert {spec["period"] for spec in made.values()} == {"2 ms"}
    ends = [(x["from"], x["to"]) for x in links(PAIRS["wave"], ("left", "right"), CONSTANT)]
    assert ends == [
        ("left_control.u", "right_control.u"),
        ("right_control.v", "left_control.v"),
    ]
