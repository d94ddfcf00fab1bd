"""Theorem 2 in numbers: (34)-(39), gains, Remark 3, and both cases of Sec. IV-C."""

from __future__ import annotations

from math import hypot, log, sqrt
from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, absolute, at_most, relative, within
from fmus.paper.equations import GAMMA, K_OFF, K
from fmus.paper.experiments import Q_H, THETA, Document, single
from fmus.paper.operators import held_by, pushing

ALPHA, LAMBDA_M, K_P, H = 2.0, 6.0, 10.0, 1e-3
KNOWN: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
#: Rates of the sines of (33), rad/s; Remark 3's λ_c, 1/s; z at the start, rad/s.
RATES, LAMBDA_C, Z_0 = (1.0, 20.0), 6.0, (0.5, -0.25)
#: When the push of Sec. IV-C ends, and when that which stores the most energy does, s.
LET_GO, UNTIL = 5.0, 4.0
#: A push of both joints, N.m, so slow that the turning of the arm does not matter.
SLOW = 0.1
TWICE: dict[str, Any] = {"theta": [2 * x for x in THETA]}


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; nothing in them is random."""
    both: dict[str, Any] = {"grip": {}, "arm_values": {"tau_ext": [SLOW, SLOW]}, "every": 4}
    start: dict[str, Any] = {"grip": {}, "period": H, "lambda_c": LAMBDA_C, "Gamma": 0.0}
    moving: dict[str, Any] = {"dq": [2.0, -1.0]}
    adapted: dict[str, Any] = {"lambda_c": 5.0, "theta_hat": list(THETA)}
    sines = {f"sine-{w:g}": _sine(w) for w in RATES}
    return sines | {
        "unequal-push": single(60.0, **both, K=list(K), **KNOWN),
        "full-push": single(60.0, **both, K=list(K), K_off=K_OFF, **KNOWN),
        "unequal-rest": single(60.0, K=list(K), lambda_M=0.0, **KNOWN),
        "offset": single(60.0, lambda_M=0.0, z=list(Z_0), **KNOWN),
        "worst": _worst(),
        "remark3-free": single(2.0, **start, theta_hat=list(THETA), arm_values=moving),
        "remark3-free-2": single(2.0, **start, theta_hat=TWICE["theta"], arm_values=moving | TWICE),
        "remark3-1": single(40.0, **adapted),
        "remark3-2": single(40.0, arm_values=TWICE, **adapted),
        "teaching-6-2": single(20.0, arm_values=TWICE),
        "let-go": pushing(single(20.0, grip={}, **KNOWN), "robot", (1.0, 0.0), LET_GO),
        "let-go-velocity": pushing(
            single(20.0, grip={}, alpha=0.0, **KNOWN), "robot", (1.0, 0.0), LET_GO
        ),
    }


def _sine(rate: float) -> Document:
    """The arm, theta known, under a sine of 1 N.m on its first joint."""
    hand = {
        "model": "fmus.paper.components:sine",
        "options": {"amplitude": [1.0, 0.0], "rate": rate},
    }
    return held_by(single(30.0, period=H, grip={}, every=2, **KNOWN), "robot", hand)


_values, _vectors = np.linalg.eigh(oracles.inertia(THETA, np.zeros((1, 2)))[0])
#: The direction in which the arm is heaviest at q = 0, and its inertia there, kg.m2.
_HEAVY, _DIRECTION = float(_values[-1]), _vectors[:, -1]


def _worst() -> Document:
    """The arm, theta known, under the push that stores the most energy of s for its effort."""
    hand = {
        "model": "fmus.paper.components:swelling",
        "options": {
            "amplitude": [0.1 * float(x) for x in _DIRECTION],
            "rate": 16.0 / _HEAVY,
            "until": UNTIL,
        },
    }
    return held_by(single(UNTIL, period=H, grip={}, **KNOWN), "robot", hand)


# ---- (34)-(36): energy of s and of the estimate -------------------------------------------------


def _stored(r: Run, gamma: Any = GAMMA) -> m.Array:
    """V of eq. (34), J, (n,)."""
    q, s, theta_hat = r.array("robot.q"), r.array("control.s"), r.array("control.theta_hat")
    kinetic = 0.5 * np.einsum("ki,kij,kj->k", s, oracles.inertia(THETA, q), s)
    return np.asarray(kinetic + 0.5 * ((theta_hat - np.array(THETA)) ** 2 / gamma).sum(axis=1))


def _flow(r: Run, power: Any) -> m.Array:
    """∫ of a power of (s, tau_h) from the start to each row, J, (n,)."""
    s, tau_h = r.array("control.s"), r.array("robot.tau_h")
    return m.integral(np.array([power(a, b) for a, b in zip(s, tau_h, strict=True)]), r.t)


def _balance(r: Run) -> float:
    """Largest error of V against V(0) - ∫sᵀKs + ∫sᵀτ_h, as a share of ∫sᵀKs at the end."""
    V, fed = _stored(r), _flow(r, lambda s, tau: s @ tau)
    lost = _flow(r, lambda s, tau: s @ np.diag(K) @ s)
    return float(np.abs(V - V[0] + lost - fed).max() / lost[-1])


def _inequality(r: Run) -> float:
    """Largest (V + ½∫sᵀKs)/(V(0) + ½∫τᵀK⁻¹τ) from 0.1 s on."""
    inverse = np.diag(1 / np.array(K))
    lost = _flow(r, lambda s, tau: 0.5 * s @ np.diag(K) @ s)
    paid = _flow(r, lambda s, tau: 0.5 * tau @ inverse @ tau)
    V = _stored(r)
    return float(((V + lost) / (V[0] + paid))[m.row(r, 0.1) :].max())


def _mixed(r: Run) -> float:
    """Largest V over ½∫τᵀK⁻¹τ with theta known: 2 sup V K/‖τ‖²."""
    kinetic = _stored(r, np.inf)
    return float(kinetic.max() / (0.5 * m.norm(r, "hand.tau_h") ** 2 / 16.0))


_ENERGY = (
    Claim("eq35", ("eq35", "thm2", "o8"), "(35) under a hand, adapting from 0: V off the balance "
          "by", "1", at_most(0.005), "V̇ = -sᵀKs + sᵀτ_h; sampled at 1 ms", ("unequal",), _balance),
    Claim("eq36", ("eq35", "thm2", "o8"), "(36): largest (V + ½∫sᵀKs)/(V(0) + ½∫τ_hᵀK⁻¹τ_h)", "1",
          at_most(1.0), "the inequality after (35), integrated", ("unequal",), _inequality),
    Claim("thm2-mixed", ("thm2", "eq35"), "L₂ to L_∞: largest V over ½‖τ_h‖²/K, exponential push",
          "1", relative(0.5, 0.01), "the worst push exp(Kt/M) attains half of the bound",
          ("worst",), _mixed),
)  # fmt: skip


# ---- (33), (37)-(39): the dynamic cascade from s to q -------------------------------------------


def _amplitude(r: Run, name: str, rate: float) -> float:
    """Amplitude at `rate` (rad/s) of the first joint of a signal over the last whole periods."""
    periods = int(10.0 * rate / (2 * np.pi))
    rows = r.t > r.t[-1] - periods * 2 * np.pi / rate
    x, t = r.array(name)[rows, 0], r.t[rows]
    x = x - x.mean()
    return hypot(float((x * np.sin(rate * t)).mean()), float((x * np.cos(rate * t)).mean())) * 2


def _cascade(rate: float) -> Claim:
    gain = hypot(LAMBDA_M, rate) / hypot(ALPHA, rate)
    return Claim(
        f"eq33-{rate:g}", ("eq33", "thm2"), f"(33): |dq|/|s| of a sine at {rate:g} rad/s", "1",
        relative(gain, 0.01), "|jω + λ_M|/|jω + α|; a cascade without ds would give "
        f"{LAMBDA_M / hypot(ALPHA, rate):.3g}, one without λ_M s {rate / hypot(ALPHA, rate):.3g}",
        (f"sine-{rate:g}",),
        lambda r: _amplitude(r, "robot.dq", rate) / _amplitude(r, "control.s", rate),
    )  # fmt: skip


def _integrated(r: Run) -> float:
    """Largest error of dq against -α(q - ψ_0) + λ_M∫s + s, rad/s."""
    q, dq, s, z = (r.array(x) for x in ("robot.q", "robot.dq", "control.s", "control.z"))
    psi_0 = q[0] + z[0] / ALPHA
    rise = np.stack([m.integral(column, r.t) for column in s.T], axis=1)
    return m.largest_error(dq, -ALPHA * (q - psi_0) + LAMBDA_M * rise + s)


_PSI_0 = np.array(Z_0) / ALPHA
_OFFSET = oracles.rest_position(_PSI_0, Q_H, 16.0, ALPHA, K_P)
_CASCADE = (
    *(_cascade(rate) for rate in RATES),
    Claim("eq39", ("eq33", "thm2"), "dq off -α(q - ψ_0) + λ_M∫s + s by", "rad/s", at_most(0.02),
          "(37) and (38) added; sampled at 1 ms, |dq| up to 2", ("unequal",), _integrated),
    Claim("thm2-psi0", ("thm2", "o2"), "lambda_M = 0, z(0) = (0.5, -0.25): q is off the rest of "
          "ψ_0 by", "rad", at_most(1e-3), "O2 with ψ_0 = q(0) + z(0)/α in place of q(0)",
          ("offset",), lambda r: m.largest_error(m.final(r, "robot.q"), _OFFSET), "lambda_M = 0"),
)  # fmt: skip


# ---- gains with K that is no multiple of I ------------------------------------------------------

_FULL = np.array([[K[0], K_OFF], [K_OFF, K[1]]])
_SMALLEST = float(np.linalg.eigvalsh(_FULL)[0])


def _drift(joint: int) -> Any:
    return lambda r: m.velocity(r, "robot.q", 10.0)[joint]


def _push_drift(joint: int, text: str, matrix: m.Array, case: str, share: float = 0.01) -> Claim:
    drift = float((LAMBDA_M / ALPHA * np.linalg.solve(matrix, [SLOW, SLOW]))[joint])
    return Claim(
        f"{case}-{joint + 1}", ("matrix", "o4", "thm2"), f"{text}: (0.1, 0.1) N.m moves joint "
        f"{joint + 1}, for ever, at", "rad/s", relative(drift, share),
        "O4: λ_M K⁻¹τ/α; the arm turns slowly", (case,), _drift(joint),
    )  # fmt: skip


def _attained(r: Run) -> float:
    """|s|₂/|τ_h|₂ under the push of both joints, rad/(N.m.s)."""
    return m.norm(r, "control.s") / (hypot(SLOW, SLOW) * sqrt(float(r.t[-1])))


_UNEVEN_REST = np.array(
    [oracles.rest_position(0.0, a, k, ALPHA, K_P) for a, k in zip(Q_H, K, strict=True)]
)
_MATRIX = (
    *(_push_drift(j, "K = diag(20, 8)", np.diag(K), "unequal-push") for j in (0, 1)),
    _push_drift(0, "K with 6 off its diagonal", _FULL, "full-push", 0.1),
    _push_drift(1, "K with 6 off its diagonal", _FULL, "full-push"),
    Claim("unequal-rest", ("matrix", "o2"), "K = diag(20, 8), lambda_M = 0: rest is off O2 by",
          "rad", at_most(1e-3), "O2 of each joint", ("unequal-rest",),
          lambda r: m.largest_error(m.final(r, "robot.q"), _UNEVEN_REST), "lambda_M = 0"),
    Claim("full-gain", ("matrix", "o8", "thm2"), "K full: |s|_2/|tau_h|_2 of (0.1, 0.1) N.m",
          "rad/(N.m.s)", relative(float(np.linalg.norm(np.linalg.solve(_FULL, np.ones(2)))) /
                                  hypot(1.0, 1.0), 0.01),
          f"|K⁻¹τ|/|τ|, below 1/λ_min(K) = {1 / _SMALLEST:.4g}", ("full-push",), _attained),
)  # fmt: skip


# ---- Remark 3 -----------------------------------------------------------------------------------


def _fading(theta: Any) -> Any:
    def rate(r: Run) -> float:
        """Rate of ½sᵀM(q)s over 1 s, 1/s."""
        s, M = r.array("control.s"), oracles.inertia(theta, r.array("robot.q"))
        energy = np.einsum("ki,kij,kj->k", s, M, s)
        return log(energy[m.row(r, 1.0)] / energy[0])

    return rate


def _longer(one: Run, twice: Run) -> float:
    first, second = (m.time_to_target(r, ["robot.q"], Q_H) for r in (one, twice))
    return second / first


_FADES = -2 * LAMBDA_C
_REMARK_3 = (
    Claim("remark3-rate", ("remark3",), "theta known, let go: ½sᵀMs decays with", "1/s",
          relative(_FADES, 0.01), "V̇ = -λ_c sᵀMs: -2λ_c, however the arm moves",
          ("remark3-free",), _fading(THETA)),
    Claim("remark3-rate-2", ("remark3",), "with twice the inertia, known: it decays with", "1/s",
          relative(_FADES, 0.01), "the same: no inertia in it", ("remark3-free-2",),
          _fading(TWICE["theta"])),
    Claim("remark3-twice", ("remark3",), "λ_c = 5: twice the inertia, unknown, settles later by a "
          "factor of", "1", within(0.95, 1.08), "Remark 3: the response is hardly changed; "
          "second simulator: 1.031", ("remark3-1", "remark3-2"), _longer),
    Claim("constant-twice", ("remark3",), "K = 16 instead: by a factor of", "1",
          relative(7.99 / 5.82, 0.03), "second simulator: 5.82 and 7.985 s",
          ("teaching-6", "teaching-6-2"), _longer),
)  # fmt: skip


# ---- Sec. IV-C: the velocity as the output ------------------------------------------------------


def _velocity_gain(r: Run) -> float:
    """|dq|₂ over that of a push of 1 N.m, rad/(N.m.s)."""
    return m.norm(r, "robot.dq") / sqrt(float(r.t[-1]))


def _velocity_slope(r: Run) -> float:
    """Slope d log M^t/d log t of the velocity under a constant push, second half of the run."""
    half = m.row(r, r.t[-1] / 2)
    square = m.integral((r.array("robot.dq") ** 2).sum(axis=1), r.t)
    return log((square[-1] / r.t[-1]) / (square[half] / r.t[half])) / log(r.t[-1] / r.t[half]) / 2


_IV_C = (
    Claim("sec4c-finite", ("sec4c",), "alpha = 2: |dq|_2/|tau_h|_2 of 1 N.m over 60 s",
          "rad/(N.m.s)", relative(LAMBDA_M / (ALPHA * 16.0), 0.02), "λ_M/(αK): finite", ("push",),
          _velocity_gain),
    Claim("sec4c-finite-slope", ("sec4c",), "alpha = 2: slope of M^t of the velocity", "1",
          absolute(0.0, 0.02), "finite: it stops growing", ("push",), _velocity_slope),
    Claim("sec4c-infinite-slope", ("sec4c",), "alpha = 0: slope of M^t of the velocity", "1",
          absolute(1.0, 0.1), "one pure integral: dq ~ t", ("velocity",), _velocity_slope),
    Claim("sec4c-let-go", ("sec4c",), "alpha = 2: let go after 5 s, |dq| at 20 s", "rad/s",
          at_most(1e-6), "a velocity must be held by a torque", ("let-go",),
          lambda r: m.length(m.final(r, "robot.dq"))),
    Claim("sec4c-kept", ("sec4c",), "alpha = 0: let go after 5 s, dq_1 at 20 s", "rad/s",
          relative(LAMBDA_M * LET_GO / 16.0, 0.01), "λ_M τt/K: it stays", ("let-go-velocity",),
          lambda r: m.final(r, "robot.dq")[0]),
    Claim("sec4c-kept-for", ("sec4c",), "and in the last 10 s it has changed by", "rad/s",
          at_most(0.01), "no torque is needed", ("let-go-velocity",),
          lambda r: np.ptp(r.array("robot.dq")[m.row(r, 10.0) :, 0])),
)  # fmt: skip

CLAIMS = (*_ENERGY, *_CASCADE, *_MATRIX, *_REMARK_3, *_IV_C)
