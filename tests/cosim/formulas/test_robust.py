"""The robustness of formulas, against its definition and closed forms."""

from __future__ import annotations

from math import inf, nan, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.formulas.syntax import read
from tests.cosim.formulas import naive, texts
from tests.cosim.formulas.recorded import requirement, rows

UNITS = {"a.x": "m", "b.x": "m"}
TIMES = st.lists(st.integers(1, 3), min_size=1, max_size=11).map(
    lambda steps: [0.0, *np.cumsum(steps).astype(float)]
)
UNIFORM = st.integers(2, 12).map(lambda n: [float(k) for k in range(n)])


@given(st.data(), texts.formulas(), st.one_of(UNIFORM, TIMES))
@settings(max_examples=80, deadline=None)
def test_the_value_is_that_of_the_definition(
    data: st.DataObject, text: str, t: list[float]
) -> None:
    x = {name: data.draw(texts.values(len(t))) for name in texts.SIGNALS}
    formula = read(text)
    expected = naive.robustness(formula, t, x)
    found = requirement(UNITS, formula=text).evaluate(rows(t, UNITS, a_x=x["a.x"], b_x=x["b.x"]))
    if naive.tail(formula) > t[-1]:
        assert found.verdict == "inconclusive" or abs(expected) < inf
        return
    if abs(expected) == inf:
        assert found.verdict == "inconclusive" and found.value != found.value
        return
    assert found.value == expected
    assert found.verdict == ("passed" if expected >= 0 else "failed")


@given(st.data(), texts.formulas(), UNIFORM, st.integers(1, 11))
@settings(max_examples=80, deadline=None)
def test_what_a_part_of_a_run_decides_stays_decided(
    data: st.DataObject, text: str, t: list[float], n: int
) -> None:
    x = [data.draw(texts.values(len(t))) for _ in range(2)]
    one = requirement(UNITS, formula=text)
    whole = one.evaluate(rows(t, UNITS, a_x=x[0], b_x=x[1]))
    n = min(n, len(t) - 1)
    signals = rows(t[:n], UNITS, a_x=x[0][:n], b_x=x[1][:n])
    part = one.evaluate(signals, end=t[-1] + 5.0)  # the run was to be longer
    longer = one.evaluate(rows(t, UNITS, a_x=x[0], b_x=x[1]), end=t[-1] + 5.0)
    if part.verdict != "inconclusive":
        assert longer.verdict == part.verdict
    assert whole.verdict in ("passed", "failed", "inconclusive")


@given(st.data(), texts.formulas(), UNIFORM)
@settings(max_examples=60, deadline=None)
def test_the_time_is_that_of_the_value(data: st.DataObject, text: str, t: list[float]) -> None:
    """Somewhere in the row of the time a comparison has the margin as its distance."""
    x = {name: data.draw(texts.values(len(t))) for name in texts.SIGNALS}
    signals = rows(t, UNITS, a_x=x["a.x"], b_x=x["b.x"])
    found = requirement(UNITS, formula=text).evaluate(signals)
    if found.value != found.value:
        return
    k = t.index(found.time)
    bounds = [float(word) for word in text.replace("(", " ").split() if "." in word
              and word.lstrip("-").replace(".", "").isdigit()]  # fmt: skip
    distances = {abs(x[name][k] - bound) for name in texts.SIGNALS for bound in bounds}
    assert abs(found.value) in distances


def test_a_sine_has_its_closed_form() -> None:
    t = np.arange(0, 20.0, 1e-3)
    x = [sin(s) for s in t]
    signals = rows(list(t), {"a.x": "m"}, a_x=x)

    def margin(text: str) -> float:
        return requirement({"a.x": "m"}, formula=text).evaluate(signals).value

    assert margin("always a.x <= 1.2 m") == pytest.approx(0.2, abs=1e-6)
    assert margin("always within [3.3 s, 5 s] a.x <= 0 m") == pytest.approx(-sin(3.3), abs=2e-3)
    assert margin("eventually within 1 s a.x >= 0.5 m") == pytest.approx(sin(1) - 0.5, abs=1e-3)
    # wherever it is, it comes to its top within half a period, to sin(pi/4) within 3/4 of one
    assert margin(f"always eventually within {1.5 * pi:.9f} s a.x >= 0 m") == pytest.approx(
        sqrt(0.5), abs=2e-3
    )


@pytest.mark.parametrize(
    ("text", "margin", "time", "words"),
    [
        ("always a.x <= 4 m", 1.0, 2.0, "passed, margin 1 m, closest at 2 s"),
        ("always a.x <= 2 m", -1.0, 2.0, "failed, margin -1 m, worst at 2 s"),
        ("eventually a.x >= 2 m", 1.0, 2.0, "passed, margin 1 m, best at 2 s"),
        ("eventually a.x >= 5 m", -2.0, 2.0, "failed, margin -2 m, closest at 2 s"),
        ("a.x <= 1 m", 0.0, 0.0, "passed, margin 0 m, decided at 0 s"),
        ("always within [1.5 s, 1.7 s] a.x <= 4 m", 2.0, 1.0, "passed, margin 2 m, closest at 1 s"),
        ("always within [1.5 s, 2 s] a.x <= 4 m", 1.0, 2.0, "passed, margin 1 m, closest at 2 s"),
        ("always after 3 s a.x <= 4 m", 3.0, 3.0, "passed, margin 3 m, closest at 3 s"),
        ("a.x <= 2 m until a.x >= 3 m", 0.0, 2.0, ""),
        ("a.x <= 1 m until within [2 s, 3 s] a.x >= 3 m", -1.0, 1.0, ""),
    ],
)  # fmt: skip
def test_examples_by_hand(text: str, margin: float, time: float, words: str) -> None:
    signals = rows([0.0, 1.0, 2.0, 3.0], {"a.x": "m"}, a_x=[1.0, 2.0, 3.0, 1.0])
    found = requirement({"a.x": "m"}, formula=text).evaluate(signals)
    assert (found.value, found.time) == (margin, time)
    assert not words or found.text == words


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("text", ["always a.x <= 9 m", "always a.x >= -9 m", "not (a.x <= 9 m)"])
def test_a_value_that_is_no_number_violates(bad: float, text: str) -> None:
    signals = rows([0.0, 1.0], {"a.x": "m"}, a_x=[bad, 1.0])
    found = requirement({"a.x": "m"}, formula=text).evaluate(signals)
    assert (found.verdict, found.value, found.time) == ("failed", -inf, 0.0)
    assert found.text == f"failed, a.x is {bad} at 0 s"


def test_a_part_of_a_run_is_inconclusive_where_the_rest_could_change_it() -> None:
    signals = rows([0.0, 1.0], {"a.x": "m"}, a_x=[1.0, 2.0])

    def verdict(text: str, end: float) -> str:
        return requirement({"a.x": "m"}, formula=text).evaluate(signals, end).text

    assert verdict("always a.x <= 3 m", 9.0) == (
        "inconclusive, margin 1 m when the run ended at 1 s"
    )
    assert verdict("always a.x <= 1 m", 9.0).startswith("failed, margin -1 m")
    assert verdict("eventually a.x >= 2 m", 9.0).startswith("passed")
    assert verdict("eventually a.x >= 3 m", 9.0).startswith("inconclusive")
    assert verdict("always within 1 s a.x <= 3 m", 9.0).startswith("passed")
    assert verdict("always a.x <= 3 m", 1.0).startswith("passed")
    assert verdict("always after 5 s a.x <= 3 m", 1.0) == (
        "inconclusive: its interval is beyond the end of the run at 1 s"
    )


def test_units_are_converted_and_the_margin_is_in_that_of_the_signal() -> None:
    units = {"a.q[0]": "deg", "a.q[1]": "deg", "a.f": "N"}
    signals = rows([0.0], units, a_q_0=[30.0], a_q_1=[40.0], a_f=[4.0])

    def found(text: str) -> tuple[float, str]:
        result = requirement(units, formula=text).evaluate(signals)
        return round(result.value, 9), result.unit

    assert found("norm(a.q) <= 60 deg") == (10.0, "deg")
    assert found(f"norm(a.q) <= {pi / 3} rad") == (10.0, "deg")
    assert found("a.q <= 50 deg") == (10.0, "deg")  # every entry
    assert found("max(a.q) - min(a.q) <= 15 deg") == (5.0, "deg")
    assert found("abs(a.q[0] - a.q[1]) <= 9 deg") == (-1.0, "deg")
    assert found("norm(a.q - [30, 40] deg) <= 1 deg") == (1.0, "deg")
    assert found("20 deg <= a.q <= 45 deg") == (5.0, "deg")
    assert found("a.f * 2 <= 0.01 kN") == (2.0, "N")
    assert found("2 * -a.f / 2 >= -5 N") == (1.0, "N")
    assert found("a.f <= 5 N and a.q <= 50 deg") == (0.2, "1")  # a share of each bound


def test_a_run_need_not_start_at_zero() -> None:
    signals = rows([10.0, 11.0, 12.0], {"a.x": "m"}, a_x=[5.0, 1.0, 3.0])
    found = requirement({"a.x": "m"}, always="a.x <= 4 m", after="1 s").evaluate(signals)
    assert (found.value, found.time) == (1.0, 12.0)
