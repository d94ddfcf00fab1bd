"""Dynamics of a serial chain, linear in the inertial parameters of its links: the regressor Y.

For the ten parameters of each link, theta (n, 10) as in ``chain``, and any z, dz (n,)::

    Y(q, dq, z, dz) theta = M(q) dz + C(q, dq) z + g(q)

C is the matrix of Christoffel symbols, so that dM/dt - 2 C is skew-symmetric. C(q, dq) z is the
symmetric bilinear form of which C(q, dq) dq is the quadratic one: with the twists v = J dq and
w = J z of a link and the acceleration a by dz, its wrench is::

    I a + ½ (v x* I w + w x* I v),      a = J dz + ½ (terms of dJ/dt: v x S z + w x S dq)

The rows of Y are J' times the wrench of each unit parameter. ``chain_law.h`` computes Y theta and
Y' s without Y, in one recursion.

Source: Property 3 of the paper (linearity in the parameters) for any arm; the twists and wrenches
of R. Featherstone, Rigid Body Dynamics Algorithms, Springer, 2008.
"""

from __future__ import annotations

from functools import cache

from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.model.numeric import Array, np


@cache
def _units() -> Array:
    """The spatial inertia of each of the ten parameters alone, (10, 6, 6)."""
    return np.array([chain.spatial_inertia(theta) for theta in np.eye(10)])


def regressor(table: Table, q: Array, dq: Array, z: Array, dz: Array, g: Array) -> Array:
    """Y (n, n, 10); `q`, `dq`, `z`, `dz` (n,) rad, rad/s, rad/s, rad/s2; `g` (3,) m/s2.

    The inertia and the armature of the table are not used, and its gravity is `g`.
    """
    n = table.joints
    Y = np.zeros((n, n, 10))
    a = np.concatenate([np.zeros(3), -g])
    jacobians = chain.jacobians(table, q)
    for i, (X, J) in enumerate(zip(chain.transforms(table, q), jacobians, strict=True)):
        S, v, w = chain.axis(table, i), J @ dq, J @ z
        turned = chain.motion_cross(v) @ S * z[i] + chain.motion_cross(w) @ S * dq[i]
        a = X @ a + S * dz[i] + 0.5 * turned
        v_cross, w_cross = -chain.motion_cross(v).T, -chain.motion_cross(w).T
        units = _units()
        gyration = (units @ w) @ v_cross.T + (units @ v) @ w_cross.T
        Y[:, i] = J.T @ (units @ a + 0.5 * gyration).T
    return Y
