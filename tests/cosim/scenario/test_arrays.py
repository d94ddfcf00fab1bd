"""Counted components, links along graphs, and values for each: what they are expanded to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.scenario.arrays import expand
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

RUN = {"step": "1 ms", "stop": "1 s", "seed": 3}


def document(**tables: Any) -> dict[str, Any]:
    return {"run": RUN, "components": {}, **tables}


def robots(n: int = 3, **keys: Any) -> dict[str, Any]:
    return document(components={"robot": {"count": n, "model": "m", **keys}})


def expanded(given: dict[str, Any], path: Path = Path("x.toml")) -> dict[str, Any]:
    return expand(given, path)


def test_a_document_without_them_stays_as_it_is() -> None:
    given = document(components={"a": {"model": "{i}"}}, links=[{"from": "a.y", "to": "a.u"}])
    assert expanded(given) == given


def test_components_are_numbered_and_texts_have_their_number() -> None:
    found = expanded(robots(inputs={"u": "c{i}.y", "v": "c{n}.y"}, sizes={"m": "{i}"}))
    assert list(found["components"]) == ["robot1", "robot2", "robot3"]
    second = found["components"]["robot2"]
    assert second == {"model": "m", "inputs": {"u": "c2.y", "v": "c3.y"}, "sizes": {"m": 2}}


def test_each_says_what_is_different() -> None:
    each = {"2": {"parameters": {"k": 5.0}, "preset": "b{i}"}}
    found = expanded(robots(parameters={"k": 1.0, "d": 2.0}, each=each))["components"]
    assert found["robot1"] == {"model": "m", "parameters": {"k": 1.0, "d": 2.0}}
    assert found["robot2"]["parameters"] == {"k": 5.0, "d": 2.0}
    assert found["robot2"]["preset"] == "b2"


def test_what_is_the_same_in_all_is_one_object_and_stays_as_it_is_where_one_differs() -> None:
    given = robots(
        4, parameters={"k": [1.0, {"a": 2}], "l": {"list": [5, 6, 7, 8, 9]}},
        options={"deep": {"x": 1, "text": "{i} of 100 %"}, "list": ["{n}", "{}", "{i}{i}"]},
        each={"2": {"parameters": {"k": 0}, "options": {"deep": {"x": "{i}"}}}},
    )  # fmt: skip
    one, two, three, four = expanded(given)["components"].values()
    assert one["parameters"]["k"] is four["parameters"]["k"] == [1.0, {"a": 2}]
    assert two["parameters"] == {"k": 0, "l": 6} and three["parameters"]["l"] == 7
    assert two["options"]["deep"] == {"x": 2, "text": "2 of 100 %"}
    assert three["options"] == {"deep": {"x": 1, "text": "3 of 100 %"}, "list": [4, "{}", "33"]}


def test_a_table_of_laws_alone_has_as_many_rows_as_there_are_components() -> None:
    given = {"components": {"robot": {"count": 2, "start": {"q": {"list": [1, 2, 3]}}}}}
    found = expanded(given)["components"]
    assert found == {"robot1": {"start": {"q": 1}}, "robot2": {"start": {"q": 2}}}


def test_the_first_of_many_links_that_is_wrong_is_named() -> None:
    links = [{"from": "a.y", "to": "a.u", "delay": {}} for _ in range(5)]
    links[3]["dalay"] = links[4]["from"] = 3  # type: ignore[assignment]
    with pytest.raises(ScenarioError, match=r"x.toml at links.3: .*'dalay'; did you mean 'delay'"):
        build(document(components={"a": {"model": "m"}}, links=links), Path("x.toml"))


def test_values_by_a_law_do_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    (tmp_path / "q.csv").write_text("a,b,c\n1,2,3\n4,5,6\n7,8,9\n")
    laws = {
        "u": {"uniform": [[-1, 10], [1, 20]]},
        "g": {"normal": [5.0, [0.0, 2.0]]},
        "l": {"list": [7, 8, 9]},
        "f": {"file": "q.csv", "columns": ["c", "a"]},
        "s": {"file": "q.csv", "columns": ["b"]},
    }

    def values(n: int) -> list[dict[str, Any]]:
        parts = expand(robots(n, start=laws), tmp_path / "x.toml")["components"]
        return [part["start"] for part in parts.values()]

    three = values(3)
    assert values(2) == three[:2]
    assert [v["l"] for v in three] == [7, 8, 9] and three[1]["f"] == [6.0, 4.0]
    assert [v["s"] for v in three] == [2.0, 5.0, 8.0]
    many = {**laws, "l": 1, "f": 1, "s": 1}
    parts = expand(robots(4000, start=many), tmp_path / "x.toml")["components"].values()
    u, g = (np.array([p["start"][k] for p in parts]) for k in "ug")
    assert (u.min(axis=0) >= [-1, 10]).all() and (u.max(axis=0) <= [1, 20]).all()
    np.testing.assert_allclose(u.mean(axis=0), [0, 15], atol=0.3)
    assert (g[:, 0] == 5).all() and g[:, 1].std() == pytest.approx(2, rel=0.05)
    other = expand({**robots(3, start=laws), "run": {**RUN, "seed": 4}}, tmp_path / "x.toml")
    assert other["components"]["robot1"]["start"]["u"] != three[0]["u"]


GRAPH = {"net": {"kind": "grid", "rows": 2, "columns": 2}}  # 1 2 / 3 4


def test_links_follow_the_edges_of_a_graph() -> None:
    link = {"graph": "net", "from": "c{j}.xi", "to": "c{i}.xi_in[{k}]", "name": "{i} from {j}"}
    found = expanded(
        document(
            graphs=GRAPH,
            components={"c": {"graph": "net", "model": "m", "sizes": {"neighbours": "{degree}"}}},
            links=[{"from": "c1.a", "to": "c2.b"}, link],
        )
    )
    assert "graphs" not in found and len(found["components"]) == 4
    assert found["components"]["c3"]["sizes"] == {"neighbours": 2}
    assert [x["name"] for x in found["links"][1:4]] == ["1 from 2", "1 from 3", "2 from 1"]
    assert found["links"][2] == {"from": "c3.xi", "to": "c1.xi_in[1]", "name": "1 from 3"}


def test_links_between_regions_have_what_is_theirs() -> None:
    """Five robots in two regions: 1 to 3, and 4 and 5."""
    link = {
        "graph": "net", "from": "c{j}.xi", "to": "c{i}.xi_in[{k}]", "delay": "5 ms", "loss": 0.1,
        "regions": 2, "between": {"delay": "80 ms", "name": "{i} far from {j}"},
    }  # fmt: skip
    ring = {"net": {"kind": "ring", "n": 5}}
    found = expanded(document(graphs=ring, links=[link]))["links"]
    assert {x["to"][1]: x["delay"] for x in found} == {
        "1": "80 ms", "2": "5 ms", "3": "5 ms", "4": "80 ms", "5": "5 ms",
    }  # fmt: skip
    assert found[3] == {
        "from": "c3.xi", "to": "c4.xi_in[0]", "delay": "80 ms", "loss": 0.1, "name": "4 far from 3",
    }  # fmt: skip


def test_a_topology_has_each_edge_in_one_of_its_graphs() -> None:
    topology = {"graph": "net", "parts": 3, "dwell": "1 s", "weights": "c{i}.w[{k}]"}
    found = expanded(document(graphs=GRAPH, topology=topology))["topology"]
    edges = [tuple(edge) for graph in found["graphs"] for edge in graph]
    assert len(found["graphs"]) == 3 and len(edges) == len(set(edges)) == 8
    assert found["weights"]["c1.w[1]"] == [1, 3] and set(map(tuple, found["weights"].values())) == {
        *edges
    }
    assert found["dwell"] == "1 s" and "parts" not in found


def test_signals_of_all_robots_are_listed() -> None:
    given = robots(2, inputs={})
    given |= {
        "run": {**RUN, "record": {"signals": ["a.x", "robot{i}.q"]}},
        "metrics": {"m": {"of": ["robot{i}.q"]}},
        "figures": {"f": {"panels": [{"y": ["robot{i}.q[0]"], "labels": ["{i}"]}]}},
    }
    given["figures"]["f"]["panels"][0].pop("labels")
    found = expanded(given)
    assert found["run"]["record"]["signals"] == ["a.x", "robot1.q", "robot2.q"]
    assert found["metrics"]["m"]["of"] == ["robot1.q", "robot2.q"]
    assert found["figures"]["f"]["panels"][0]["y"] == ["robot1.q[0]", "robot2.q[0]"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (robots(0), "count 0; expected 1 to 1000000 at|at components.robot.count: count 0"),
        (robots(True), "count True"),
        (robots(graph="net"), "found count and graph; expected one of them"),
        (robots(inputs={"u": "c{j}.y"}), r"found \{j\} in 'c\{j\}.y'; expected \{i\}, \{n\}"),
        (robots(each={"4": {}}), "found '4'; expected a number from 1 to 3"),
        (robots(each={"1": 2}), "expected tables by number"),
        (robots(start={"q": {"list": [1, 2]}}), "found 2 values; expected 3 values"),
        (robots(start={"q": {"gauss": [1, 2]}}), "found gauss; expected a value, or one law"),
        (robots(start={"q": {"uniform": [2, 1]}}), r"expected \[low, high\]"),
        (robots(start={"q": {"uniform": ["1 rad", 2]}}), r"expected \[low, high\], numbers"),
        (robots(start={"q": {"normal": [0, -1]}}), r"expected \[mean, standard deviation\]"),
        (robots(start={"q": {"file": "none.csv"}}), "none.csv: no such file"),
        (document(graphs={"g": {"kind": "rign", "n": 3}}), "rign"),
        (document(graphs=3), r"expected a table \[graphs.NAME\]"),
        (document(links=[{"graph": "g"}]), "no graph 'g'|unknown graph 'g'"),
        (
            document(graphs=GRAPH, links=[{"graph": "net", "regions": 2}]),
            "links.0.between: found no between; expected a table of what differs",
        ),
        (
            document(
                graphs=GRAPH, links=[{"graph": "net", "regions": 2, "between": {"to": "a.b"}}]
            ),
            "expected a table of what differs in links",
        ),
        (
            document(graphs=GRAPH, links=[{"graph": "net", "regions": 5, "between": {}}]),
            "links.0.regions: found regions 5; expected 1 to 4, the robots",
        ),
        (
            document(graphs=GRAPH, links=[{"graph": "net", "between": {}}]),
            "links.0.regions: found no regions; expected 1 to 4, the robots",
        ),
        (
            document(graphs=GRAPH, topology={"graph": "net", "weights": "w{i}", "parts": 9}),
            "parts 9; expected 1 to 8, the edges",
        ),
        (document(graphs=GRAPH, topology={"graph": "net"}), "expected graph with weights ="),
        (
            {**robots(2), "metrics": {"m": {"of": ["robto{i}.q"]}}},
            "'robto'; did you mean 'robot'|counted component 'robto'",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        expanded(given)


def test_a_name_that_is_taken_is_refused() -> None:
    given = robots()
    given["components"]["robot2"] = {"model": "m"}
    with pytest.raises(ScenarioError, match=r"found components.robot2; expected components.robot."):
        expanded(given)


def test_an_expanded_scenario_runs_as_one_that_is_written_out() -> None:
    """A ring of three, each following the one before."""
    follower = {"model": "tests.cosim.blocks:Integrator"}
    start = [1.0, 2.0, 3.0]
    graph = document(
        graphs={"ring": {"kind": "ring", "n": 3}},
        components={"c": {"graph": "ring", **follower, "start": {"x": {"list": start}}}},
        links=[{
            "graph": "ring", "from": "c{j}.y", "to": "c{i}.u",
            "delay": {"law": "constant", "delay": "10 ms"},
        }],
    )  # fmt: skip
    written = document(
        components={f"c{i}": {**follower, "start": {"x": start[i - 1]}} for i in (1, 2, 3)},
        links=[
            {
                "from": f"c{j}.y", "to": f"c{i}.u",
                "delay": {"law": "constant", "delay": "10 ms"},
            }
            for i, j in ((1, 3), (2, 1), (3, 2))
        ],
    )  # fmt: skip
    ends = []
    for given in (graph, written):
        with Engine(assemble(build(given, Path("x.toml")))) as engine:
            engine.initialize()
            engine.run(500)
            ends.append(engine.signals.copy())
    np.testing.assert_array_equal(*ends)
    assert np.ptp(ends[0]) > 0
