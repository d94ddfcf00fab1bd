"""What the paper does not say: passivity, stiff grips, sampling periods. O9 and its kin."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, at_most, relative, stopped, within
from fmus.paper.experiments import Q_H, THETA, Document, Table, single, teleoperator

K, ALPHA = 16.0, 0.5
TIGHT = {"k_p": 200.0, "k_d": 2.0, "q_h": list(Q_H)}
#: Where the stiff grip holds the arm, rad, and how stiff it is, N.m/rad.
HELD, STIFF = (0.3, 0.2), 5000.0
#: Gains on both sides of the limit O9, 1/s.
GAINS = (2.0, 2.5, 2.8, 3.1, 3.5)
#: Sampling periods, s, at which each system still works, and at which it does not.
LADDER = {"single": (0.015, 0.025), "pair": (0.015, 0.03)}


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` is that of the links."""
    works, fails = LADDER["pair"]
    runs = {
        "tight-10": teleoperator(20.0, seed=seed, grip=TIGHT),
        "tight-1": teleoperator(20.0, seed=seed, grip=TIGHT, lambda_M=1.0),
        "tight-10-fine": teleoperator(20.0, seed=seed, grip=TIGHT, period=1e-3),
        "pair-slow": teleoperator(30.0, seed=seed, period=works),
        "pair-too-slow": teleoperator(30.0, seed=seed, period=fails),
        "single-slow": single(21.0, period=LADDER["single"][0]),
        "single-too-slow": single(21.0, period=LADDER["single"][1]),
    }
    return runs | {f"stiff-{gain:g}": _stiff(gain) for gain in GAINS}


def _stiff(lambda_M: float) -> Document:
    """One arm, theta known, in an undamped grip next to rest; sampled finely."""
    grip: Table = {"k_p": STIFF, "k_d": 0.0, "q_h": list(HELD)}
    known: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
    return single(8.0, period=5e-4, grip=grip, alpha=ALPHA, lambda_M=lambda_M, **known)


def _growth(r: Run) -> float:
    return m.swell(r, "robot.q", HELD)


def _onset(*runs: Run) -> float:
    """The gain at which the oscillation neither grows nor decays, between those tried, 1/s."""
    return float(np.interp(0.0, [_growth(r) for r in runs], GAINS))


def _swing(r: Run) -> float:
    """RMS of the first joint about its mean over the last quarter, rad."""
    x = r.column("master.q[0]")
    return float(x[-len(x) // 4 :].std())


_LIMIT = oracles.grip_limit(oracles.passive_limit(THETA, HELD, K, ALPHA), K, ALPHA, STIFF)
_STIFF = tuple(f"stiff-{gain:g}" for gain in GAINS)
CLAIMS = (
    Claim("o9-onset", ("o9", "robust"), "stiff grip, theta known: oscillates from lambda_M =",
          "1/s", relative(_LIMIT, 0.02), "O9: α + λ_min(K M⁻¹), for k_p -> ∞", _STIFF, _onset),
    Claim("o9-inside", ("o9", "robust"), "lambda_M = 2: its growth rate", "1/s", at_most(-0.1),
          "O9: below the limit", ("stiff-2",), _growth),
    Claim("tight-10", ("robust", "o9"), "grip of 200 N.m/rad, lambda_M = 10: diverges at", "s",
          within(0.1, 0.3), "independent simulation: 0.18 s", ("tight-10",), stopped,
          "lambda_M above the limit O9", True),
    Claim("tight-10-fine", ("robust", "o9"), "sampled at 1 ms: goes on swinging, RMS", "rad",
          within(0.15, 0.4), "independent simulation: 0.2 to 0.3 as T_s -> 0", ("tight-10-fine",),
          _swing, "lambda_M above the limit O9"),
    Claim("tight-1", ("robust",), "the same grip, lambda_M = 1: master at q_h from", "s",
          at_most(12.0), "O9: below the limit", ("tight-1",),
          lambda r: m.settled(r, ["master.q"], Q_H)),
    Claim("ladder-single", ("robust",), "one arm sampled at 15 ms: at q_h from", "s",
          relative(5.8, 0.1), "independent simulation: 15 ms is the limit", ("single-slow",),
          lambda r: m.settled(r, ["robot.q"], Q_H)),
    Claim("ladder-single-end", ("robust",), "one arm sampled at 25 ms: diverges at", "s",
          at_most(2.0), "independent simulation: 15 ms is the limit", ("single-too-slow",),
          stopped, "T_s too long", True),
    Claim("ladder-pair", ("robust",), "teleoperator sampled at 15 ms: at q_h from", "s",
          within(11.2, 12.0), "as at 5 ms; at 20 ms 3 of 40 seeds diverge", ("pair-slow",),
          lambda r: m.settled(r, ["master.q", "slave.q"], Q_H)),
    Claim("ladder-pair-end", ("robust",), "teleoperator sampled at 30 ms: diverges at", "s",
          at_most(3.0), "independent simulation: 20 ms is the limit", ("pair-too-slow",), stopped,
          "T_s too long", True),
)  # fmt: skip
