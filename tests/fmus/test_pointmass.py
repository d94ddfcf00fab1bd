"""The point mass of Sec. III: exact at any step, and of degree one with friction, two without."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import exp, expm1, log, log1p

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.models import pointmass
from fmus.models.pointmass import PointMass, exponential
from tests.fmus.loops import arrays


@pytest.fixture(
    scope="module",
    params=[pytest.param(PointMass, marks=pytest.mark.slow), pointmass.kernel],
    ids=["numpy", "c"],
    name="mass",
)
def mass_(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


@given(z=st.floats(-700.0, 0.0))
def test_the_exponentials_are_right_to_the_last_digits(z: float) -> None:
    E, phi1, phi2 = exponential(z)
    assert pytest.approx(exp(z), rel=2e-13) == E
    assert phi1 == pytest.approx(expm1(z) / z if z else 1.0, rel=1e-14)
    x, term, total = Fraction(z), Fraction(1, 2), Fraction(0)
    if abs(z) > 1:
        total = (Fraction(phi1) - 1) / x
    else:
        for k in range(3, 30):
            total, term = total + term, term * x / k
    assert phi2 == pytest.approx(float(total), rel=1e-13)


@given(
    m=st.floats(0.01, 100), b=st.floats(0, 100), h=st.floats(1e-4, 10), f=st.floats(-10, 10),
    x=st.floats(-10, 10), dx=st.floats(-10, 10),
)  # fmt: skip
def test_one_step_is_many_small_ones(
    mass: Component, m: float, b: float, h: float, f: float, x: float, dx: float
) -> None:
    ends = []
    for n in (1, 16):
        mass.initialize(arrays(m=m, b=b, x=x, dx=dx))
        for k in range(n):
            y = mass.step(k * h / n, h / n, arrays(f=f))
        ends.append([float(y["x"]), float(y["dx"])])  # type: ignore[arg-type]
    size = 1 + abs(x) + (h + 1) * (abs(dx) + h * abs(f) / m)
    assert np.allclose(ends[0], ends[1], rtol=0, atol=1e-13 * size)


@given(m=st.floats(0.1, 10), b=st.floats(0.1, 10), f=st.floats(-10, 10), dx=st.floats(-10, 10))
def test_a_step_solves_the_equation(
    mass: Component, m: float, b: float, f: float, dx: float
) -> None:
    """m ddx + b dx = f: dx = f/b + (dx0 - f/b) exp(-b t/m), x = x0 + (m (dx0 - dx) + f t) / b."""
    t = 0.7
    mass.initialize(arrays(m=m, b=b, x=1.0, dx=dx))
    y = mass.step(0.0, t, arrays(f=f))
    speed = f / b + (dx - f / b) * exp(-b * t / m)
    assert np.allclose(y["dx"], speed, rtol=1e-12, atol=1e-12)
    assert np.allclose(y["x"], 1.0 + (m * (dx - speed) + f * t) / b, rtol=1e-11, atol=1e-11)


def distance(mass: Component, b: float, seconds: float) -> float:
    """Where a constant force of 1 N takes a mass of 1 kg."""
    mass.initialize(arrays(b=b))
    return float(mass.step(0.0, seconds, arrays(f=1.0))["x"])  # type: ignore[arg-type]


@pytest.mark.parametrize(("b", "degree"), [(1.0, 1), (0.0, 2)])
def test_the_degree_is_the_number_of_pure_integrals(mass: Component, b: float, degree: int) -> None:
    """Ten times as long, ten times as far with friction, a hundred times without."""
    growth = distance(mass, b, 1e5) / distance(mass, b, 1e4)
    assert log(growth, 10) == pytest.approx(degree, abs=1e-3)


def test_a_force_that_fades_moves_the_mass_without_bound(mass: Component) -> None:
    """f = 1/(t+1): m dx = -b x + log(t + 1), which x follows; the norm of f stays below 1."""
    h = 0.01
    mass.initialize({})
    for k in range(20000):
        y = mass.step(k * h, h, arrays(f=1.0 / (k * h + h / 2 + 1.0)))
        if k == 2000:
            early = float(y["x"])  # type: ignore[arg-type]
    last, speed = float(y["x"]), float(y["dx"])  # type: ignore[arg-type]
    assert last + speed == pytest.approx(log1p(200.0), abs=1e-4)
    assert last > early + 2.0


def test_values_it_cannot_take_are_refused(mass: Component) -> None:
    for values in (arrays(m=0.0), arrays(m=-1.0), arrays(b=-1.0), arrays(x=np.inf)):
        with pytest.raises(CosimError, match=next(iter(values))):
            mass.initialize(values)
    mass.initialize(arrays(b=1e300, m=1e-300))
    with pytest.raises(CosimError, match="range of float64"):
        mass.step(0.0, 1.0, {})


@given(b=st.floats(0, 10), b_add=st.floats(0, 10), f=st.floats(-10, 10))
def test_friction_that_is_added_is_friction(
    mass: Component, b: float, b_add: float, f: float
) -> None:
    ends = []
    for kept, added in ((b, b_add), (b + b_add, 0.0)):
        mass.initialize(arrays(b=kept, x=1.0, dx=-2.0))
        ends.append(mass.step(0.0, 0.3, arrays(f=f, b_add=added)))
    assert ends[0] == ends[1]


def test_friction_that_drives_is_refused(mass: Component) -> None:
    mass.initialize(arrays(b=1.0))
    with pytest.raises(CosimError, match="b_add is"):
        mass.step(0.0, 0.1, arrays(b_add=-1.5))
