"""The tip of a serial arm as coordinates of a task: place, turn, damped inverse, null motion.

The tip p of a chain (``chain``) gives up to three coordinates, with `frame` F and the point `x_0`
of the base; six have its turn as well, as twice the vector part of a quaternion, times `length`::

    place   scale F (p(q) - x_0)
    turn    length 2 eps,   (eta, eps) the quaternion of F R(q) R(q_0)' F' with eta >= 0
    dx      = scale F dp/dt,   length (eta - [eps]) F omega

R is the orientation of the last link and omega its angular velocity, [a] b = a x b. The turn is the
short way from the posture `q_0`; it is unique, and its Jacobian regular, for less than pi. Rows of
J = dx/dq of coordinates that the arm `lacks`, and these coordinates, are 0.

A joint velocity v that gives the tip the velocity w, and moves the joints towards psi as far as
the tip does not notice, is with J before scaling by `scale`, and w accordingly::

    v   = psi + J'(J J' + mu^2)^-1 (w - J psi)  =  J# w + (1 - J# J) psi
    psi = -u / (1 + |u| / psi_max),   u = k_n (q - q_n) + k_l (a^2 - b^2) / margin
    a   = max(0, q - (q_max - margin)),   b = max(0, (q_min + margin) - q)      for each joint

The damping is 0 away from singularities, so that J J# = 1 there, and grows smoothly as sigma, an
estimate of the smallest singular value from below, falls under `sigma_0`::

    sigma^2 = 1 / Σ_k 1/(sigma_k^2 + e) - e,  e = 1e-6 sigma_0^2, and 0 where that is negative
              (sigma <= sigma_min, and about sigma_min / sqrt(m) or more of m coordinates)
    mu^2    = (sigma_0 / 2)^2 (1 - (sigma / sigma_0)^2)^2   for sigma < sigma_0, else 0

so that |J#| <= 3 sqrt(3) / (4 sigma_0) everywhere. Functions here follow the definitions, for real
or complex arguments; derivatives are taken by complex steps, f'(q) = Im f(q + i e) / e for a tiny
e, to the last digit. ``arm_task.h`` has them in closed form.

Source: Y. Nakamura, H. Hanafusa, "Inverse kinematic solutions with singularity robustness for robot
manipulator control", J. Dynamic Systems, Measurement, and Control 108(3), 1986; A. Liégeois,
"Automatic supervisory control of the configuration and behavior of multibody mechanisms", IEEE
Trans. Systems, Man, and Cybernetics 7(12), 1977; J. S.-C. Yuan, "Closed-loop manipulator control
using quaternion feedback", IEEE J. Robotics and Automation 4(4), 1988; W. Squire, G. Trapp, "Using
complex variables to estimate derivatives of real functions", SIAM Review 40(1), 1998; the smooth
sigma is our own.
"""

from __future__ import annotations

from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.build.reference import Values
from fmus.model.numeric import Array, np

#: Step of the derivatives: its square vanishes against any number here.
_TINY = 1e-40


def tip(table: Table, point: Array, q: Array) -> Array:
    """The place (3,), m, in the base, of the `point` (3,), m, of the last link; `q` (n,) rad."""
    *_, (R, r) = chain.placements(table, q)
    return np.asarray(r + R @ point)


def jacobian(table: Table, point: Array, q: Array) -> Array:
    """The matrix J = dp/dq, (3, n); `point`, `q` as of :func:`tip`."""
    p, columns = tip(table, point, q), []
    for kind, (R, r) in zip(table.joint_type, chain.placements(table, q), strict=True):
        columns.append(R[:, 2] if kind else np.cross(R[:, 2], p - r))
    return np.array(columns).T


def turns(table: Table, q: Array) -> Array:
    """The angular velocity of the last link by dq, (3, n), 1/s; `q` (n,) rad or m."""
    columns = [
        R[:, 2] * (0.0 if kind else 1.0)
        for kind, (R, _) in zip(table.joint_type, chain.placements(table, q), strict=True)
    ]
    return np.array(columns).T


def quaternion(C: Array) -> tuple[Array, Array]:
    """(eta, eps (3,)) of a rotation `C` (3, 3), without a unit, with eta >= 0."""
    odd = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    trace, m = np.trace(C), int(np.argmax(np.diag(C).real))
    if trace.real > 0.0:
        eta = 0.5 * np.sqrt(1.0 + trace)
        return eta, 0.25 * odd / eta
    eps = 0.25 * (C[:, m] + C[m])
    own = 0.5 * np.sqrt(1.0 + 2.0 * C[m, m] - trace)
    eps[m] = own * own
    sign = -1.0 if odd[m].real < 0.0 else 1.0
    return sign * 0.25 * odd[m] / own, sign * eps / own


def turn(x: Values, q: Array) -> tuple[Array, Array]:
    """(eta, eps (3,)), without a unit, of the turn of the tip at `q` (n,) rad from that at q_0."""
    table, F = chain.of_values(x), x["frame"]
    *_, (R, _) = chain.placements(table, q)
    *_, (R_0, _) = chain.placements(table, x["q_0"])
    return quaternion(F @ R @ R_0.T @ F.T)


def rows(x: Values, q: Array) -> Array:
    """J (m, n) before scaling, of the values `x` of a model of a task; `q` (n,) rad or m."""
    table = chain.of_values(x)
    J = x["frame"] @ jacobian(table, x["tip"], q)
    if "length" in x:
        eta, (a, b, c) = turn(x, q)
        E = np.array([[eta, c, -b], [-c, eta, a], [b, -a, eta]])
        J = np.vstack([J, x["length"] * (E @ x["frame"] @ turns(table, q))])
    return np.asarray(np.where(has(x)[:, None], J, 0.0))


def place(x: Values, q: Array) -> Array:
    """The coordinates (m,), m, of the tip at `q` (n,) rad or m."""
    at = tip(chain.of_values(x), x["tip"], q) - x["x_0"]
    found = x["scale"] * (x["frame"] @ at)
    if "length" in x:
        found = np.concatenate([found, 2.0 * x["length"] * turn(x, q)[1]])
    return np.where(has(x), found, 0.0)


def scales(x: Values) -> Array:
    """The factor (m,) of each coordinate, without a unit: a turn is as great in every arm."""
    return np.where(np.arange(len(x["lacks"])) < len(x["frame"]), x["scale"], 1.0)


def has(x: Values) -> Array:
    """A mask of the coordinates (m,) that the arm has."""
    return np.asarray(x["lacks"] == 0)


def inverse(x: Values, J: Array) -> tuple[Array, Array]:
    """((J J' + mu^2)^-1 (m, m), sigma), of the rows J (m, n); missing coordinates are apart."""
    A = J @ J.T + np.diag(np.where(has(x), 0.0, 1.0))
    unit, limit = np.eye(len(A)), x["sigma_0"] ** 2
    shift = 1e-6 * limit  # the inverse exists; sigma is then 0 at a singularity all the same
    squared = 1.0 / np.diag(np.linalg.inv(A + shift * unit))[has(x)].sum() - shift
    squared = squared if squared.real > 0.0 else 0.0 * squared
    missing = 1.0 - squared / limit
    mu_squared = limit / 4.0 * missing**2 if missing.real > 0.0 else 0.0
    return np.linalg.inv(A + mu_squared * unit), np.sqrt(squared)


def null_velocity(x: Values, q: Array) -> Array:
    """Psi (n,), rad/s, at `q` (n,) rad."""
    over = _positive(q - (x["q_max"] - x["margin"]))
    under = _positive(x["q_min"] + x["margin"] - q)
    u = x["k_n"] * (q - x["q_n"]) + x["k_l"] * (over**2 - under**2) / x["margin"]
    return np.asarray(-u / (1.0 + u * np.sign(u.real) / x["psi_max"]))


def velocity(x: Values, q: Array, w: Array) -> Array:
    """The joint velocity v (n,), rad/s, for the velocity `w` (m,), m/s, before scaling."""
    J, psi = rows(x, q), null_velocity(x, q)
    return np.asarray(psi + J.T @ (inverse(x, J)[0] @ (w - J @ psi)))


def acceleration(x: Values, q: Array, dq: Array, w: Array, dw: Array) -> Array:
    """dv/dt (n,), rad/s2, while q and w change by `dq` (n,) rad/s and `dw` (m,) m/s2."""
    moved = velocity(x, q + 1j * _TINY * dq, w + 1j * _TINY * dw)
    return np.asarray(moved.imag / _TINY)


def _positive(x: Array) -> Array:
    return np.asarray(np.where(x.real > 0.0, x, 0.0))
