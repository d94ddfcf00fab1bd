"""Units: what they read as, what fits what, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import UnitError
from cosim.base.units import conversion, parse, quantity, time_text


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("N.m", "kg.m2/s2"),
        ("N*m", "N.m"),
        ("N·m.s/rad", "N.m.s/rad"),
        ("rad/s", "rad.s-1"),
        ("", "1"),
        ("W", "N.m/s"),
        ("1/s", "Hz"),
        ("m/s/s", "m.s^-2"),
        ("kg/(m.s)", "kg.m-1.s-1"),
        ("W/(m2.K)", "W.m-2.K-1"),
        ("1/(s/m)", "m/s"),
        ("J/(kg.(K.s))/m", "J.kg-1.K-1.s-1.m-1"),
        ("[m3]", "m3"),
    ],
)
def test_different_spellings_are_the_same_unit(text, same):
    assert parse(text) == parse(same)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("5 ms", "s", 0.005),
        ("300 us", "s", 3e-4),
        ("180 deg", "rad", math.pi),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("1.5 kN.m", "N.m", 1500.0),
        ("2 h", "s", 7200.0),
        ("20 degC", "K", 293.15),
    ],
)
def test_quantities_with_units_are_converted(text, unit, value):
    assert quantity(text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("5 mm", "[mm] cannot feed [s]"),
        ("5", "has no unit"),
        ("five ms", "not a number with a unit"),
        ("5 xs", "unknown unit 'xs'"),
        ("5 Nm", "unknown unit 'Nm' in 'Nm'; did you mean 'N.m'?"),
        ("5 m//s", "cannot be read"),
        ("5 m/(s", "lacks a closing parenthesis"),
        ("5 m/s)", "cannot be read"),
    ],
)
def test_what_is_no_duration_says_why(text, message):
    with pytest.raises(UnitError) as error:
        quantity(text, "s")
    assert message in str(error.value)


def test_powers_of_rad_connect_but_nothing_else_does():
    assert conversion("N.m/rad", "N.m") == (1.0, 0.0)
    assert conversion("deg/s", "1/s")[0] == pytest.approx(math.pi / 180)
    with pytest.raises(UnitError, match="cannot feed"):
        conversion("rad/s", "rad")


UNITS = ["mm", "km", "m", "deg", "rad", "rev", "ms", "min", "N.m", "kN.m", "degC", "K"]


@given(st.sampled_from(UNITS), st.sampled_from(UNITS), st.floats(-1e6, 1e6))
def test_there_and_back_is_where_it_was(a, b, x):
    try:
        gain, offset = conversion(a, b)
    except UnitError:
        return
    back, shift = conversion(b, a)
    assert back * (gain * x + offset) + shift == pytest.approx(x, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.6, "600 ms"),
        (0.0, "0 s"),
        (60.0, "60 s"),
        (2.0954, "2.095 s"),
        (0.99999, "1 s"),
        (-7.4e-5, "-74 us"),
        (2e-9, "2 ns"),
        (3e-12, "0.003 ns"),
        (86412.0, "86412 s"),
        (math.nan, "nan s"),
        (math.inf, "inf s"),
    ],
)
def test_times_have_the_unit_in_which_they_are_short(seconds, text):
    assert time_text(seconds) == text


@given(st.floats(1e-9, 1e9))
def test_the_text_of_a_time_can_be_read_again(seconds):
    assert quantity(time_text(seconds), "s") == pytest.approx(seconds, rel=6e-4)
