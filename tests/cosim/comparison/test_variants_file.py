"""A variants file as read, and a sentence with a place for everything that can be wrong in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.comparison.documents import Case, read_base, scenario
from cosim.comparison.variants import Variants, choose
from cosim.comparison.variants_file import read, variants_path
from cosim.measure.metrics import Error
from cosim.scenario.assemble import assemble
from tests.cosim.comparison.parts import CONFIG, SMALL, VARIANTS, written


@pytest.fixture(scope="module")
def shipped() -> Variants:
    return read(VARIANTS)


def test_the_shipped_file_lies_beside_the_scenario() -> None:
    assert variants_path(CONFIG) == VARIANTS


def test_what_the_shipped_file_has(shipped: Variants) -> None:
    assert {"paper", "paper-1", "pd", "p+d", "lee-spong", "nuno", "chopra", "wang", "wave"} <= set(
        shipped.controllers
    )
    assert {"free", "relaxed", "light", "heavy", "tight"} <= set(shipped.operators)
    assert {"paper", "constant", "newest", "playout"} <= set(shipped.links)
    assert shipped.controllers["paper"].sends == ("xi",)
    assert shipped.controllers["wave"].sends == ("v", "u")
    assert shipped.operators["tight"].values == {"master": {"k_p": 200.0, "k_d": 2.0}}


def test_a_side_joins_its_own_keys_with_those_of_both(tmp_path: Path) -> None:
    text = SMALL + '[controllers.pd.slave]\npreset = "free"\nparameters = { tau_max = 5.0 }\n'
    text = text.replace('preset = "PD(10,4)"', 'preset = "PD(10,4)"\nparameters = { K_p = 1.0 }')
    sides = read(written(tmp_path, text)).controllers["pd"].sides
    assert sides["master"].component["preset"] == "PD(10,4)"
    assert sides["slave"].component["preset"] == "free"
    assert sides["master"].component["parameters"] == {"K_p": 1.0}
    assert sides["slave"].component["parameters"] == {"K_p": 1.0, "tau_max": 5.0}
    assert sides["slave"].receives == {"q_j": ("arm", "q"), "dq_j": ("arm", "dq")}
    assert sides["slave"].inputs == {"q": ("arm", "q"), "dq": ("arm", "dq")}


SERVO = """
[controllers.slow]
model = "fmus.models.kinematic"
sizes = { joints = 2 }
receives = { "xi_in[0]" = "controller.xi" }
drives = { tau = "servo.tau" }
[controllers.slow.components.servo]
model = "fmus.models.servo"
sizes = { joints = 2 }
parameters = { K_v = 30.0 }
inputs = { q = "arm.q", dq = "arm.dq", dq_c = "controller.dq_c" }
"""


def test_a_controller_brings_components_of_its_own_on_each_side(tmp_path: Path) -> None:
    variants = read(written(tmp_path, SMALL + SERVO))
    assert variants.controllers["slow"].sides["slave"].drives == {"tau": ("servo", "tau")}
    base = read_base(CONFIG, variants)
    made = scenario(base, variants, Case("slow", next(iter(variants.operators)),
                                         next(iter(variants.links)), 0))  # fmt: skip
    for name in ("master", "slave"):
        assert made.components[f"{name}_servo"].parameters == {"K_v": 30.0}
        assert made.components[name].inputs["tau"] == f"{name}_servo.tau"
        assert made.components[f"{name}_servo"].inputs["dq_c"] == f"{name}_control.dq_c"
    assemble(made)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"servo.tau"', '"gear.tau"', "'gear.tau': expected 'arm.PORT' or 'controller.PORT' or"),
        ("sizes = { joints = 2 }\nparameters", "width = 2\nparameters", "no key 'width'"),
        ('"controller.dq_c"', '"nobody.dq_c"', "'nobody.dq_c': expected"),
    ],
)
def test_what_is_wrong_in_such_a_component_is_a_sentence(
    old: str, new: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match=said):
        read(written(tmp_path, SMALL + SERVO.replace(old, new)))


def test_columns_are_metrics_or_parts_of_them(shipped: Variants) -> None:
    reach = next(c for c in shipped.columns if c.name == "reach")
    assert isinstance(reach.metric, Error)
    assert (reach.part, reach.metric.within, reach.metric.target) == ("settle_s", 0.05, (3.5, 3.0))
    assert not reach.applies(shipped.operators["free"])
    reflection = next(c for c in shipped.columns if c.name == "reflection")
    applies = [name for name, o in shipped.operators.items() if reflection.applies(o)]
    assert applies == ["wall", "person-wall"]


# ---- selection ---------------------------------------------------------------------------------


def test_nothing_asked_for_is_the_default_and_all_is_all(shipped: Variants) -> None:
    assert shipped.select((), (), ()) == shipped.default
    every = shipped.select(["all"], ["all"], ["all"])
    assert every.controllers == tuple(shipped.controllers)
    assert every.links == tuple(shipped.links)


@given(st.lists(st.sampled_from("abcd"), min_size=1))
def test_names_come_in_the_order_asked_for_and_once(wanted: list[str]) -> None:
    chosen = choose(wanted, dict.fromkeys("abcd"), ("d",), "letter")
    assert sorted(chosen) == sorted(set(wanted))
    assert [wanted.index(name) for name in chosen] == sorted(wanted.index(n) for n in chosen)


def test_an_unknown_name_is_told_with_the_nearest(shipped: Variants) -> None:
    with pytest.raises(ScenarioError, match=r"--controllers: no controller 'papr'; did you mean"):
        shipped.select(["papr"], (), ())


# ---- what can be wrong -------------------------------------------------------------------------

_LINK = 'delay = { law = "constant", delay = "100 ms" }'
WRONG = {
    "not TOML": ("[roles", "not valid TOML"),
    "key on top": ("title = 1", "at title: expected text, found 1"),
    "unknown key on top": ("contrllers = 1", "no key 'contrllers'; did you mean 'controllers'"),
    "one role": (
        ('[roles.slave]\narm = "slave"\ncontroller = "slave_control"\n', ""),
        "at roles: expected at least two roles, found master",
    ),
    "a role's key": (('arm = "slave"\n', ""), "at roles.slave: the key 'arm' is missing"),
    "no model": (
        ('model = "fmus.models.pd"\n', ""),
        "at controllers.pd: the key 'model' is missing",
    ),
    "a controller's key": (
        ('preset = "PD(10,4)"', 'presets = "PD(10,4)"'),
        "at controllers.pd: no key 'presets'; did you mean 'preset'?",
    ),
    "an endpoint": (
        ('q_j = "arm.q"', 'q_j = "master.q"'),
        "at controllers.pd.receives.q_j: 'master.q': expected 'arm.PORT' or 'controller.PORT'",
    ),
    "a wire": (
        ('tau = "controller.tau"', "tau = 3"),
        "at wiring.drives.tau: expected text, found",
    ),
    "an operator's role": (
        ("master = { k_p = 10.0, k_d = 5.0 }", "left = { k_p = 10.0 }"),
        "at operators.light: no key 'left'",
    ),
    "an operator's values": (
        ("master = { k_p = 10.0, k_d = 5.0 }", "master = 10.0"),
        "at operators.light.master: expected a table, found 10.0",
    ),
    "an operator's columns": (
        ("master = { k_p = 10.0, k_d = 5.0 }", 'without = ["efort"]'),
        "at operators.light.without: no column 'efort'; did you mean 'effort'?",
    ),
    "no delay": ((_LINK, ""), "at links.constant: the key 'delay' is missing"),
    "a link's key": ((_LINK, f"{_LINK}\nhold = 1"), "at links.constant: no key 'hold'"),
    "a column's kind": (
        ('kind = "norm"', 'kind = "sum"'),
        "at columns.effort: unknown kind 'sum'",
    ),
    "a column's target": (
        ('kind = "norm"', 'kind = "error"\ntarget = ["a"]'),
        "at columns.effort.target[0]: expected a number",
    ),
    "a column's norm": (
        ('kind = "norm"', 'kind = "error"\ntarget = [1, 1]\nnorm = "sum"'),
        "at columns.effort.norm: Invalid enum value 'sum'; expected one of max, euclidean",
    ),
    "a column's operators": (
        ('kind = "norm"', 'kind = "norm"\nonly = ["ligth"]'),
        "at columns.effort.only: no operator 'ligth'; did you mean 'light'?",
    ),
    "a limit's unit": (
        ("position_limit = 100.0", 'position_limit = "100 s"'),
        "at stable.position_limit: ",
    ),
    "no window": (("window = 1.0\n", ""), "at stable: the key 'window' is missing"),
    "the figure": (("[figure]", "[figure]\nuntil = true"), "at figure.until: expected a number"),
    "the default": (
        ("[figure]", '[default]\nlinks = ["paper"]\n[figure]'),
        "at default.links: no link 'paper'",
    ),
    "a name": (("[controllers.pd]", '[controllers."a,b"]'), "at controllers: the name 'a,b'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_a_sentence_with_its_place(case: str, tmp_path: Path) -> None:
    change, expected = WRONG[case]
    text = f"{change}\n{SMALL}" if isinstance(change, str) else SMALL.replace(*change, 1)
    assert text != SMALL
    path = written(tmp_path, text)
    with pytest.raises(ScenarioError) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))
    assert expected in str(caught.value)


def test_there_must_be_one_file_beside_a_scenario(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    with pytest.raises(ScenarioError, match=r"compare: expected one variants file, there is none"):
        variants_path(scenario)
    (tmp_path / "compare").mkdir()
    for name in ("a.toml", "b.toml"):
        written(tmp_path / "compare", SMALL, name)
    with pytest.raises(ScenarioError, match=r"found a.toml, b.toml; choose one with --variants"):
        variants_path(scenario)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"none\.toml: no such file; expected a variants file"):
        read(tmp_path / "none.toml")
    with pytest.raises(ScenarioError, match="is a folder"):
        read(tmp_path)
