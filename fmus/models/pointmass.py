"""Point mass on a line with viscous friction: the paper's introductory example of manipulability.

The damping action is the control, and f is the force of a subject::

    m ddx + b dx = f          1 / (m p² + b p) from f to x

For b > 0 there is one pure integral, and the mass is infinitely manipulable with degree one: under
a constant force the velocity tends to f / b, and f = 1 / (t + 1), of finite L2 norm, moves the mass
beyond every bound. For b = 0 there are two integrals, and the degree is two.

The input `b_add` is added to b and may change with time, as long as the sum is not negative. It
models the time-varying damping of Sec. III. An unconnected `b_add` is 0.

Source: the paper, Sec. III, eqs (17), (18).

Continuous. The solution is exact for force and friction held over the step h, with z = -b h / m::

    x(t + h)  = x + h φ1 dx + h² φ2 f / m       φ1 = (exp z - 1) / z,   φ1 = 1    for b = 0
    dx(t + h) = exp(z) dx + h φ1 f / m          φ2 = (φ1 - 1) / z,      φ2 = 1/2
"""

from __future__ import annotations

from math import isfinite

from cosim.base.errors import RunError, ScenarioError
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np


def model() -> Model:
    """Declare the point mass; by default 1 kg and 1 N.s/m."""
    return Model(
        identifier="pointmass",
        description="Point mass on a line with viscous friction",
        kind="continuous",
        variables=(
            Variable("f", "input", (), "N", description="Force on the mass"),
            Variable(
                *("b_add", "input", (), "N.s/m", 0.0, "Viscous friction added to b"), optional=True
            ),
            Variable("x", "output", (), "m", settable=True, description="Position"),
            Variable("dx", "output", (), "m/s", settable=True, description="Velocity"),
            Variable("m", "parameter", (), "kg", 1.0, "Mass, more than 0", minimum=0.0),
            Variable("b", "parameter", (), "N.s/m", 1.0, "Viscous friction", minimum=0.0),
        ),
        sources=("pointmass.c",),
        step=1e-2,
        states=(("x", "dx"), ("dx", "ddx")),
        rates=(Variable("ddx", "local", (), "m/s2", description="Acceleration"),),
        terminals=(Terminal("port", ("f", "x", "dx"), "Force in, motion out"),),
        documentation=__doc__ or "",
        lanes=True,
    )


def exponential(z: float) -> tuple[float, float, float]:
    """(exp z, φ1, φ2) for z <= 0, dimensionless, without cancellation.

    A series where |z| <= 1/2; from there by doubling, φ2(2z) = φ1²/4 + φ2/2,
    φ1(2z) = φ1 (1 + exp z)/2.
    """
    doublings = 0
    while z < -0.5:
        z, doublings = z / 2, doublings + 1
    p = 1.0
    for k in range(16, 2, -1):
        p = 1 + z * p / k
    phi2 = p / 2
    phi1 = 1 + z * phi2
    E = 1 + z * phi1
    for _ in range(doublings):
        phi2 = phi1 * phi1 / 4 + phi2 / 2
        phi1 *= (1 + E) / 2
        E *= E
    return E, phi1, phi2


def law(x: Values, t: float, h: float, f: Array, b_add: Array) -> Values:
    """The closed form above: x, m, and dx, m/s, after `h` s under `f`, N; all are scalar.

    Raises RunError if b + `b_add` (N.s/m) is negative, or b h / m is too large a number.
    """
    b = x["b"] + b_add
    if b < 0.0:
        raise RunError(f"b + b_add is {b:g} N.s/m, expected at least 0", time=t)
    with np.errstate(over="ignore"):
        z = float(-b / x["m"] * h)
    if not isfinite(z):
        raise RunError("b h / m exceeds the range of float64", time=t)
    E, phi1, phi2 = exponential(z)
    place, dx, ddx = x["x"], x["dx"], f / x["m"]
    return {"x": place + h * (phi1 * dx + h * phi2 * ddx), "dx": E * dx + h * phi1 * ddx}


def start(x: Values, f: Array, b_add: Array) -> Values:
    """Outputs at the start, scalar; they do not depend on the inputs.

    Raises ScenarioError if m is 0.
    """
    if x["m"] <= 0:
        raise ScenarioError("m is 0, expected more than 0", "pointmass.m")
    return {"x": x["x"], "dx": x["dx"]}


fmu, kernel, PointMass = derive(model, law, start)
