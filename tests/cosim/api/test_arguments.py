"""Arguments of a wrong type are refused by a sentence; the package lists its public names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim

SCENARIO: dict[str, Any] = {"run": {"step": 0.1, "stop": 0.2}, "components": {}}
PATH = "a path of a scenario"


@pytest.mark.parametrize(
    ("call", "given", "says"),
    [
        ("run", {"scenario": 3}, "found scenario = 3, expected the path of a scenario, or a dict"),
        ("run", {"scenario": None}, "found scenario = None, expected the path"),
        ("run", {"scenario": {1: 2}}, r"found scenario = \{1: 2\}"),
        ("run", {"set": "a"}, r"found set = 'a', expected a dict of values by path, as \{"),
        ("run", {"set": ["run.stop=1"]}, "expected a dict of values by path"),
        ("run", {"stop": [1]}, r"found stop = \[1\], expected a number of seconds or a text"),
        ("run", {"stop": True}, "found stop = True"),
        ("run", {"seed": 1.5}, "found seed = 1.5, expected a whole number"),
        ("run", {"seed": "1"}, "found seed = '1', expected a whole number"),
        ("run", {"out": 7}, "found out = 7, expected a path"),
        ("run", {"progress": "yes"}, "found progress = 'yes', expected a function"),
        ("run", {"progress": lambda done: None}, "expected a function of two numbers: ticks done"),
        ("open", {"folder": None}, "found folder = None, expected a path"),
        ("check", {"scenario": 1.0}, "expected the path of a scenario, or a dict"),
        ("check", {"scenario": SCENARIO, "set": 3}, "found set = 3"),
        ("compare", {"scenario": SCENARIO}, "expected a path"),
        ("compare", {"scenario": "x", "controllers": "a"}, "found controllers = 'a', expected a"),
        ("compare", {"scenario": "x", "seeds": 0}, "expected a whole number of at least 1"),
        ("compare", {"scenario": "x", "jobs": "2"}, "found jobs = '2'"),
        ("sweep", {"study": 1, "out": "x"}, "found study = 1, expected a path"),
        ("sweep", {"study": "x", "out": "x", "resume": 1}, "expected True or False"),
        ("sweep", {"study": "x", "out": "x", "each": lambda: 0}, "a function of one argument: a r"),
        ("sweep", {"study": "x", "out": "x", "limit": -1}, "of at least 1"),
    ],
)
def test_a_wrong_type_is_named(call: str, given: dict[str, Any], says: str) -> None:
    given = {"scenario": SCENARIO, **given} if call == "run" else given
    with pytest.raises(cosim.CosimError, match=rf"^cosim\.{call}: .*{says}"):
        getattr(cosim, call)(**given)


@pytest.fixture(scope="module")
def result() -> cosim.RunResult:
    spring = cosim.component(inputs={}, outputs={"y": "rad"}, kind="continuous")(lambda: {"y": 1.0})
    run = {"step": np.float64(0.1), "stop": 0.2}
    return cosim.run({"run": run, "components": {"a": {"model": spring}}}, seed=np.int64(3))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("method", "given", "says"),
    [
        ("unit", (3,), "found name = 3, expected a name"),
        ("settles", ("a.y", 1.0, None, 1), "found band = None, expected a number or a text"),
        ("stays_below", ("a.y", [1]), r"found bound = \[1\], expected a number or a text"),
        ("stays_below", ("a.y", "1 Nm"), "did you mean 'N.m'"),
        ("age_stays_below", (3, 1), "found link = 3, expected a name"),
        ("is_identical_to", (3,), "found other = 3, expected a path"),
        ("plot", (3,), r"found names = \(3,\), expected a list of names"),
        ("__getitem__", (0,), "found signal = 0, expected a name"),
    ],
)
def test_a_run_names_a_wrong_argument(
    result: cosim.RunResult, method: str, given: tuple[Any, ...], says: str
) -> None:
    call = getattr(result, method)
    named = {"band": given[2], "within": given[3]} if method == "settles" else {}
    with pytest.raises(cosim.CosimError, match=says):
        call(*given[: 2 if named else None], **named)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"inputs": ["q"]}, r"found inputs = \['q'\], expected a dict of units by name"),
        ({"inputs": {"q": 3}}, "port 'q' is 3"),
        ({"inputs": {"q": "Nm"}}, "port 'q': unknown unit 'Nm' in 'Nm'; did you mean 'N.m'"),
        ({"inputs": {"q": (2, "Nm")}}, "did you mean 'N.m'"),
        ({"parameters": {"k": 3}}, r"expected a dict of \(default, unit\) by name"),
        ({"kind": "discrete"}, "found kind = 'discrete', expected \"sampled\" or"),
    ],
)
def test_a_component_names_a_wrong_argument(given: dict[str, Any], says: str) -> None:
    with pytest.raises(cosim.CosimError, match=says):
        cosim.component(**{"inputs": {}, "outputs": {"y": "rad"}, **given})


def test_numbers_of_numpy_are_numbers(result: cosim.RunResult) -> None:
    assert result.t[-1] == pytest.approx(0.2) and result.metadata["seed"] == 3


def test_a_long_value_is_cut() -> None:
    with pytest.raises(cosim.CosimError, match=r"found set = '\w{56}\.\.\., expected"):
        cosim.run(SCENARIO, set="x" * 500)  # type: ignore[arg-type]


def test_the_package_lists_what_is_public() -> None:
    assert dir(cosim) == sorted(cosim.__all__)
    assert all(hasattr(cosim, name) for name in dir(cosim))
