"""Claims about the equations, checked at every sample.

A recorded run has to obey (1), (29)-(32), (42), (47), (80) and (81) at every sample, with K and
Gamma that differ from entry to entry, or are full. M and C are computed here from absolute joint
angles, not with the parameters and the regressor of the controller.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper.claim import Claim, at_most
from fmus.paper.experiments import PERIOD, THETA, Document, network, single, teleoperator
from fmus.paper.network import IN_TURN
from fmus.paper.operators import recording

Array = m.Array
#: Gains that differ from entry to entry, and matrices with entries beside their diagonals.
K, GAMMA = (20.0, 8.0), (8.0, 2.0, 1.0)
K_OFF, GAMMA_OFF = 6.0, (1.0, -0.5, 0.4)
ALPHA, LAMBDA_M, H = 2.0, 6.0, 1e-3
KNOWN: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
#: Delay of the pair whose samples are compared, s.
LATE = 0.05


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; nothing in them is random."""
    unequal: dict[str, Any] = {"K": list(K), "Gamma": list(GAMMA)}
    full = {**unequal, "K_off": K_OFF, "Gamma_off": list(GAMMA_OFF)}
    pair = teleoperator(5.0, link={"delay": {"law": "constant", "delay": LATE}})
    names = [f"{side}_control.{x}" for side in ("master", "slave") for x in ("xi", "s", "z")]
    ring = network(5.0, schedule=IN_TURN, **KNOWN)
    states = [f"control{i}.{x}" for i in (1, 3) for x in ("s", "z")]
    return {
        "unequal": single(10.0, period=H, arm_values={"dq": [2.0, -1.0]}, **unequal),
        "full": single(10.0, period=H, arm_values={"dq": [2.0, -1.0]}, **full),
        "pair-sampled": _every(recording(pair, *names)),
        "ring-sampled": _every(recording(ring, *states, *(f"robot{i}.dq" for i in range(1, 7)))),
    }


def _every(document: Document) -> Document:
    """The document with every row recorded."""
    run = document["run"]
    return {**document, "run": {**run, "record": {**run["record"], "every": 1}}}


# ---- the equations at every sample --------------------------------------------------------------


def inertia_and_coriolis(theta: ArrayLike, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
    """M(q) and C(q, dq), (2, 2), by way of the absolute angles q_1 and q_1 + q_2.

    There M = [a, b cos d; b cos d, c] with d = q_2, a = θ1 - θ3, b = θ2, c = θ3, and Christoffel's
    C = [0, -b sin d w_2; b sin d w_1, 0] with the absolute rates w; J maps joint angles to them.
    """
    t, rates = np.asarray(theta), np.array([[1.0, 0.0], [1.0, 1.0]]) @ np.asarray(dq)
    J, d = np.array([[1.0, 0.0], [1.0, 1.0]]), float(np.asarray(q)[1])
    swing = t[1] * np.sin(d)
    M = np.array([[t[0] - t[2], t[1] * np.cos(d)], [t[1] * np.cos(d), t[2]]])
    C = np.array([[0.0, -swing * rates[1]], [swing * rates[0], 0.0]])
    return J.T @ M @ J, J.T @ C @ J


def regressor(q: Array, dq: Array, z: Array, dz: Array) -> Array:
    """Y(q, dq, z, dz), (2, 3), column by column: the torque that each parameter alone asks for."""
    columns = []
    for unit in np.eye(3):
        M, C = inertia_and_coriolis(unit, q, dq)
        columns.append(M @ dz + C @ z)
    return np.array(columns).T


def _rows(r: Run, component: str, *names: str) -> tuple[Array, ...]:
    """Signals at the sample instants; the last row, where nothing is sampled any more, left out."""
    return tuple(r.array(f"{component}.{name}")[:-1] for name in names)


def _arm(r: Run) -> dict[str, Array]:
    arm, control = ("q", "dq"), ("tau", "s", "z", "theta_hat")
    rows = (*_rows(r, "robot", *arm), *_rows(r, "control", *control))
    return dict(zip((*arm, *control), rows, strict=True))


def _reference(r: Run) -> float:
    """Largest error of s against dq - z, and of a step of z against eq. (29), rad/s."""
    x, h = _arm(r), float(r.t[1])
    rate = -ALPHA * x["dq"] + LAMBDA_M * x["s"]
    late = x["z"][1:] - x["z"][:-1] - h * rate[:-1]
    return max(m.largest_error(x["s"], x["dq"] - x["z"]), m.largest_error(late, 0.0))


def _torque(feedback: ArrayLike) -> Any:
    """Largest error of tau against -K s + Y theta_hat, in every 7th sample, N.m."""

    def off(r: Run) -> float:
        x, worst = _arm(r), 0.0
        for k in range(0, len(x["q"]), 7):
            dz = -ALPHA * x["dq"][k] + LAMBDA_M * x["s"][k]
            Y = regressor(x["q"][k], x["dq"][k], x["z"][k], dz)
            wanted = -np.asarray(feedback) @ x["s"][k] + Y @ x["theta_hat"][k]
            worst = max(worst, m.largest_error(x["tau"][k], wanted))
        return worst

    return off


def _adaptation(gain: ArrayLike) -> Any:
    """Largest error of a step of theta_hat against -h Gamma Yᵀ s, in every 7th, kg.m2."""

    def off(r: Run) -> float:
        x, h, worst = _arm(r), float(r.t[1]), 0.0
        for k in range(0, len(x["q"]) - 1, 7):
            dz = -ALPHA * x["dq"][k] + LAMBDA_M * x["s"][k]
            Y = regressor(x["q"][k], x["dq"][k], x["z"][k], dz)
            step = -h * np.asarray(gain) @ Y.T @ x["s"][k]
            worst = max(worst, m.largest_error(x["theta_hat"][k + 1] - x["theta_hat"][k], step))
        return worst

    return off


def _pair(r: Run) -> float:
    """Error of a step of z of either arm against eqs (80), (81), with xi as it was T before."""
    late, worst = round(LATE / PERIOD), 0.0
    for own, other in (("master", "slave"), ("slave", "master")):
        (q, dq), (s, z) = _rows(r, own, "q", "dq"), _rows(r, f"{own}_control", "s", "z")
        sent = _xi(r, other, 0.5)
        heard = np.vstack([np.repeat(sent[:1], late, axis=0), sent[:-late]])
        rate = -0.5 * dq + 10.0 * s - 2.0 * (dq + 0.5 * q - heard)
        worst = max(worst, m.largest_error(z[1:] - z[:-1], PERIOD * rate[:-1]))
    return worst


def _ring(r: Run) -> float:
    """Error of a step of z_1 and z_3 against eq. (42): 1 hears 6, 3 hears 2, each in turn."""
    worst = 0.0
    for i, j, graph in ((1, 6, 2), (3, 2, 1)):
        (dq,), (s, z) = _rows(r, f"robot{i}", "dq"), _rows(r, f"control{i}", "s", "z")
        active = (np.arange(len(dq)) % 3 == graph)[:, None]
        apart = _xi(r, f"robot{i}", 1.6) - _xi(r, f"robot{j}", 1.6)
        rate = -1.6 * dq + 10.0 * s - active * apart
        worst = max(worst, m.largest_error(z[1:] - z[:-1], PERIOD * rate[:-1]))
    return worst


def _xi(r: Run, arm: str, alpha: float) -> Array:
    q, dq = _rows(r, arm, "q", "dq")
    return dq + alpha * q


def _sent(r: Run) -> float:
    """Largest error of xi against (47), of both arms, rad/s."""
    sides = ("master", "slave")
    return max(m.largest_error(_rows(r, f"{x}_control", "xi")[0], _xi(r, x, 0.5)) for x in sides)


def _work(r: Run) -> float:
    """Largest error of the kinetic energy against that at the start and the work of tau, J."""
    q, dq = r.array("robot.q"), r.array("robot.dq")
    kinetic = [
        0.5 * v @ inertia_and_coriolis(THETA, x, v)[0] @ v for x, v in zip(q, dq, strict=True)
    ]
    tau = r.array("control.tau")[:-1]
    work = np.cumsum(np.einsum("ki,ki->k", tau, np.diff(q, axis=0)))
    return m.largest_error(np.array(kinetic[1:]) - kinetic[0], work)


_UNEQUAL, _FULL = ("unequal",), ("full",)
_K_FULL = np.array([[K[0], K_OFF], [K_OFF, K[1]]])
_GAMMA_FULL = np.diag(GAMMA)
_GAMMA_FULL[np.triu_indices(3, 1)] = GAMMA_OFF
_GAMMA_FULL += np.triu(_GAMMA_FULL, 1).T
_EXACT = "the paper's equation, from M and C in absolute angles"
CLAIMS = (
    Claim("eq1", ("equations", "thm2"), "(1), let go: kinetic energy off the work of tau by", "J",
          at_most(1e-6), "Property 2: C takes no power; torques are held", ("free",), _work),
    Claim("eq29-30", ("equations", "thm2"), "(29), (30) at every sample: z and s off by", "rad/s",
          at_most(1e-12), "the paper's equation, a step of Euler's method", _UNEQUAL, _reference),
    Claim("eq31", ("equations", "thm2"), "(31), K = diag(20, 8): tau off by", "N.m",
          at_most(1e-11), _EXACT, _UNEQUAL, _torque(np.diag(K))),
    Claim("eq31-full", ("equations", "thm2"), "(31), K with entries off its diagonal: tau off by",
          "N.m", at_most(1e-11), _EXACT, _FULL, _torque(_K_FULL)),
    Claim("eq32", ("equations", "thm2"), "(32), Gamma = diag(8, 2, 1): a step of theta_hat off by",
          "kg.m2", at_most(1e-12), _EXACT, _UNEQUAL, _adaptation(np.diag(GAMMA))),
    Claim("eq32-full", ("equations", "thm2"), "(32), a full Gamma: a step of theta_hat off by",
          "kg.m2", at_most(1e-12), _EXACT, _FULL, _adaptation(_GAMMA_FULL)),
    Claim("eq42", ("equations", "thm3"), "(42), graphs in turn: a step of z off by", "rad/s",
          at_most(1e-12), "the paper's equation, a step of Euler's method", ("ring-sampled",),
          _ring),
    Claim("thm3-gain", ("equations", "thm3", "o8"), "|s_3|_2/|tau_h|_2 of the robot in the hand",
          "rad/(N.m.s)", at_most(1 / 16.0), "Theorem 3, second half: at most 1/λ_min(K_3)",
          ("ring-sampled",), lambda r: m.norm(r, "control3.s") / m.norm(r, "robot3.tau_h")),
    Claim("eq47", ("equations", "thm5"), "(47): xi off dq + alpha q by", "rad/s", at_most(1e-12),
          "the paper's equation", ("pair-sampled",), _sent),
    Claim("eq80", ("equations", "thm5"), "(80), (81), T = 50 ms: a step of z off by", "rad/s",
          at_most(1e-12), "ξ exactly 10 samples before", ("pair-sampled",), _pair),
)  # fmt: skip
