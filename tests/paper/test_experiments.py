"""The documents say what the paper says, and are scenarios that assemble."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from fmus.paper import experiments as e
from fmus.paper.claims import cases

CONFIGS = Path(__file__).parents[2] / "configs"


def planned(document: e.Document) -> Plan:
    return assemble(build(document, Path("paper.toml")))


def test_one_arm() -> None:
    plan = planned(e.single())
    assert [c.name for c in plan.components] == ["control", "robot"]
    assert plan.component("control").values["lambda_M"] == (6.0,)
    assert plan.component("robot").values["substeps"] == (5.0,)
    assert plan.h == 5e-3


def test_a_slow_controller_does_not_make_the_arm_coarse() -> None:
    assert planned(e.single(21.0, period=0.015)).component("robot").values["substeps"] == (15.0,)
    assert planned(e.single(period=5e-4)).component("robot").values["substeps"] == (1.0,)


@pytest.mark.parametrize("graphs", ["ring", "tree3", "dense"])
def test_six_arms_receive_from_the_union_of_the_graphs(graphs: str) -> None:
    heard = e.neighbours(graphs)
    plan = planned(e.network(graphs=graphs, link={"delay": dict(e.DELAY)}))
    assert len(plan.links) == sum(map(len, heard.values())) == len(plan.players)
    wired = {(x.target.component, x.source.component) for x in plan.links}
    assert wired == {(f"control{i}", f"control{j}") for i in heard for j in heard[i]}


def test_without_delay_there_is_no_loop_and_no_link() -> None:
    plan = planned(e.network())
    assert not plan.links
    assert set(plan.order) > {"xi1", "control1"}
    assert not planned(e.teleoperator(link={})).links


def test_the_root_of_a_tree_is_the_single_arm_s_controller() -> None:
    document = e.network(graphs="tree3")
    assert document["components"]["control3"]["model"] == "fmus.models.adaptive"


def test_the_operator_holds_one_robot_only() -> None:
    components = e.network(operator=5)["components"]
    held = [i for i in range(1, 7) if components[f"robot{i}"]["start"].get("k_p")]
    assert held == [5]


def test_seeds_reach_links_and_graphs() -> None:
    document = cases(7)["net-delay-ring"]
    assert document["run"]["seed"] == 7
    assert document["topology"]["dwell"] == 0.15


@pytest.mark.parametrize(
    ("name", "document"),
    [
        ("teaching", e.single()),
        ("network", e.network(100.0, link={"delay": dict(e.DELAY)}, Gamma=1.0)),
        ("teleoperation", e.teleoperator()),
    ],
)
def test_the_scenario_files_are_the_same_experiments(name: str, document: e.Document) -> None:
    """Same parameters, start values, links and graphs; the arms step finer in the files."""
    file = assemble(load(CONFIGS / f"{name}.toml"))
    ours = planned(document)
    assert [c.name for c in file.components] == [c.name for c in ours.components]
    for mine, theirs in zip(ours.components, file.components, strict=True):
        for table, other in ((theirs.values, mine.values), (theirs.start, mine.start)):
            for key, value in table.items():
                if key != "theta":  # the preset of the files is the default
                    assert other[key] == pytest.approx(value), f"{mine.name}.{key}"
    assert [x.name for x in file.links] == [x.name for x in ours.links]
    laws = [[x.table.facts()["delay"] for x in plan.links] for plan in (file, ours)]
    assert laws[0] == laws[1]
    edges = [[p.source.facts() for p in plan.players] for plan in (file, ours)]
    assert edges[0] == edges[1]
    assert file.ticks * file.h == pytest.approx(ours.ticks * ours.h)
