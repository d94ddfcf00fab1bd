"""Dynamics of the planar arm with two revolute joints: M, C, g, and the regressor Y.

For any parameters theta (3,), kg.m2, and theta_g (2,), N.m, and any z (2,), dz (2,)::

    M(q) dz + C(q, dq) z + g(q) = Y(q, dq, z, dz) theta + G(q) theta_g

    Y = [ dz1   c2 (2 dz1 + dz2) - s2 (dq2 z1 + (dq1 + dq2) z2)   dz2       ]
        [ 0     c2 dz1 + s2 dq1 z1                                dz1 + dz2 ]

    G = [ c1   c12 ]     c1 = cos q1, c2 = cos q2, s2 = sin q2, c12 = cos (q1 + q2)
        [ 0    c12 ]

g is the gradient of theta_g1 sin q1 + theta_g2 sin (q1 + q2), the potential energy.

Source: the paper, eq. (1) and Property 3 (linearity in the parameters); M, C and g are those of
``planar2r``.
"""

from __future__ import annotations

from fmus.model.numeric import Array, np


def inertia(theta: Array, q: Array) -> Array:
    """M(q), kg.m2, (2, 2); `theta` (3,) kg.m2, `q` (2,) rad."""
    c2 = np.cos(q[1])
    m12 = theta[2] + theta[1] * c2
    return np.array([[theta[0] + 2 * theta[1] * c2, m12], [m12, theta[2]]])


def coriolis(theta: Array, q: Array, dq: Array) -> Array:
    """C(q, dq), kg.m2/s, (2, 2), of Christoffel symbols, so that dM/dt - 2 C is skew-symmetric."""
    c = theta[1] * np.sin(q[1])
    return np.array([[-c * dq[1], -c * (dq[0] + dq[1])], [c * dq[0], 0.0]])


def gravity(theta_g: Array, q: Array) -> Array:
    """g(q), N.m, (2,); `theta_g` (2,) N.m, `q` (2,) rad."""
    return np.asarray(gravity_regressor(q) @ theta_g, dtype=np.float64)


def regressor(q: Array, dq: Array, z: Array, dz: Array) -> Array:
    """Y(q, dq, z, dz), (2, 3), with Y theta = M(q) dz + C(q, dq) z for every theta (3,)."""
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    y12 = c2 * (2 * dz[0] + dz[1]) - s2 * (dq[1] * z[0] + (dq[0] + dq[1]) * z[1])
    return np.array([[dz[0], y12, dz[1]], [0.0, c2 * dz[0] + s2 * dq[0] * z[0], dz[0] + dz[1]]])


def gravity_regressor(q: Array) -> Array:
    """G(q), (2, 2), with G theta_g = g(q) for every theta_g (2,): the columns of gravity in Y."""
    c12 = np.cos(q[0] + q[1])
    return np.array([[np.cos(q[0]), c12], [0.0, c12]])
