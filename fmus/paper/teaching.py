"""Sec. IV-B and VII-A, Theorem 2, Figs 1-3: one arm in the operator's hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, absolute, at_most, never, relative, within
from fmus.paper.experiments import Q_H, THETA, Document, single

K, GAMMA, ALPHA, LAMBDA_M, K_P, K_D = 16.0, 8.0, 2.0, 6.0, 10.0, 5.0
SIMULATED = "independent simulation"
Q, TAU_H = "robot.q", "robot.tau_h"
#: z(0) of a run that starts from other than rest, rad/s.
Z_0 = (1.6, -0.8)


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; nothing in them is random."""
    known: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
    push = {"tau_ext": [1.0, 0.0]}  # N.m
    return {
        "teaching-6": single(60.0),
        "teaching-6-1ms": single(period=1e-3),
        "teaching-6-10ms": single(period=1e-2),
        "teaching-6-known": single(**known),
        "teaching-2": single(60.0, lambda_M=2.0),
        "teaching-0": single(600.0, lambda_M=0.0, every=4),
        "teaching-0-z": single(60.0, lambda_M=0.0, z=list(Z_0)),
        "free": single(grip={}, arm_values={"dq": [2.0, -1.0]}),
        "push": single(60.0, grip={}, arm_values=push, **known),
        "push-0": single(60.0, grip={}, arm_values=push, lambda_M=0.0, **known),
    }


# ---- Figs 1 and 2, lambda_M = 6 as in the captions ----------------------------------------------


def _sampling(*runs: Run) -> float:
    """Largest change of settle time and effort, against the first run."""
    found = np.array([(m.time_to_target(r, [Q], Q_H), m.norm(r, TAU_H)) for r in runs])
    return float(np.abs(found[1:] / found[0] - 1).max())


_CASE = ("teaching-6",)
_PERIODS = ("teaching-6", "teaching-6-1ms", "teaching-6-10ms")
_FIGURES_1_2 = (
    Claim("fig1-settled", ("fig1", "thm2"), "lambda_M = 6: q within 0.05 rad of q_h from", "s",
          relative(5.8, 0.1), SIMULATED, _CASE, lambda r: m.time_to_target(r, [Q], Q_H)),
    Claim("fig1-exact", ("fig1", "thm2"), "|q - q_h| at 20 s", "rad",
          at_most(1e-3), SIMULATED, _CASE, lambda r: m.largest_error(m.at(r, Q, 20.0), Q_H)),
    Claim("fig1-peak", ("fig1",), "peak of the first joint, 32 % above q_h", "rad",
          relative(4.62, 0.02), SIMULATED, _CASE, lambda r: r.column("robot.q[0]").max()),
    Claim("fig1-sampling", ("fig1",), "settle time and effort at 1 and 10 ms change by", "1",
          at_most(0.01), SIMULATED, _PERIODS, _sampling),
    Claim("fig2-rest", ("fig2", "thm2"), "the hand rests: |tau_h| at 20 s", "N.m",
          at_most(0.01), SIMULATED, _CASE, lambda r: m.length(m.at(r, TAU_H, 20.0))),
    Claim("fig2-effort", ("fig2",), "effort of the operator, |tau_h|_2", "N.m.√s",
          relative(46.0, 0.02), SIMULATED, _CASE, lambda r: m.norm(r, TAU_H)),
    Claim("thm2-slope", ("thm2", "fig2"), "M^t grows: d log M/d log t, 30 to 60 s", "1",
          absolute(0.52, 0.05), f"{SIMULATED}; 1/2 once the hand rests", _CASE,
          lambda r: m.growth(r, TAU_H, [Q], 30.0, 60.0)),
)  # fmt: skip


# ---- Fig. 1 with lambda_M = 2 as in the text: the adaptive controller is plain damping ----------


def _beside_damping(r: Run) -> float:
    """O1: the largest of |z|, |theta_hat| and |tau + K dq|."""
    torque = r.array("control.tau") + K * r.array("robot.dq")
    return max(m.peak(r, ["control.z", "control.theta_hat"]), float(np.abs(torque).max()))


_TEXT = ("teaching-2",)
_FIGURE_1_TEXT = (
    Claim("o1-damping", ("o1", "fig1"), "lambda_M = 2 = alpha: |z|, |theta_hat|, |tau + K dq|",
          "SI", at_most(1e-12), "O1: z = 0, theta_hat = 0, tau = -K dq", _TEXT, _beside_damping),
    Claim("fig1-text-settled", ("fig1",), "lambda_M = 2: q within 2 % of q_h from", "s",
          relative(8.3, 0.1), SIMULATED, _TEXT,
          lambda r: m.time_to_target(r, [Q], Q_H, 0.02 * min(Q_H))),
    Claim("fig1-text-overshoot", ("fig1",), "lambda_M = 2: overshoot", "rad", at_most(1e-6),
          SIMULATED, _TEXT, lambda r: (r.array(Q) - np.array(Q_H)).max()),
)  # fmt: skip


# ---- Fig. 3, lambda_M = 0: finite manipulability ------------------------------------------------

_REST = oracles.rest_position((0.0, 0.0), Q_H, K, ALPHA, K_P)
_REST_Z = oracles.rest_position((0.0, 0.0), Q_H, K, ALPHA, K_P, Z_0)
_HOLD = oracles.holding_torque((0.0, 0.0), Q_H, K, ALPHA, K_P)
_LIMIT = oracles.finite_manipulability(K, ALPHA)
_WITHOUT, _BROKEN = ("teaching-0",), "lambda_M = 0"
_FIGURE_3 = (
    Claim("fig3-position", ("fig3", "o2"), "lambda_M = 0: q(60 s) is off (0.8333, 0.7143) by",
          "rad", at_most(0.005), "O2: q = (αK q(0) + k_p q_h)/(αK + k_p)", _WITHOUT,
          lambda r: m.largest_error(m.at(r, Q, 60.0), _REST)),
    Claim("fig3-torque", ("fig3", "o2"), "held for ever: tau_h is off (26.67, 22.86) by", "N.m",
          at_most(0.05), "O2: τ_h = k_p (q_h - q)", _WITHOUT,
          lambda r: m.largest_error(m.at(r, TAU_H, 60.0), _HOLD)),
    Claim("o2-start", ("o2",), "z(0) = (1.6, -0.8) rad/s: rest is off O2 by", "rad", at_most(1e-3),
          "O2 with ψ_0 = q(0) + z(0)/α in the place of q(0): (1.443, 0.4095)", ("teaching-0-z",),
          lambda r: m.largest_error(m.final(r, Q), _REST_Z)),
    Claim("fig3-reached", ("fig3", "thm2"), "lambda_M = 0: q within 0.05 rad of q_h from", "s",
          never(), "O2", _WITHOUT, lambda r: m.time_to_target(r, [Q], Q_H), _BROKEN),
    Claim("fig3-limit", ("fig3", "o2", "thm2"), "M^t at 600 s", "rad/(N.m)",
          relative(_LIMIT, 0.01), "O2: M -> 1/(αK)", _WITHOUT,
          lambda r: m.manipulability(r, TAU_H, [Q])[-1], _BROKEN),
    Claim("fig3-bound", ("fig3", "o2", "thm2"), "largest M^t", "rad/(N.m)", at_most(_LIMIT),
          "O2: M^t ≤ 1/(αK)", _WITHOUT,
          lambda r: np.nanmax(m.manipulability(r, TAU_H, [Q])), _BROKEN),
    Claim("fig3-slope", ("fig3", "thm2"), "M^t has stopped growing: slope, 300 to 600 s", "1",
          at_most(0.02), "O2: the limit is finite", _WITHOUT,
          lambda r: m.growth(r, TAU_H, [Q], 300.0, 600.0), _BROKEN),
)  # fmt: skip


# ---- O3, O4, O6, O8 and the rest of Theorem 2 ---------------------------------------------------


def _share(r: Run) -> m.Array:
    """M^t of a push of 1 N.m as a share of its bound O6, from the second row on."""
    response = ((r.array(Q) - r.array(Q)[0]) ** 2).sum(axis=1)
    M = np.sqrt(m.integral(response, r.t)[1:] / r.t[1:])
    return np.asarray(M / oracles.manipulability_bound(r.t[1:], K, ALPHA, LAMBDA_M))


def _energy(r: Run) -> m.Array:
    q, s, theta_hat = (r.array(name) for name in (Q, "control.s", "control.theta_hat"))
    return oracles.lyapunov(THETA, q, s, theta_hat, GAMMA)


def _pole(lambda_M: float, mass: float = 0.0) -> float:
    return float(oracles.poles(K, ALPHA, lambda_M, K_P, K_D, mass)[0])


_LIGHT = float(np.linalg.eigvalsh(oracles.inertia(THETA, np.array([Q_H]))[0])[0])
_DRIFT = 1.0 / oracles.felt_damping(K, ALPHA, LAMBDA_M)
_THEOREM_2 = (
    Claim("o3-text", ("o3",), "lambda_M = 2: the error decays with", "1/s",
          relative(_pole(2.0), 0.05), "O3, quasi-static", _TEXT,
          lambda r: m.decay(r, "robot.q[1]", Q_H[1], 5.0, 12.0)),
    Claim("o3-known", ("o3",), "lambda_M = 6, theta known: the error decays with", "1/s",
          relative(_pole(LAMBDA_M, _LIGHT), 0.01), "O3 with the arm's inertia at q_h",
          ("teaching-6-known",), lambda r: m.decay(r, "robot.q[1]", Q_H[1], 5.0, 12.0)),
    Claim("o3-quasi-static", ("o3",), "lambda_M = 6, theta known: the error decays with", "1/s",
          relative(_pole(LAMBDA_M), 0.1), "O3, quasi-static: inertia left out costs 6 %",
          ("teaching-6-known",), lambda r: m.decay(r, "robot.q[1]", Q_H[1], 5.0, 12.0)),
    Claim("o4-push", ("o4", "thm2"), "1 N.m moves one arm, for ever, at", "rad/s",
          relative(_DRIFT, 1e-3), "O4: λ_M τ/(Kα)", ("push",),
          lambda r: m.velocity(r, Q, 10.0)[0]),
    Claim("o6-bound", ("o6", "thm2"), "largest M^t of a push, as a share of its bound", "1",
          at_most(1.0), "O6: M^t ≤ (1 + 2 λ_M t/π)/(α λ_min(K))", ("push",),
          lambda r: _share(r).max()),
    Claim("o6-share", ("o6",), "M^t of a push at 60 s, as a share of its bound", "1",
          within(0.85, 0.89), SIMULATED, ("push",), lambda r: _share(r)[-1]),
    Claim("thm2-push-0", ("thm2", "o2"), "lambda_M = 0: 1 N.m moves the arm by, and no more",
          "rad", relative(1.0 / (ALPHA * K), 1e-3), "τ/(αK)", ("push-0",),
          lambda r: m.final(r, Q)[0], _BROKEN),
    Claim("thm2-free", ("thm2",), "let go at dq = (2, -1) rad/s: |dq| at 20 s", "rad/s",
          at_most(0.01), "Theorem 2: dq -> 0 if tau_h = 0", ("free",),
          lambda r: m.length(m.final(r, "robot.dq"))),
    Claim("o8-energy", ("o8", "thm2"), "largest rise of V in free motion, as a share of V(0)", "1",
          at_most(1e-6), "O8: dV/dt ≤ 0 if tau_h = 0", ("free",),
          lambda r: m.largest_rise(_energy(r))),
    Claim("o8-gain", ("o8", "thm2"), "|s|_2/|tau_h|_2, theta known", "rad/(N.m.s)",
          at_most(1.0 / K), "O8: 1/λ_min(K)", ("teaching-6-known",),
          lambda r: m.norm(r, "control.s") / m.norm(r, TAU_H)),
)  # fmt: skip

CLAIMS = (*_FIGURES_1_2, *_FIGURE_1_TEXT, *_FIGURE_3, *_THEOREM_2)
