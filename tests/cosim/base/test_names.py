"""A name that is not known: the nearest is named, also where only the case differs."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from cosim.base.convert import convert
from cosim.base.errors import ScenarioError
from cosim.base.names import counted, hint, listed, nearest, signal_of, unknown


@pytest.mark.parametrize(
    ("name", "found"),
    [("k", "K"), ("LAMBDA_m", "lambda_M"), ("lamda_M", "lambda_M"), ("x", ""), ("", "")],
)
def test_the_nearest(name: str, found: str) -> None:
    assert nearest(name, ["K", "lambda_M", "Gamma"]) == found
    assert hint(name, ["K", "lambda_M"]) == (f"; did you mean {found!r}?" if found else "")


def test_the_sentence_lists_what_there_is() -> None:
    said = "no signal 'q'; did you mean 'Q'? (there are: Q, tau)"
    assert unknown("q", ["tau", "Q"], "signal") == said
    assert unknown("q", [], "signal") == "no signal 'q' (there are: none)"


class Inner(msgspec.Struct, forbid_unknown_fields=True, tag="inner", tag_field="law"):
    """A part of a file."""

    low: float = 0.0


class Other(msgspec.Struct, forbid_unknown_fields=True, tag="other", tag_field="law"):
    """Another one."""

    high: float = 0.0


class Outer(msgspec.Struct, forbid_unknown_fields=True):
    """A file."""

    parts: list[Inner | Other] = []
    named: dict[str, Inner] = {}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"part": 1}, ": no key 'part'; did you mean 'parts'? (there are: named, parts)"),
        (
            {"parts": [{"law": "inner", "lwo": 1}]},
            ".parts[0]: no key 'lwo'; did you mean 'low'? (there are: high, low)",
        ),
        (
            {"parts": [{"law": "iner"}]},
            ".parts[0].law: no kind 'iner'; did you mean 'inner'? (there are: inner, other)",
        ),
        ({"named": {"a": {"low": "x"}}}, ".named.a.low: expected a number, found text"),
    ],
)
def test_a_key_of_a_file_that_is_not_known(value: object, said: str) -> None:
    with pytest.raises(ScenarioError) as error:
        convert(value, Outer, Path("x.toml"), "top")
    assert str(error.value) == f"x.toml at top{said}"


def test_of_thousands_of_names_the_nearest_and_the_first_ones_are_said() -> None:
    names = [f"robot{i:04}.q" for i in range(3000)]
    said = unknown("robto0007.q", names, "signal")
    assert "did you mean 'robot0007.q'?" in said
    assert said.endswith("robot0000.q, robot0001.q, robot0002.q, robot0003.q and 2996 more)")
    assert unknown("x", ["b", "a"], "signal") == "no signal 'x' (there are: a, b)"


def test_a_list_in_a_sentence_ends() -> None:
    names = [f"c{i}" for i in range(13)]
    assert listed(names[:12]) == ", ".join(names[:12])
    assert listed(names, " or ") == "c0 or c1 or c2 or c3 and 9 more"


@pytest.mark.parametrize(
    ("scalar", "signal"),
    [("a.q[0]", "a.q"), ("a.xi[1,0]", "a.xi"), ("a.xi[1][0]", "a.xi"), ("a.y", "a.y"),
     ("a.b[1].y", "a.b[1].y"), ("a.b[1].q[2]", "a.b[1].q")],
)  # fmt: skip
def test_the_signal_of_a_scalar(scalar: str, signal: str) -> None:
    assert signal_of(scalar) == signal


def test_numbers_in_names_count() -> None:
    names = ["robot10.q[2]", "robot2.q[10]", "robot2.q[9]", "plant", "2", "10", "", "robot"]
    assert sorted(names, key=counted) == [
        "", "2", "10", "plant", "robot", "robot2.q[9]", "robot2.q[10]", "robot10.q[2]"
    ]  # fmt: skip
