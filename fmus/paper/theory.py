"""Sec. III and IV: the point mass, Theorem 1, velocity as the output, Remark 3, gravity."""

from __future__ import annotations

from math import log, pi
from typing import Any

import numpy as np

from cosim.record import Run
from fmus.arms.dynamics import inertia
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, absolute, at_least, at_most, relative
from fmus.paper.experiments import (
    Q_H,
    THETA,
    THETA_G,
    Document,
    Table,
    damped,
    mass,
    single,
    teleoperator,
)

K, ALPHA, DAMPING = 16.0, 2.0, 5.0
Q, TAU_H = "robot.q", "robot.tau_h"
#: Start of free motion under Theorem 1, rad/s.
DQ = (2.0, -1.0)
PUSH: Table = {"tau_ext": [1.0, 0.0]}  # N.m
KNOWN: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
#: A stiff grip next to rest, and gains on both sides of the limit with K = λ_c M̂ (Remark 3).
HELD, STIFF, LAMBDA_C, GAINS = (0.3, 0.2), 5000.0, 6.0, (5.0, 6.0, 6.3, 6.8)


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` is that of the links."""
    runs = {
        "mass": mass(1000.0, b=1.0),
        "mass-push": mass(200.0, b=1.0, force=1.0),
        "mass-push-free": mass(200.0, b=0.0, force=1.0),
        "damped": damped(60.0),
        "damped-push": damped(80.0, grip={}, **PUSH),
        "damped-free": damped(15.0, grip={}, q=(0.5, 0.5), dq=DQ),
        "damped-wrong": damped(60.0, known=0.8),
        "damped-wrong-push": damped(60.0, known=0.8, grip={}, **PUSH),
        "damped-wrong-free": damped(60.0, known=0.8, grip={}, q=(0.5, 0.5)),
        "velocity": single(20.0, grip={}, arm_values=PUSH, alpha=0.0, **KNOWN),
    }
    for gain in GAINS:
        runs[f"remark3-{gain:g}"] = single(
            8.0, period=5e-4, grip={"k_p": STIFF, "k_d": 0.0, "q_h": list(HELD)}, alpha=0.5,
            lambda_M=gain, lambda_c=LAMBDA_C, **KNOWN,
        )  # fmt: skip
    for mode, name in ((1, "compensated"), (2, "adapted")):
        runs[f"gravity-{name}"] = _upright(mode)
        runs[f"gravity-{name}-pair"] = _upright_pair(60.0, mode, seed)
        runs[f"gravity-{name}-wall"] = _upright_pair(120.0, mode, seed, q_w=1.0, k_w=200.0)
    return runs


def _upright(mode: int) -> Document:
    """One arm with gravity, everything known at the start, pushed."""
    arm_values = {**PUSH, "theta_g": list(THETA_G)}
    return single(120.0, grip={}, arm_values=arm_values, **_everything(mode))


def _upright_pair(stop: float, mode: int, seed: int, **wall: float) -> Document:
    """The teleoperator with gravity, everything known at the start, the slave at a wall or not."""
    upright = {"theta_g": list(THETA_G)}
    values = {**_everything(mode), "Gamma": 8.0}
    return teleoperator(stop, seed=seed, master=upright, slave={**upright, **wall}, **values)


def _everything(mode: int) -> dict[str, Any]:
    """Gains of a controller that starts from the true parameters; `mode` of gravity."""
    return {"gravity": mode, "theta_g": list(THETA_G), "theta_hat": [*THETA, *THETA_G]}


# ---- Sec. III: the point mass -------------------------------------------------------------------

_POINT_MASS = (
    Claim("mass-force", ("sec3",), "f = 1/(t + 1): |f|_2 over 1000 s", "N.√s",
          relative(1.0, 0.005), "∫f² dt = 1", ("mass",), lambda r: m.norm(r, "mass.f")),
    Claim("mass-position", ("sec3",), "a finite effort moves the mass to x(1000 s) =", "m",
          relative(log(1001.0), 0.002), "m dx = -bx + ln(t + 1)", ("mass",),
          lambda r: m.final(r, "mass.x")[0]),
    Claim("mass-degree-1", ("sec3",), "b > 0: slope of M^t of a push, 100 to 200 s", "1",
          absolute(1.0, 0.02), "degree one: x ~ t", ("mass-push",),
          lambda r: m.growth(r, "mass.f", ["mass.x"], 100.0, 200.0)),
    Claim("mass-degree-2", ("sec3",), "b = 0: slope of M^t of a push, 100 to 200 s", "1",
          absolute(2.0, 0.02), "degree two: x ~ t²", ("mass-push-free",),
          lambda r: m.growth(r, "mass.f", ["mass.x"], 100.0, 200.0)),
)  # fmt: skip


# ---- Theorem 1: damping and gravity compensation ------------------------------------------------


def _turning(r: Run) -> float:
    """Mean velocity over a turn, rad/s."""
    return float(m.velocity(r, Q, 2 * pi * DAMPING)[0])


def _dissipated(r: Run) -> float:
    """∫ d|dq|² dt over V(0) = ½ dqᵀM dq, eq. (27) without a hand integrated."""
    dq = np.array(DQ)
    V = 0.5 * dq @ inertia(np.array(THETA), r.array(Q)[0]) @ dq
    return float(DAMPING * m.norm(r, "robot.dq") ** 2 / V)


_WRONG = "gravity compensated by 80 %"
_THEOREM_1 = (
    Claim("thm1-push", ("thm1",), "1 N.m turns the arm, for ever, at", "rad/s",
          relative(1.0 / DAMPING, 0.01), "Theorem 1: v = τ/d", ("damped-push",), _turning),
    Claim("thm1-gain", ("thm1",), "|dq|_2/|tau_h|_2", "rad/(N.m.s)", at_most(1.0 / DAMPING),
          "Theorem 1: 1/d", ("damped",), lambda r: m.norm(r, "robot.dq") / m.norm(r, TAU_H)),
    Claim("thm1-energy", ("thm1",), "let go in motion: the damping takes, of V(0),", "1",
          relative(1.0, 0.005), "(27): V̇ = -d|dq|² without a hand", ("damped-free",), _dissipated),
    Claim("thm1-free", ("thm1",), "and the arm comes to rest: |dq| at 15 s", "rad/s",
          at_most(1e-4), "Theorem 1: dq -> 0 if tau_h = 0", ("damped-free",),
          lambda r: m.length(m.final(r, "robot.dq"))),
    Claim("thm1-rest", ("thm1",), "in the hand at q_h it rests: |tau_h| at 60 s", "N.m",
          at_most(1e-3), "Theorem 1", ("damped",), lambda r: m.length(m.final(r, TAU_H))),
    Claim("thm1-slope", ("thm1",), "M^t grows: d log M/d log t, 30 to 60 s", "1",
          absolute(0.5, 0.05), "1/2 once the hand rests", ("damped",),
          lambda r: m.growth(r, TAU_H, [Q], 30.0, 60.0)),
    Claim("thm1-wrong-push", ("thm1",), "wrong gravity: the push ends at", "rad/s",
          at_most(1e-3), "the arm rests where gravity balances the push",
          ("damped-wrong-push",), lambda r: np.abs(m.velocity(r, Q, 10.0)).max(), _WRONG),
    Claim("thm1-wrong-held", ("thm1",), "wrong gravity: |tau_h| held for ever", "N.m",
          at_least(1.0), "what is left of gravity", ("damped-wrong",),
          lambda r: m.length(m.final(r, TAU_H)), _WRONG),
    Claim("thm1-wrong-free", ("thm1",), "wrong gravity: let go at rest, the arm sinks by", "rad",
          at_least(1.0), "to where it hangs, (-π/2, 0)", ("damped-wrong-free",),
          lambda r: m.largest_error(m.final(r, Q), r.array(Q)[0]), _WRONG),
)  # fmt: skip


# ---- Sec. IV-C, Remark 3 ------------------------------------------------------------------------


def _onset(*runs: Run) -> float:
    """The gain at which the oscillation neither grows nor decays, between those tried, 1/s."""
    return float(np.interp(0.0, [m.oscillation_growth(r, Q, HELD) for r in runs], GAINS))


_REMARK_3 = tuple(f"remark3-{gain:g}" for gain in GAINS)
_OPTIONS = (
    Claim("sec4c-velocity", ("sec4c",), "alpha = 0: 1 N.m changes the velocity, for ever, by",
          "rad/s2", relative(6.0 / K, 0.01), "Sec. IV-C: ddq = λ_M s + ds, s = τ/K",
          ("velocity",), lambda r: m.velocity(r, "robot.dq", 5.0)[0]),
    Claim("remark3-onset", ("remark3", "o9"), "K = 6 M_hat: oscillates in a stiff grip from "
          "lambda_M =", "1/s", relative(0.5 + LAMBDA_C, 0.02), "O9: α + λ_c", _REMARK_3, _onset),
)  # fmt: skip


# ---- gravity that is adapted --------------------------------------------------------------------


def _cancelled(r: Run) -> float:
    """Largest entry of G(q) (θ̂_g - θ_g) + τ at the end, N.m: 0 if the estimate ate the push."""
    q, theta_hat = m.final(r, Q), m.final(r, "control.theta_hat")
    c1, c12 = np.cos(q[0]), np.cos(q.sum())
    error = theta_hat[3:] - np.array(THETA_G)
    estimated = np.array([c1 * error[0] + c12 * error[1], c12 * error[1]])
    return m.largest_error(estimated, [-1.0, 0.0])


def _reflection_error(r: Run) -> float:
    return m.largest_error(m.final(r, "master.tau_h"), m.final(r, "slave.tau_e"))


def _holding(r: Run) -> float:
    return m.length(m.final(r, "master.tau_h"))


_DRIFT = 1.0 / oracles.felt_damping(K, ALPHA, 6.0)
_KAPPA = oracles.static_stiffness(K, 0.5, 10.0, 2.0)
_FELT = float(oracles.wall_torque(Q_H, 1.0, 10.0, _KAPPA, 200.0)[0])
_ADAPTED = "gravity is adapted"
_GRAVITY = (
    Claim("gravity-push", ("gravity", "thm2"), "gravity compensated: 1 N.m moves the arm at",
          "rad/s", relative(_DRIFT, 0.03), "O4", ("gravity-compensated",),
          lambda r: m.velocity(r, Q, 2 * pi / _DRIFT)[0]),
    Claim("gravity-adapted", ("gravity", "thm2"), "gravity adapted: 1 N.m ends at", "rad/s",
          at_most(1e-3), "the estimate integrates s: s -> 0", ("gravity-adapted",),
          lambda r: np.abs(m.velocity(r, Q, 10.0)).max(), _ADAPTED),
    Claim("gravity-estimate", ("gravity", "thm2"), "because G (theta_g_hat - theta_g) is off "
          "-tau by", "N.m", at_most(1e-3), "the estimate cancels the push", ("gravity-adapted",),
          _cancelled, _ADAPTED),
    Claim("gravity-wall", ("gravity", "thm5"), "pair, gravity compensated, wall: torque felt",
          "N.m", relative(_FELT, 1e-3), "O5", ("gravity-compensated-wall",),
          lambda r: m.final(r, "master.tau_h")[0]),
    Claim("gravity-wall-adapted", ("gravity", "thm5"), "pair, gravity adapted: torque on the "
          "wall is off that felt by", "N.m", at_least(10.0), "s -> 0 lets q_1 - q_2 -> 0: "
          "no static reflection", ("gravity-adapted-wall",), _reflection_error, _ADAPTED),
    Claim("gravity-pair", ("gravity", "thm5"), "pair, gravity compensated: |tau_h| at 60 s",
          "N.m", at_most(1e-3), "Theorem 5", ("gravity-compensated-pair",), _holding),
    Claim("gravity-pair-adapted", ("gravity", "thm5"), "pair, gravity adapted: |tau_h| held for "
          "ever", "N.m", at_least(1.0), "the estimate balances the hand",
          ("gravity-adapted-pair",), _holding, _ADAPTED),
)  # fmt: skip

CLAIMS = (*_POINT_MASS, *_THEOREM_1, *_OPTIONS, *_GRAVITY)
