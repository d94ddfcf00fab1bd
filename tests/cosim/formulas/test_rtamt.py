"""Formulas against rtamt, the monitor of signal temporal logic of Nickovic & Yamaguchi (2020)."""

from __future__ import annotations

import re
from math import inf
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cosim.formulas.syntax import read
from tests.cosim.formulas import naive, texts
from tests.cosim.formulas.recorded import requirement, rows

pytestmark = pytest.mark.slow
UNITS = {"a.x": "m", "b.x": "m"}


def _translated(text: str) -> str:
    """The formula as rtamt writes it: intervals in steps, no units."""
    text = re.sub(r"within \[(\d+) s, (\d+) s\]", r"[\1:\2]", text)
    text = re.sub(r"within (\d+) s", r"[0:\1]", text)
    text = text.replace("a.x", "a").replace("b.x", "b").replace(" m", "")
    return re.sub(r"(always|eventually|until) \[", r"\1[", text)


def _of_rtamt(text: str, t: list[float], x: dict[str, list[float]]) -> float:
    rtamt: Any = pytest.importorskip("rtamt")
    spec = rtamt.StlDiscreteTimeSpecification()
    spec.declare_var("a", "float")
    spec.declare_var("b", "float")
    spec.spec = _translated(text)
    spec.parse()
    found = spec.evaluate({"time": t, "a": x["a.x"], "b": x["b.x"]})
    return float(found[0][1])


@given(st.data(), texts.formulas(unbounded=False), st.integers(13, 30))
@settings(max_examples=150, deadline=None)
def test_bounded_formulas_have_the_value_of_rtamt(data: st.DataObject, text: str, n: int) -> None:
    t = [float(k) for k in range(n)]
    assume(naive.tail(read(text)) < n)  # rtamt fills up what is behind the end
    x = {name: data.draw(texts.values(n)) for name in texts.SIGNALS}
    found = requirement(UNITS, formula=text).evaluate(rows(t, UNITS, a_x=x["a.x"], b_x=x["b.x"]))
    assert found.value == _of_rtamt(text, t, x)


@pytest.mark.parametrize(
    "text",
    [
        "always (a.x >= 1 m implies eventually (b.x >= 0 m))",
        "eventually always (a.x <= 2 m)",
        "(a.x <= 2 m) until (b.x >= 2 m)",
        "always ((a.x <= 3 m) until (b.x >= 1 m))",
        "not always (a.x <= 2 m or b.x <= 2 m)",
    ],
)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_formulas_of_the_whole_run_have_the_value_of_rtamt(data: st.DataObject, text: str) -> None:
    t = [float(k) for k in range(20)]
    x = {name: data.draw(texts.values(20)) for name in texts.SIGNALS}
    found = requirement(UNITS, formula=text).evaluate(rows(t, UNITS, a_x=x["a.x"], b_x=x["b.x"]))
    expected = _of_rtamt(text, t, x)
    assert abs(expected) < inf
    assert found.value == expected
