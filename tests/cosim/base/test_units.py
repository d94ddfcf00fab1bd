"""Units: what they read as, what fits what, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import UnitError
from cosim.base.units import conversion, parse, quantity


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
