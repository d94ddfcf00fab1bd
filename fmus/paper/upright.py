"""Gravity in Y, as the theorems state it: adapted from 0, in free motion and in the hand.

Free motion of one arm, a teleoperator and six arms comes to rest and agrees although nothing of
gravity is known. In the hand, Theorem 5's equations at rest hold with their terms [ĝ - g], which
is all that is left of the static reflection where gravity is estimated wrongly.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, at_least, at_most
from fmus.paper.experiments import THETA, THETA_G, Document, Table, network, single, teleoperator
from fmus.paper.network import COARSE
from fmus.paper.operators import recording

K, ALPHA, LAMBDA, LAMBDA_M = 16.0, 0.5, 2.0, 10.0
UPRIGHT: Table = {"theta_g": list(THETA_G)}
WALL: Table = {**UPRIGHT, "q_w": 1.0, "k_w": 200.0}
#: A controller that knows nothing and adapts everything; one whose gravity is 5 % off for ever.
NOTHING: dict[str, Any] = {"gravity": 2, "theta_g": [0.0, 0.0], "theta_hat": [0.0] * 5}
WRONG: dict[str, Any] = {
    **NOTHING,
    "theta_hat": [*THETA, *(0.95 * x for x in THETA_G)],
    "Gamma": [1.0, 1.0, 1.0, 0.0, 0.0],
}
ARMS, SIX = ["master.q", "slave.q"], [f"robot{i}.q" for i in range(1, 7)]


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` of the delays and of the switching graphs."""

    def pair(stop: float, slave: Table = UPRIGHT, **options: Any) -> Document:
        made = teleoperator(stop, seed=seed, master=UPRIGHT, slave=slave, **options)
        return recording(made, "master_control.theta_hat", "slave_control.theta_hat")

    return {
        "upright-one": _turned(single(60.0, grip={}, **NOTHING), (0.5, 0.5)),
        "upright-pair": pair(60.0, grip={}, Gamma=8.0, **NOTHING),
        "upright-six": _upright(network(150.0, seed=seed, grip={}, substeps=COARSE, **NOTHING)),
        "upright-wrong": pair(100.0, **WRONG),
        "upright-wrong-wall": pair(100.0, WALL, **WRONG),
        "upright-held": pair(200.0, Gamma=8.0, **NOTHING),
    }


def _turned(document: Document, q: tuple[float, float]) -> Document:
    """The arm upright, at rest at `q` (rad) when it is let go."""
    robot = document["components"]["robot"]
    robot["start"] |= {**UPRIGHT, "q": list(q)}
    return document


def _upright(document: Document) -> Document:
    """All six arms upright."""
    for i in range(1, len(SIX) + 1):
        document["components"][f"robot{i}"]["start"] |= UPRIGHT
    return document


# ---- measures ------------------------------------------------------------------------------------


def gravity(theta_g: m.Array, q: m.Array) -> m.Array:
    """g(q), N.m, (2,): the gradient of theta_g[0] sin q_1 + theta_g[1] sin(q_1 + q_2)."""
    c1, c12 = np.cos(q[0]), np.cos(q[0] + q[1])
    return np.array([theta_g[0] * c1 + theta_g[1] * c12, theta_g[1] * c12])


def _error(r: Run, arm: str, estimate: str) -> m.Array:
    """Error ĝ(q) - g(q) at the end, N.m, (2,)."""
    off = m.final(r, estimate)[3:] - np.array(THETA_G)
    return gravity(off, m.final(r, arm))


def _static(r: Run) -> tuple[m.Array, m.Array]:
    """Errors of both equations of Theorem 5 at rest, N.m, (2,) each."""
    kappa = oracles.static_stiffness(K, ALPHA, LAMBDA_M, LAMBDA)
    q_1, q_2 = (m.final(r, arm) for arm in ARMS)
    felt, pressed = m.final(r, "master.tau_h"), m.final(r, "slave.tau_e")
    one = felt - (kappa * (q_1 - q_2) - _error(r, "master.q", "master_control.theta_hat"))
    two = pressed - (-kappa * (q_2 - q_1) + _error(r, "slave.q", "slave_control.theta_hat"))
    return one, two


def _at_rest(which: int) -> Any:
    return lambda r: m.length(_static(r)[which])


def _reflected(r: Run) -> float:
    """Error of τ_1* - τ_2* against -[ĝ_1 - g_1] - [ĝ_2 - g_2], N.m."""
    off = m.final(r, "master.tau_h") - m.final(r, "slave.tau_e")
    known = [_error(r, f"{side}.q", f"{side}_control.theta_hat") for side in ("master", "slave")]
    return m.largest_error(off, -known[0] - known[1])


def _broken(r: Run) -> float:
    return m.length(m.final(r, "master.tau_h") - m.final(r, "slave.tau_e"))


def _stored(r: Run) -> m.Array:
    """V of eq. (34) with gravity among the parameters, J, (n,)."""
    q, s, theta_hat = r.array("robot.q"), r.array("control.s"), r.array("control.theta_hat")
    kinetic = 0.5 * np.einsum("ki,kij,kj->k", s, oracles.inertia(THETA, q), s)
    return np.asarray(kinetic + ((theta_hat - [*THETA, *THETA_G]) ** 2).sum(axis=1) / (2 * 8.0))


# ---- claims --------------------------------------------------------------------------------------

_ONE, _PAIR, _SIX, _HELD = ((f"upright-{name}",) for name in ("one", "pair", "six", "held"))
_FREE = (
    Claim("upright-one-rest", ("upright", "thm2"), "one arm, gravity adapted from 0, let go: |dq| "
          "at 60 s", "rad/s", at_most(1e-4), "Theorem 2: dq -> 0 if tau_h = 0", _ONE,
          lambda r: m.length(m.final(r, "robot.dq"))),
    Claim("upright-one-balance", ("upright", "thm2"), "and ĝ(q) is off g(q) there by", "N.m",
          at_most(1e-3), "s -> 0: the torque at rest is ĝ", _ONE,
          lambda r: m.length(_error(r, "robot.q", "control.theta_hat"))),
    Claim("upright-one-wrong", ("upright", "thm2"), "while theta_hat is off theta_g by", "N.m",
          at_least(1.0), "no parameter has to converge", _ONE,
          lambda r: m.length(m.final(r, "control.theta_hat")[3:] - np.array(THETA_G))),
    Claim("upright-one-energy", ("upright", "thm2", "o8"), "largest rise of V, as a share of V(0)",
          "1", at_most(1e-3), "(35) without a hand, gravity in Y; sampled", _ONE,
          lambda r: m.largest_rise(_stored(r))),
    Claim("upright-one-place", ("upright", "thm2"), "it hangs: q is off (-π/2, 0) by", "rad",
          at_most(1e-3), "where g = 0, it sank before anything was learnt", _ONE,
          lambda r: m.largest_error(m.final(r, "robot.q"), (-pi / 2, 0.0))),
    Claim("upright-pair-free", ("upright", "thm5"), "teleoperator, the same: arms apart at 60 s",
          "rad", at_most(1e-3), "Theorem 5: synchronisation in free motion", _PAIR,
          lambda r: m.largest_error(m.final(r, ARMS[0]), m.final(r, ARMS[1]))),
    Claim("upright-pair-rest", ("upright", "thm5"), "and they rest: |dq| at 60 s", "rad/s",
          at_most(1e-4), "Theorem 4", _PAIR,
          lambda r: max(m.length(m.final(r, f"{x}.dq")) for x in ("master", "slave"))),
    Claim("upright-six", ("upright", "thm3"), "six arms, ring, the same: apart at 150 s by", "rad",
          at_most(1e-3), "Theorem 3: consensus", _SIX, lambda r: m.spread(r, SIX)[-1]),
)  # fmt: skip

_W, _WW = ("upright-wrong",), ("upright-wrong-wall",)
_STATIC = (
    Claim("static-master", ("upright", "thm5"), "gravity 5 % off: τ_1* off κ(q_1 - q_2) - [ĝ_1 - "
          "g_1] by", "N.m", at_most(1e-6), "Theorem 5 at rest", _W, _at_rest(0)),
    Claim("static-slave", ("upright", "thm5"), "τ_2* off -κ(q_2 - q_1) + [ĝ_2 - g_2] by", "N.m",
          at_most(1e-6), "Theorem 5 at rest", _W, _at_rest(1)),
    Claim("static-master-wall", ("upright", "thm5"), "at a wall: τ_1* off κ(q_1 - q_2) - [ĝ_1 - "
          "g_1] by", "N.m", at_most(1e-6), "Theorem 5 at rest", _WW, _at_rest(0)),
    Claim("static-slave-wall", ("upright", "thm5"), "τ_2* off -κ(q_2 - q_1) + [ĝ_2 - g_2] by",
          "N.m", at_most(1e-6), "Theorem 5 at rest", _WW, _at_rest(1)),
    Claim("static-difference", ("upright", "thm5"), "τ_1* - τ_2* off -[ĝ_1 - g_1] - [ĝ_2 - g_2] "
          "by", "N.m", at_most(1e-6), "the two equations subtracted", _WW, _reflected),
    Claim("static-broken", ("upright", "thm5"), "so that τ_1* and τ_2* differ by", "N.m",
          at_least(0.1), "no static reflection with estimation errors of gravity", _WW, _broken,
          "gravity is estimated wrongly"),
    Claim("static-held", ("upright", "thm5"), "adapted from 0 in the hand: τ_1* off κ(q_1 - q_2) "
          "- [ĝ_1 - g_1] by", "N.m", at_most(0.02), "Theorem 5; |dq| < 1e-3 rad/s by then", _HELD,
          _at_rest(0)),
    Claim("static-held-broken", ("upright", "thm5"), "and the hand holds, more than is felt at the "
          "slave, by", "N.m", at_least(5.0), "no static reflection: the estimate carries the hand",
          _HELD, _broken, "gravity is adapted"),
)  # fmt: skip

CLAIMS = (*_FREE, *_STATIC)
