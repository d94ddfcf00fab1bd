"""Properties that the paper does not cover: passivity, stiff grips, sampling periods; O9."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, at_most, relative, stopped, within
from fmus.paper.experiments import (
    DELAY,
    Q_H,
    THETA,
    Document,
    Table,
    network,
    single,
    teleoperator,
)

ALPHA = 0.5
TIGHT = {"k_p": 200.0, "k_d": 2.0, "q_h": list(Q_H)}
#: Where the stiff grip holds the arm, rad, and how stiff it is, N.m/rad.
HELD, STIFF = (0.3, 0.2), 5000.0
#: Feedback gains, N.m.s/rad, and lambda_M on both sides of the limit O9, as shares of it.
FEEDBACK, SHARES = (8.0, 16.0, 32.0), (0.7, 0.9, 1.05, 1.2)
ARMS = ["master.q", "slave.q"]
SIX = [f"robot{i}.q" for i in range(1, 7)]


def limit(K: float) -> float:
    """O9 with the stiff grip, 1/s."""
    return oracles.grip_limit(oracles.passive_limit(THETA, HELD, K, ALPHA), K, ALPHA, STIFF)


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` is that of links and graphs."""
    delayed: dict[str, Any] = {"link": {"delay": dict(DELAY)}, "seed": seed}
    runs = {
        "tight-10": teleoperator(20.0, seed=seed, grip=TIGHT),
        "tight-1": teleoperator(20.0, seed=seed, grip=TIGHT, lambda_M=1.0),
        "tight-10-fine": teleoperator(20.0, seed=seed, grip=TIGHT, period=1e-3),
        "single-15ms": single(21.0, period=0.015),
        "single-25ms": single(21.0, period=0.025),
        "pair-15ms": teleoperator(30.0, seed=seed, period=0.015),
        "pair-30ms": teleoperator(30.0, seed=seed, period=0.03),
        "net-6ms": network(72.0, period=0.006, **delayed),
        "net-15ms": network(72.0, period=0.015, **delayed),
        "net-10ms-slow": network(72.0, period=0.01, Gamma=1.0, **delayed),
    }
    stiff = {f"stiff-{K:g}-{share:g}": _stiff(K, share) for K in FEEDBACK for share in SHARES}
    return runs | stiff


def _stiff(K: float, share: float) -> Document:
    """One arm, theta known, in an undamped grip next to rest; sampled finely."""
    grip: Table = {"k_p": STIFF, "k_d": 0.0, "q_h": list(HELD)}
    gains: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0, "K": K, "alpha": ALPHA}
    return single(8.0, period=5e-4, grip=grip, every=4, lambda_M=share * limit(K), **gains)


def _growth(r: Run) -> float:
    return m.oscillation_growth(r, "robot.q", HELD)


def _onset(K: float) -> Claim:
    """The gain at which the oscillation neither grows nor decays, between those tried."""

    def found(*runs: Run) -> float:
        return limit(K) * float(np.interp(0.0, [_growth(r) for r in runs], SHARES))

    return Claim(
        f"o9-{K:g}", ("o9", "robust"), f"K = {K:g}, stiff grip: oscillates from lambda_M =",
        "1/s", relative(limit(K), 0.02), "O9: α + λ_min(K M⁻¹), for k_p -> ∞",
        tuple(f"stiff-{K:g}-{share:g}" for share in SHARES), found,
    )  # fmt: skip


def _swing(r: Run) -> float:
    """RMS of the first joint about its mean over the last quarter, rad."""
    x = r.column("master.q[0]")
    return float(x[-len(x) // 4 :].std())


_LADDER = "independent simulation: longest period {}"
CLAIMS = (
    *(_onset(K) for K in FEEDBACK),
    Claim("tight-10", ("robust", "o9"), "grip of 200 N.m/rad, lambda_M = 10: diverges at", "s",
          within(0.1, 0.3), "independent simulation: 0.18 s", ("tight-10",), stopped,
          "lambda_M above the limit O9", True),
    Claim("tight-10-fine", ("robust", "o9"), "sampled at 1 ms: goes on swinging, RMS", "rad",
          within(0.15, 0.4), "independent simulation: 0.2 to 0.3 as T_s -> 0", ("tight-10-fine",),
          _swing, "lambda_M above the limit O9"),
    Claim("tight-1", ("robust",), "the same grip, lambda_M = 1: master at q_h from", "s",
          at_most(12.0), "O9: below the limit", ("tight-1",),
          lambda r: m.time_to_target(r, ["master.q"], Q_H)),
    Claim("single-15ms", ("robust",), "one arm sampled at 15 ms: at q_h from", "s",
          relative(5.8, 0.1), _LADDER.format("15 ms"), ("single-15ms",),
          lambda r: m.time_to_target(r, ["robot.q"], Q_H)),
    Claim("single-25ms", ("robust",), "one arm sampled at 25 ms: diverges at", "s",
          at_most(2.0), _LADDER.format("15 ms"), ("single-25ms",), stopped, "T_s too long", True),
    Claim("pair-15ms", ("robust",), "teleoperator sampled at 15 ms: at q_h from", "s",
          within(11.2, 12.0), "as at 5 ms", ("pair-15ms",),
          lambda r: m.time_to_target(r, ARMS, Q_H)),
    Claim("pair-30ms", ("robust",), "teleoperator sampled at 30 ms: diverges at", "s",
          at_most(3.0), _LADDER.format("20 ms; here 3 of 40 seeds diverge at 20 ms"),
          ("pair-30ms",), stopped, "T_s too long", True),
    Claim("net-6ms", ("robust", "thm4"), "six arms, delays, Gamma = 8, 6 ms: at q_h from", "s",
          within(44.0, 62.0), _LADDER.format("6 ms; 10 seeds here: 52.0 to 56.5 s"), ("net-6ms",),
          lambda r: m.time_to_target(r, SIX, Q_H)),
    Claim("net-15ms", ("robust",), "six arms, delays, Gamma = 8, 15 ms: diverge at", "s",
          at_most(3.0), _LADDER.format("6 ms"), ("net-15ms",), stopped, "T_s too long", True),
    Claim("net-10ms-slow", ("robust",), "six arms, delays, Gamma = 1, 10 ms: at q_h from", "s",
          within(44.5, 56.5), _LADDER.format("10 to 12 ms"), ("net-10ms-slow",),
          lambda r: m.time_to_target(r, SIX, Q_H)),
)  # fmt: skip
