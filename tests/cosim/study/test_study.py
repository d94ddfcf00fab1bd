"""Study files: what they mean, and the sentences that refuse them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.study.axes import Drawn, literal, shares, spaced
from cosim.study.design import count, points
from cosim.study.study import Study, load_study
from tests.cosim.study.studies import STUDY, written

GAIN = "components.gain.parameters.gain"


def study(folder: Path, text: str) -> Study:
    return load_study(written(folder, text))


def test_a_grid_is_a_nested_loop_and_seeds_are_an_axis(tmp_path: Path) -> None:
    s = study(
        tmp_path,
        'seeds = 2\nscenario = "loop.toml"\nsettings = ["run.stop=2"]\n'
        f'[vary.gain]\npath = "{GAIN}"\nvalues = [1, 2.5]\n'
        '[vary.x]\npath = "components.plant.start.x"\nrange = [1, 100]\ncount = 3\nscale = "log"\n',
    )
    found = list(points(s))
    assert len(found) == count(s) == 12
    assert [tuple(p.cells.values()) for p in found[:3]] == [(1, 1.0, 0), (1, 1.0, 1), (1, 10.0, 0)]
    assert found[-1].settings == (
        "run.stop=2", f"{GAIN}=2.5", "components.plant.start.x=100.0", "run.seed=1",
    )  # fmt: skip
    assert len({p.run for p in found}) == 12


def test_paths_move_together_and_a_table_is_set_before_what_is_in_it(tmp_path: Path) -> None:
    s = study(
        tmp_path,
        'scenario = "loop.toml"\n[vary.low]\npaths = ["links.0.delay.low", "links.1.delay.low"]\n'
        'values = ["5 ms"]\n[vary.law]\npath = "links.0.delay"\nlabels = ["wide"]\n'
        'values = [{ law = "uniform", low = 0, high = 1 }]\n',
    )
    (point,) = points(s)
    assert point.settings == (
        'links.0.delay={"law" = "uniform", "low" = 0, "high" = 1}',
        'links.0.delay.low="5 ms"',
        'links.1.delay.low="5 ms"',
    )
    assert point.cells == {"low": "5 ms", "law": "wide"}


def test_cases_replace_whatever_they_name(tmp_path: Path) -> None:
    s = study(
        tmp_path,
        'scenario = "loop.toml"\n[vary.controller.cases]\n'
        f'weak = ["{GAIN}=1"]\nother = ["components.gain.model=my:Gain", "{GAIN}=2"]\n',
    )
    weak, other = points(s)
    assert (weak.cells, weak.settings) == ({"controller": "weak"}, (f"{GAIN}=1",))
    assert other.settings == ("components.gain.model=my:Gain", f"{GAIN}=2")


def test_a_run_is_known_by_what_it_is_and_not_by_how_the_file_is_written(tmp_path: Path) -> None:
    a = f'[vary.a]\npath = "{GAIN}"\nvalues = [1, 2]\n'
    b = '[vary.b]\npath = "components.plant.start.x"\nvalues = [3]\n'
    head = 'scenario = "loop.toml"\n'
    one, two = study(tmp_path, head + a + b), study(tmp_path, head + b + a.replace("y.a", "y.c"))
    assert [p.run for p in points(one)] == [p.run for p in points(two)]
    assert [p.run for p in points(one, "x")] != [p.run for p in points(one, "y")]
    more = study(tmp_path, head + a + b + '[metrics.e]\nkind = "peak"\nof = ["plant.y"]\n')
    assert {p.run for p in points(more)}.isdisjoint(p.run for p in points(one))


@given(st.integers(1, 200), st.integers(0, 2**32), st.text(max_size=8))
def test_a_latin_hypercube_has_one_value_in_each_stratum(n: int, seed: int, name: str) -> None:
    u = shares("latin-hypercube", n, seed, name)
    assert sorted(np.floor(u * n).astype(int)) == list(range(n))
    assert ((u > 0) & (u < 1)).all()
    assert (u == shares("latin-hypercube", n, seed, name)).all()


@given(st.integers(1, 100), st.integers(1, 100), st.integers(0, 2**32))
def test_more_samples_of_monte_carlo_begin_with_the_fewer(n: int, more: int, seed: int) -> None:
    longer = shares("monte-carlo", n + more, seed, "K")
    assert (longer[:n] == shares("monte-carlo", n, seed, "K")).all()


@given(st.floats(1e-9, 1 - 1e-9))
def test_values_stay_in_their_law(u: float) -> None:
    def value(law, a, b):
        return Drawn("x", ("p",), law, a, b).choice(u).cell

    assert -2 <= value("uniform", -2.0, 3.0) <= 3
    assert 0.1 <= value("loguniform", 0.1, 10.0) * (1 + 1e-12) <= 10.1
    assert value("integers", 1.0, 3.0) in (1, 2, 3)
    assert (value("normal", 5.0, 2.0) > 5) == (u > 0.5) or u == 0.5


def test_laws_have_the_quantiles_they_should() -> None:
    assert Drawn("x", ("p",), "loguniform", 1.0, 100.0).choice(0.5).cell == pytest.approx(10)
    assert Drawn("x", ("p",), "normal", 1.0, 2.0).choice(0.841344746).cell == pytest.approx(3)
    assert Drawn("x", ("p",), "uniform", 2.0, 4.0, "ms").choice(0.25).settings == ('p="2.5 ms"',)
    thirds = [Drawn("x", ("p",), "integers", 1.0, 3.0).choice(u).cell for u in (0.3, 0.5, 0.7)]
    assert thirds == [1, 2, 3]


def test_spacing_has_round_numbers_and_both_ends() -> None:
    assert spaced(0.1, 0.5, 5, "linear") == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert spaced(1, 1000, 4, "log") == [1.0, 10.0, 100.0, 1000.0]


LEAVES = st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False)
VALUES = st.recursive(
    LEAVES | st.text("aβ\"\\ \n'="),
    lambda x: st.lists(x, max_size=3) | st.dictionaries(st.text(max_size=4), x, max_size=3),
    max_leaves=8,
)


@given(VALUES)
def test_a_literal_reads_back(value: object) -> None:
    found = tomllib.loads(f"v = {literal(value)}")["v"]
    assert found == value
    assert type(found) is type(value)


BAD = [
    ("scenario = 3", "study.toml at scenario: expected text, found 3"),
    ('scenario = "no.toml"', "study.toml at scenario: "),
    ("title = 'x'", "study.toml: the key 'scenario' is missing"),
    ("scenario = ", "study.toml: not valid TOML"),
    (STUDY, "at vary.gain: found none of them; expected one of values, range, "),
    (STUDY + "values = [1]\ncount = 2", "at vary.gain: count and scale require range"),
    (STUDY + "values = [1]\nuniform = [1, 2]", "at vary.gain: found values and uniform; expected"),
    (STUDY + "values = []", "at vary.gain.values: no value"),
    (STUDY + "values = [1979-05-27]", "at vary.gain.values.0: datetime.date(1979, 5, 27) cannot"),
    (STUDY + "values = [1]\nlabels = ['a', 'b']", "at vary.gain.labels: 2 labels for 1 values"),
    (STUDY + "range = [1, 2]", "at vary.gain: missing key 'count' (number of points)"),
    (STUDY + "range = [0, 2]\ncount = 3\nscale = 'log'", "at vary.gain.range: found [0, 2]"),
    (STUDY + "valeus = [1]", "at vary.gain: no key 'valeus'; did you mean 'values'?"),
    (STUDY + "uniform = [1, 2]", "gain to be drawn; missing key 'count' of [sample]"),
    (STUDY + "uniform = [2, 1]", "at vary.gain.uniform: found [2, 1], expected [low, high]"),
    (STUDY + "loguniform = [0, 1]", "at vary.gain.loguniform: found low = 0, expected"),
    (STUDY + "integers = [0.5, 1]", "at vary.gain.integers: found [0.5, 1], expected"),
    (STUDY + "normal = [0, 0]", "at vary.gain.normal: found deviation 0, expected"),
    (STUDY + "cases = { a = ['b=1'] }", "at vary.gain: cases name their own paths"),
    (STUDY + "values = [1]\n[sample]\ncount = 3", "at sample: no axis has a law to draw from"),
    (STUDY + "values = [1]\n[vary.g]\npath = 'components.gain.parameters.gain'\nvalues = [2]",
     "at vary.g: components.gain.parameters.gain is varied by 'gain' already"),
    (STUDY.replace("gain]", "stable]") + "values = [1]",
     "at vary.stable: 'stable' is the name of"),
    ("scenario = 'loop.toml'\n[vary.a]\nvalues = [1]",
     "at vary.a: missing key 'path'"),
    ("scenario = 'loop.toml'\n[vary.a.cases]\nb = ['c']",
     "at vary.a.cases.b: found 'c', expected path"),
    ("scenario = 'loop.toml'\nsettings = ['c']", "at settings: found 'c', expected path=value"),
    ("scenario = 'loop.toml'\nseeds = []",
     "at seeds: no seed; expected a number of seeds or a list"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), BAD)
def test_bad_studies_are_refused_with_their_place(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ScenarioError) as error:
        study(tmp_path, text)
    assert said in str(error.value)
