"""Operator at the endpoint: a hand that holds the tip of the arm with a spring and a damper.

The links have the lengths l = (l1, l2); x_h is the target of the hand in the plane of the arm::

    x     = [ l1 c1 + l2 c12 ]      J = dx/dq = [ -l1 s1 - l2 s12   -l2 s12 ]
            [ l1 s1 + l2 s12 ]                  [  l1 c1 + l2 c12    l2 c12 ]

    f     = K_h (x_h - x) + B_h (dx_h - J dq)       force of the hand on the tip
    tau_h = J' f

Typical values of a human hand are K_h from 50 N/m (relaxed) to 500 N/m (tight) and B_h from 5 to
20 N.s/m. The mass of the hand, 0.5 to 1.5 kg, is not part of this model: it moves with the tip and
must be included in the inertia theta of the arm.

Source: own construction, the PD operator of the paper (Sec. VII) in Cartesian coordinates, with the
forward kinematics and the transposed Jacobian of an arm with two revolute joints.

Sampled: inputs are read at t_k, outputs are held to the next step. An unconnected x_h is (0, 1) m.
"""

from __future__ import annotations

from fmus.arms.joints import DQ, TORQUE, Q, gain
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

#: From a hand that rests on the arm to one that grips it tightly.
PRESETS: dict[str, dict[str, float]] = {
    "relaxed": {"K_h": 50.0, "B_h": 5.0},
    "firm": {"K_h": 200.0, "B_h": 10.0},
    "tight": {"K_h": 500.0, "B_h": 20.0},
}

_ALL = ("q", "dq", "x_h", "dx_h")


def model() -> Model:
    """Declare the operator; the defaults are ``firm`` and links of 1 m."""
    return Model(
        identifier="endpoint_operator",
        description="Operator holding the tip of the arm with a spring and a damper",
        kind="sampled",
        variables=(
            Q,
            DQ,
            Variable("x_h", "input", (2,), "m", (0.0, 1.0), "Endpoint the hand wants"),
            Variable(
                *("dx_h", "input", (2,), "m/s", 0.0, "Velocity of the endpoint it wants"),
                optional=True,
            ),
            Variable(
                "tau_h",
                "output",
                (2,),
                TORQUE,
                description="Torque of the operator on the robot",
                depends=_ALL,
                start_depends=("l", "K_h", "B_h"),
            ),
            Variable(
                "x",
                "output",
                (2,),
                "m",
                description="Endpoint",
                depends=("q",),
                start_depends=("l",),
            ),
            Variable(
                "f",
                "output",
                (2,),
                "N",
                description="Force of the hand on the endpoint",
                depends=_ALL,
                start_depends=("l", "K_h", "B_h"),
            ),
            Variable("l", "parameter", (2,), "m", 1.0, "Lengths of the links", minimum=0.0),
            gain("K_h", "N/m", 200.0, "Stiffness of the hand, each direction"),
            gain("B_h", "N.s/m", 10.0, "Damping of the hand, each direction"),
        ),
        sources=("endpoint_operator.c", "trig.c"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau_h"), "Motion in, torque out"),
            Terminal("endpoint", ("x_h", "dx_h", "x", "f"), "Target, place and force"),
        ),
        documentation=__doc__ or "",
    )


def endpoint(l: Array, q: Array) -> Array:  # noqa: E741
    """x(q), m, (2,); `l` (2,) m, `q` (2,) rad."""
    angles = np.array([q[0], q[0] + q[1]])
    return np.array([l @ np.cos(angles), l @ np.sin(angles)])


def jacobian(l: Array, q: Array) -> Array:  # noqa: E741
    """J = dx/dq, m/rad, (2, 2); `l` (2,) m, `q` (2,) rad."""
    near = l * np.array([np.cos(q[0]), np.cos(q[0] + q[1])])
    up = l * np.array([np.sin(q[0]), np.sin(q[0] + q[1])])
    return np.array([[-up.sum(), -up[1]], [near.sum(), near[1]]])


def law(x: Values, t: float, h: float, q: Array, dq: Array, x_h: Array, dx_h: Array) -> Values:
    """The equations above: tau_h (m,) N.m; the endpoint x (2,) m and the force f (2,) N there.

    `q`, `dq` (m,) rad, rad/s; `x_h`, `dx_h` (2,) m, m/s: target of the endpoint and its velocity.
    """
    place, J = endpoint(x["l"], q), jacobian(x["l"], q)
    f = x["K_h"] * (x_h - place) + x["B_h"] * (dx_h - J @ dq)
    return {"tau_h": J.T @ f, "x": place, "f": f}


fmu, kernel, EndpointOperator = derive(model, law)
