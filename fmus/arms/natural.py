"""Adaptation that keeps the estimate of a link the inertia of a body.

The ten parameters of a link make its pseudo-inertia, which is positive definite if and only if a
body has them: m > 0, and the principal moments satisfy the triangle inequality::

    P = [ Sigma  mc ]      Sigma = tr(I)/2 - I,      V = log(det P_hat / det P) + tr(P/P_hat) - 4
        [ mc'    m  ]

With ell = Y' s of the link and the symmetric L for which tr(P L) = ell' theta::

    dP_hat = -rate P_hat L P_hat,      dV = -rate ell' (theta_hat - theta)

V / rate replaces the quadratic form with Gamma in the function of Lyapunov. One rate suits all
parameters and does not depend on the frame. The step of the explicit Euler method is shortened
where it would take more than half of P_hat in a direction, so that P_hat stays positive definite.

Source: T. Lee, J. Kwon, F. C. Park, "A natural adaptive control law for robot manipulators",
IEEE/RSJ IROS 2018; the limits of an inertia: P. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and
Automation Letters 3(1), 2018; the limit of the step is our own derivation.
"""

from __future__ import annotations

from fmus.model.numeric import Array, np

#: Where the entries xx xy yy xz yz zz of a tensor stand in theta.
_TENSOR = ((4, 5, 7), (5, 6, 8), (7, 8, 9))


def pseudo_inertia(theta: Array) -> Array:
    """P (4, 4) of the parameters `theta` (10,) of a link: m kg, m c kg.m, I kg.m2."""
    tensor = np.take(theta, _TENSOR)
    sigma = np.trace(tensor) / 2 * np.eye(3) - tensor
    return np.block([[sigma, theta[1:4, None]], [theta[None, 1:4], theta[:1, None]]])


def parameters(P: Array) -> Array:
    """The parameters theta (10,) of the pseudo-inertia `P` (4, 4), as of :func:`pseudo_inertia`."""
    tensor = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    upper = tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([[P[3, 3]], P[3, :3], upper])


def adapted(theta: Array, ell: Array, step: float) -> Array:
    """The estimate (10,) after a `step` (rate times h, s/J) against the gradient `ell` (10,)."""
    l_tensor = np.take(ell, _TENSOR)
    L = np.zeros((4, 4))
    L[:3, :3] = np.diag(np.trace(l_tensor) - np.diag(l_tensor))
    L[:3, :3] -= (l_tensor - np.diag(np.diag(l_tensor))) / 2
    L[3, :3] = L[:3, 3] = ell[1:4] / 2
    L[3, 3] = ell[0]
    P = pseudo_inertia(theta)
    squared = np.trace(P @ L @ P @ L)
    if step**2 * squared > 0.25:
        step = 0.5 / np.sqrt(squared)
    return parameters(P - step * P @ L @ P)
