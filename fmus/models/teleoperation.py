"""Adaptive controller with dynamic feedback: for one arm, a teleoperator or a network of arms.

The same law covers all cases of the paper, for one arm and its n neighbours j::

    xi         = dq + alpha q                                                  sent, (47)
    dz         = -alpha dq + lambda_M (dq - z) - lambda Σ_j w_j (xi - xi_in_j)
    s          = dq - z
    tau        = -K s + Y(q, dq, z, dz) theta_hat
    dtheta_hat = -Gamma Yᵀ(q, dq, z, dz) s

    Y = [ dz1   c2 (2 dz1 + dz2) - s2 (dq2 z1 + (dq1 + dq2) z2)   dz2       ]   c2 = cos q2
        [ 0     c2 dz1 + s2 dq1 z1                                dz1 + dz2 ]   s2 = sin q2

    n = 0, model ``adaptive``       (29)-(32), Theorem 2
    lambda = 1, w_ij in w           (42)-(45), Theorem 3; with delayed xi_in (61), Theorem 4
    n = 1, w = 1                    (76)-(81), Theorem 5

Source: the paper, eqs (29)-(32), (42)-(45), (47), (61), (76)-(81), Remark 3, Theorems 2 to 5. The
options `theta_min`, `theta_max`, `age` and `tau_max` are our own additions.

Sampled: the step at t_k reads its inputs, gives xi, s, z, theta_hat and tau as of t_k, and advances
z and theta_hat by one step of the explicit Euler method to t_k + h. `lambda` has the unit 1/s and
`w` is dimensionless; the paper's w_ij is their product. K and Gamma are symmetric. `K` and `Gamma`
are their diagonals, with an entry for each joint and each parameter; `K_off` and `Gamma_off` are
the entries above the diagonal, row by row, 0 by default. With nonzero entries K and Gamma must be
positive definite. alpha = 0 is for a single arm, whose velocity then is the output (Sec. IV-C).
With neighbours alpha > 0 is required; otherwise only the velocities would agree, not the positions.

All options are off by default:

tau_max: each joint's torque is limited to ±tau_max; while any joint is at its limit, z and
theta_hat are not updated (anti-windup).

theta_min, theta_max: theta_hat is clipped to these bounds after each Euler step. If the true theta
lies between them, dV/dt <= -sᵀ K s still holds: with a diagonal Gamma, clipping an entry only
reduces its term (theta_hat_i - theta_i)² / (2 Gamma_i) of V. With entries in Gamma_off this is not
true, and the bounds are rejected.

age, age_max, age_fade: an edge with w_j > 0 whose signal is older than age_max is stale. While an
edge is stale, theta_hat is not updated, and the weight of the edge falls linearly from w_j at
age_max to 0 at age_max + age_fade (immediately with age_fade = 0). z is still updated, so that the
arm stays manipulable.

lambda_c > 0 (Remark 3): K = lambda_c M_hat(q), with the estimated inertia; the parameter K is not
used. Torque and adaptation then share one regressor::

    tau = Y* theta_hat,   dtheta_hat = -Gamma Y*ᵀ s,   Y* = Y(q, dq, z, dz - lambda_c s)

so that dV/dt = -lambda_c sᵀ M s + sᵀ tau_h. theta_hat = 0 gives no feedback: start from a nonzero
estimate, and use theta_min to keep M_hat positive definite.

Gravity (models built with `gravity`): theta_hat has two more entries, with the columns G in Y, and
the parameter `gravity` selects the treatment of g(q) = G(q) theta_g::

    G = [ cos q1   cos (q1 + q2) ]     0  none         gravity is ignored
        [ 0        cos (q1 + q2) ]     1  compensated  tau += G theta_g; theta_hat[3:] is constant
                                       2  adapted      Y = [Y G], theta_hat[3:] adapts

The default is 1, with the known values in theta_g, because adapting gravity removes the purpose of
the law: theta_hat integrates Gᵀ s, so that the estimate absorbs any constant push,
G (theta_hat[3:] - theta_g) = -tau_h with s = 0. The arm stops under a constant push, and the torque
that a teleoperator reflects decays. (The paper's bounds "<= ∞" remain true; Sec. VII has g = 0.)
"""

from __future__ import annotations

from cosim.base.errors import ScenarioError
from fmus.arms.adaptive_variables import ADAPTED, COMPENSATED, UNLIMITED, variables
from fmus.arms.dynamics import gravity_regressor, regressor
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np


def model(neighbours: int = 1, gravity: bool = False) -> Model:
    """Declare the controller for `neighbours` >= 0 received signals; defaults: Sec. VII-C.

    `gravity`: with two parameters of gravity in theta_hat. Without neighbours this is the model
    ``adaptive``. Raises ScenarioError for sizes that cannot be.
    """
    if neighbours < 0 or gravity not in (0, 1):
        raise ScenarioError(
            f"neighbours is {neighbours}, expected at least 0; gravity is {gravity}, expected 0, 1",
            "fmus.models.teleoperation",
        )
    stem = ("teleoperation" if neighbours else "adaptive") + ("_gravity" if gravity else "")
    joints = Terminal("joints", ("q", "dq", "tau"), "Position and velocity in, torque out")
    members = ("xi", "xi_in", "w", "age")
    network = Terminal("network", members, "Signals exchanged with the neighbours")
    whom = f"{neighbours} neighbour(s)" if neighbours else "one arm alone"
    return Model(
        identifier=f"{stem}_n{neighbours}" if neighbours > 1 else stem,
        description=f"Adaptive controller with dynamic feedback, {whom}"
        + (", gravity" if gravity else ""),
        kind="sampled",
        variables=variables(neighbours, bool(gravity)),
        sources=(*("teleoperation.c", "neighbours.h", "regressor.h", "limit.h", "trig.c"),),
        defines=(("NETWORKED", int(neighbours > 0)), ("GRAVITY", int(gravity))),
        step=5e-3,
        terminals=(joints, network) if neighbours else (joints,),
        documentation=__doc__ or "",
        lanes=True,
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, *network: Array) -> Values:
    """Eqs (76)-(81); z and theta_hat advance to t + h, s.

    `q`, `dq` (2,) rad, rad/s. `network`: xi_in (n, 2) rad/s, w (n,) without a unit and age (n,) s
    of n neighbours, or nothing.
    """
    z, theta_hat, alpha, lambda_c = x["z_next"], x["theta_hat_next"], x["alpha"], x["lambda_c"]
    xi = dq + alpha * q
    pull, stale = coupling(x, xi, *network) if network else (np.zeros_like(q), False)
    dz = -alpha * dq + x["lambda_M"] * (dq - z) - pull
    s = dq - z
    feedback = x["K"] * s + x["K_off"] * s[::-1] if lambda_c == 0 else np.zeros_like(s)
    Y = _regressor(x, q, dq, z, dz - lambda_c * s)  # (2, p)
    wanted = -feedback + Y @ theta_hat + _compensation(x, q)
    tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
    now = {"tau": tau, "xi": xi, "s": s, "z": z, "theta_hat": theta_hat}
    if (tau != wanted).any():
        return now | {"z_next": z, "theta_hat_next": theta_hat}
    if not stale:
        adapted = theta_hat - h * (_symmetric(x["Gamma"], x["Gamma_off"]) @ (Y.T @ s))
        theta_hat = np.clip(adapted, x["theta_min"], x["theta_max"])
    return now | {"z_next": z + h * dz, "theta_hat_next": theta_hat}


def start(x: Values, *inputs: Array) -> Values:
    """State at the start. Raises ScenarioError, also where theta_hat is outside of its bounds."""
    place = "teleoperation" if "lambda" in x else "adaptive"
    _check_gains(x, place)
    if (x["theta_hat"] < x["theta_min"]).any() or (x["theta_hat"] > x["theta_max"]).any():
        raise ScenarioError(
            f"theta_hat starts at {x['theta_hat'].tolist()}, expected within theta_min "
            f"{x['theta_min'].tolist()} ... theta_max {x['theta_max'].tolist()}",
            place,
        )
    if "lambda" in x and x["alpha"] <= 0:
        raise ScenarioError("alpha is 0, expected more than 0 with neighbours", place)
    return {"z_next": x["z"], "theta_hat_next": x["theta_hat"]}


def _check_gains(x: Values, place: str) -> None:
    for name in ("K", "Gamma"):
        off = np.atleast_1d(x[f"{name}_off"])
        if off.any() and not _positive_definite(_symmetric(x[name], off)):
            raise ScenarioError(
                f"{name} with {name}_off = {off.tolist()} is not positive definite; expected a "
                "symmetric positive definite matrix",
                place,
            )
    bounded = (x["theta_min"] > -UNLIMITED).any() or (x["theta_max"] < UNLIMITED).any()
    if x["Gamma_off"].any() and bounded:
        raise ScenarioError(
            "theta_min and theta_max are bounded while Gamma_off is not 0, expected a diagonal "
            "Gamma: only then does V still decrease when theta_hat is clipped",
            place,
        )


def _symmetric(diagonal: Array, off: Array) -> Array:
    """The symmetric matrix of a diagonal, (p,), and what stands right of it, row by row, (p, p)."""
    matrix = np.diag(diagonal)
    rows, columns = np.triu_indices(len(diagonal), 1)
    matrix[rows, columns] = matrix[columns, rows] = off
    return matrix


def _positive_definite(matrix: Array) -> bool:
    """True if a symmetric matrix, (p, p), has a Cholesky factor with a positive diagonal."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def coupling(x: Values, xi: Array, xi_in: Array, w: Array, age: Array) -> tuple[Array, bool]:
    """(lambda Σ_j w_j (xi - xi_in_j) with stale edges faded, (m,) rad/s2; whether any is stale).

    `xi` (m,), `xi_in` (n, m) rad/s, `w` (n,) without a unit, `age` (n,) s.
    """
    late, fade = age - x["age_max"], x["age_fade"]  # s
    stale = (w > 0) & (age > x["age_max"])
    left = np.where(late < fade, 1 - late / (fade or 1.0), 0.0)  # of the weight, (n,)
    return x["lambda"] * (np.where(stale, left * w, w) @ (xi - xi_in)), bool(stale.any())


def _regressor(x: Values, q: Array, dq: Array, z: Array, dz: Array) -> Array:
    """Y of what adapts, (2, p)."""
    Y = regressor(q, dq, z, dz)
    if "gravity" not in x:
        return Y
    G = gravity_regressor(q)
    return np.hstack([Y, G if x["gravity"] == ADAPTED else np.zeros_like(G)])


def _compensation(x: Values, q: Array) -> Array:
    """Known gravity, N.m, (2,)."""
    if "gravity" in x and x["gravity"] == COMPENSATED:
        return np.asarray(gravity_regressor(q) @ x["theta_g"], dtype=np.float64)
    return np.zeros_like(q)


fmu, kernel, Teleoperation = derive(model, law, start)
