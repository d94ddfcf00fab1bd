"""Scenario files: settings, and a sentence with its place for whatever is wrong."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.convert import numbers
from cosim.base.errors import CosimError, ScenarioError
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

TEXT = """
title = "A loop"
[run]
step = "250 ms"
stop = 2
[components.plant]
model = "tests.cosim.blocks:Integrator"
inputs = { u = "control.y" }
[components.control]
model = "tests.cosim.blocks:Gain"
inputs = { u = { from = "plant.y", gain = 2.0 } }
[[links]]
from = "plant.y"
to = "other.u"
delay = { law = "constant", delay = 1 }
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text(TEXT)
    return path


def test_a_scenario_is_read_as_written(file):
    scenario = load(file)
    assert scenario.title == "A loop"
    assert scenario.name == "loop"
    assert scenario.seconds(scenario.run.step, "run.step") == 0.25
    assert scenario.components["control"].inputs["u"].gain == 2.0
    assert scenario.links[0].semantics == "signal"


@pytest.mark.parametrize(
    ("setting", "read", "value"),
    [
        ("run.seed=7", lambda s: s.run.seed, 7),
        ("run.algorithm=jacobi", lambda s: s.run.algorithm, "jacobi"),
        ("title=other words", lambda s: s.title, "other words"),
        ("components.plant.start.x=[1,2]", lambda s: s.components["plant"].start["x"], [1, 2]),
        (
            "components.control.inputs.u.gain=3",
            lambda s: s.components["control"].inputs["u"].gain,
            3,
        ),
        ("links.0.delay.delay='5 ms'", lambda s: s.links[0].delay["delay"], "5 ms"),
        ("run.record.every=5", lambda s: s.run.record.every, 5),
    ],
)
def test_settings_change_one_value(file, setting, read, value):
    assert read(load(file, [setting])) == value


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("seed", "expected path=value"),
        ("=3", "expected path=value"),
        (
            "components.pant.period=1",
            "no 'pant' in components; did you mean 'plant'?",
        ),
        ("run.seeds=1", "at run: no key 'seeds'; did you mean 'seed'? (there are: "),
        ("run.seed='x'", "at run.seed: expected a whole number, found 'x'"),
        ("links.3.name='x'", "'3' is not a valid index; expected an integer below 1"),
        ("links.x=3", "'x' is not a valid index; expected an integer below 1"),
        ("run.step.x=1", "run.step is not a table"),
        (
            "components.plant.kind=both",
            "components.plant.kind: Invalid enum value 'both'; expected one of sampled, continuous",
        ),
        ("runn.step=1", "no 'runn' in the file; did you mean 'run'? (there are: components, "),
    ],
)
def test_a_wrong_setting_is_refused(file, setting, message):
    with pytest.raises(ScenarioError) as error:
        load(file, [setting])
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no [run] table"),
        ("[run]\nstep=1\nstop=2", "no [components] table"),
        ("[run\n", "not valid TOML"),
        ("speed = 1\n" + TEXT, "unknown key 'speed'"),
        (TEXT.replace("stop = 2", ""), "at run: the key 'stop' is missing"),
        (TEXT.replace("[components.control]", '[components."a b"]'), "'a b' is not an identifier"),
        (TEXT.replace("[[links]]", "[links]"), "expected an array of tables, [[links]]"),
        (
            TEXT.replace("to = ", "too = "),
            "at links.0: no key 'too'; did you mean 'to'?",
        ),
    ],
)
def test_a_wrong_file_says_what_and_where(tmp_path, text, message):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        load(path)
    assert message in str(error.value)
    assert "wrong.toml" in str(error.value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"title = '\xe9'")
    for path, message in (
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "is a folder"),
        (tmp_path / "latin.toml", "cannot be read"),
    ):
        with pytest.raises(ScenarioError, match=message):
            load(path)


def test_values_take_the_shape_of_their_port():
    assert numbers(3, (2, 2), "1", "x") == (3.0,) * 4
    assert numbers([[1, 2], [3, 4]], (2, 2), "1", "x") == (1, 2, 3, 4)
    assert numbers(["1 ms", 2], (2,), "s", "x") == (0.001, 2.0)
    assert numbers(True, (), "1", "x") == (1.0,)
    for wrong in ([1, 2, 3], [[1, 2], [3]], [1, [2]], {"a": 1}, None):
        with pytest.raises(ScenarioError):
            numbers(wrong, (2, 2), "1", "x")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 9) | st.floats(0.1, 5) | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(st.data())
def test_any_mutation_of_a_document_is_read_or_refused_with_a_sentence(data):
    document = tomllib.loads(TEXT)
    node, keys = document, []
    while isinstance(node, dict | list) and node and (not keys or data.draw(st.booleans())):
        parent = node
        keys.append(
            data.draw(st.sampled_from(sorted(node) if isinstance(node, dict) else range(len(node))))
        )
        node = parent[keys[-1]]
    parent[keys[-1]] = data.draw(JSON)
    try:
        build(document, Path("mutated.toml"))
    except CosimError as error:
        assert "mutated.toml" in str(error)


def test_a_document_may_have_numbers_and_arrays_of_numpy() -> None:
    document = {
        "run": {"step": np.float64(1e-3), "stop": np.float32(0.5), "seed": np.int64(7)},
        "components": {
            "arm": {
                "model": "fmus.models.planar2r",
                "parameters": {"k_p": np.array([3.0, 4.0])},
                "start": {"q": (np.float64(0.1), 0.2), "tau": np.zeros(2)},
            }
        },
    }
    made = build(document, Path("numpy.toml"))
    (step,) = assemble(made).components
    assert (made.run.seed, step.values["q"], step.values["k_p"]) == (7, (0.1, 0.2), (3.0, 4.0))
    with pytest.raises(ScenarioError, match="finite"):
        build({**document, "run": {"step": np.float64("nan"), "stop": 1}}, Path("numpy.toml"))
