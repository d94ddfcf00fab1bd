"""``like``: an entry of a file takes the keys of another entry of the same table."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.deployment import spec as deployment
from cosim.base import toml
from cosim.base.errors import ScenarioError
from cosim.loading.files import load

CONFIGS = Path(__file__).parents[3] / "configs"
SCENARIO = """
[run]
step = "1 ms"
stop = "10 ms"

[components.left]
like = "right"
inputs = { tau_ext = "other.tau" }
start = { q = [0.2, 0.3] }
[components.left.parameters]
k_p = 3.0

[components.right]
model = "fmus.models.planar2r"
preset = "SL91"
inputs = { tau = "other.tau" }
start = { q = [0.1, 0.1], dq = [0.0, 0.0] }
parameters = { k_p = 1.0, k_d = 2.0 }
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_own_keys_override_and_tables_join(tmp_path: Path) -> None:
    left = load(write(tmp_path, SCENARIO)).components["left"]
    assert (left.model, left.preset) == ("fmus.models.planar2r", "SL91")
    assert left.parameters == {"k_p": 3.0, "k_d": 2.0}
    assert left.start == {"q": [0.2, 0.3], "dq": [0.0, 0.0]}
    assert left.inputs == {"tau": "other.tau", "tau_ext": "other.tau"}


def test_a_setting_changes_one_component_only(tmp_path: Path) -> None:
    settings = ["components.right.parameters.k_d=7.0", "components.left.start.q=[1.0, 1.0]"]
    components = load(write(tmp_path, SCENARIO), settings).components
    assert components["left"].parameters["k_d"] == 2.0
    assert components["right"].parameters["k_d"] == 7.0
    assert components["right"].start["q"] == [0.1, 0.1]


def test_another_table_replaces_as_a_whole() -> None:
    text = """
[nodes.one]
components = ["one"]
guard = { tau_max = [1.0], q_jump = 0.5 }
stale = { "one.q" = { stop = "20 ms" } }
[nodes.two]
like = "one"
components = ["two"]
stale = { "two.q" = { stop = "30 ms" } }
"""
    assert toml.parse(text, "deploy.toml")["nodes"]["two"] == {
        "components": ["two"],
        "guard": {"tau_max": [1.0], "q_jump": 0.5},
        "stale": {"two.q": {"stop": "30 ms"}},
    }


def test_like_follows_others_in_any_order() -> None:
    text = '[buses]\nc = { like = "b", x = 3 }\nb = { like = "a", y = 2 }\na = { x = 1, y = 1 }'
    buses = toml.parse(text, "deploy.toml")["buses"]
    assert buses == {"c": {"x": 3, "y": 2}, "b": {"x": 1, "y": 2}, "a": {"x": 1, "y": 1}}
    assert list(buses) == ["c", "b", "a"]


def test_a_component_may_be_called_like() -> None:
    text = '[components.like]\nmodel = "m"\n[components.b]\nlike = "like"'
    assert toml.parse(text, "s.toml")["components"]["b"] == {"model": "m"}


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ('a = { like = "a" }', "s.toml at components.a.like: entries are like each other: a -> a"),
        (
            'a = { like = "b" }\nb = { like = "c" }\nc = { like = "b" }',
            "s.toml at components.a.like: entries are like each other: a -> b -> c -> b",
        ),
        (
            'servo = { x = 1 }\nb = { like = "sevro" }',
            "at components.b.like: no entry of the same table 'sevro'; did you mean 'servo'?",
        ),
        ('a = { like = "nodes.a" }', "no entry of the same table 'nodes.a'"),
        ('a = { like = "b" }\nb = 3', "no entry of the same table 'b'"),
        ('a = { like = ["a"] }', "found ['a']; expected the name of another entry"),
    ],
)
def test_a_wrong_like_is_refused(entries: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        toml.parse(f"[components]\n{entries}\n[nodes]\na = {{ x = 1 }}", "s.toml")
    assert message in str(caught.value)


def test_an_error_names_the_place_in_the_expanded_file(tmp_path: Path) -> None:
    wrong = SCENARIO.replace("k_d = 2.0", "k_d = 2.0, k_w = [[]]").replace('"SL91"', "5")
    with pytest.raises(ScenarioError, match=r"at components\.left\.preset"):
        load(write(tmp_path, wrong))


def test_like_comes_before_settings(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="like"):
        load(write(tmp_path, SCENARIO), ['components.right.like="left"'])


def test_nodes_of_a_deployment_are_like_others(tmp_path: Path) -> None:
    text = (CONFIGS / "deploy" / "can.toml").read_text(encoding="utf-8")
    text += '\n[nodes.further]\nlike = "master"\ncomponents = ["further"]\nnumber = 9\n'
    path = tmp_path / "deploy.toml"
    path.write_text(text.replace("../", f"{CONFIGS}/"), encoding="utf-8")
    nodes = deployment.load(path, ["nodes.further.phase=1 ms"]).nodes
    assert nodes["further"].drive == nodes["master"].drive
    assert (nodes["further"].phase, nodes["further"].number) == ("1 ms", 9)
    assert nodes["master"].phase != "1 ms"
