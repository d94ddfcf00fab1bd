"""Sec. V and VII-B, Theorems 3 and 4, Figs 6-11: six arms, one of them in the operator's hand.

The paper's graphs are not available. The figures show `ring`; claims are checked on `ring`, `tree3`
and `dense` of :mod:`cosim.graphs.graph`. An independent simulation with another random generator
gave the bands of random results over 8 seeds. The bands here are the range of 200 seeds of this
project, rounded outwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, Expected, at_least, at_most, never, within
from fmus.paper.experiments import DELAY, PERIOD, Q_H, STARTS, THETA, Document, Table, network

K, ALPHA, K_P = 16.0, 1.6, 10.0
PRESETS = ("ring", "tree3", "dense")
DELAYED: Table = {"delay": dict(DELAY)}
SILENT: Table = {
    "delay": dict(DELAY),
    "semantics": "newest-stamp",
    "loss": {"law": "outage", "start": 3.0, "length": 1e6, "every": 2e6},
}
#: Two of the three graphs of `ring`: the chains 1→2→3 and 4→5→6, which nothing joins.
SPLIT: Table = {"schedule": [[0.0, "G1"], [0.15, "G2"]], "repeat": 0.3}
#: All three in turn, a sample each: the mean graph, a ring of weights 1/3.
IN_TURN: Table = {
    "schedule": [[k * PERIOD, f"G{k + 1}"] for k in range(3)],
    "repeat": 3 * PERIOD,
}
KNOWN: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
#: Integration steps of the arms in a period where no figure is drawn: 2.5 ms, for speed.
COARSE = 2
ALL = [f"robot{i}.q" for i in range(1, 7)]
TORQUES = [f"control{i}.tau" for i in range(1, 7)]
TAU_H = "robot3.tau_h"


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` is that of switching and delays."""

    def six(stop: float = 120.0, **options: Any) -> Document:
        return network(stop, **{"seed": seed, "substeps": COARSE, **options})

    runs = {}
    for graphs in PRESETS:
        shown: Table = {"graphs": graphs, "substeps": None if graphs == "ring" else COARSE}
        runs[f"net-10-{graphs}"] = six(torques=True, **shown)
        runs[f"net-0-{graphs}"] = six(lambda_M=0.0, **shown)
        runs[f"net-delay-{graphs}"] = six(link=DELAYED, Gamma=1.0, **shown)
    return runs | {
        "net-0-tree3-other": six(graphs="tree3", lambda_M=0.0, seed=seed + 1),
        "net-0-in-turn": six(lambda_M=0.0, schedule=IN_TURN, **KNOWN),
        "net-free": six(150.0, grip={}),
        "net-free-delay": six(200.0, grip={}, link=DELAYED),
        "net-free-delay-dense": six(150.0, graphs="dense", grip={}, link=DELAYED, Gamma=1.0),
        "net-free-delay-known": six(100.0, grip={}, link=DELAYED, **KNOWN),
        "net-leaf": six(graphs="tree3", operator=5),
        "net-split": six(schedule=SPLIT),
        "net-split-free": six(schedule=SPLIT, grip={}),
        "net-silent-free": six(grip={}, link=SILENT),
        "net-silent": six(link=SILENT),
    }


def _settling(r: Run) -> float:
    return m.time_to_target(r, ALL, Q_H)


def _agreement(r: Run) -> float:
    return m.time_to_agreement(r, ALL)


def _holding(r: Run) -> float:
    """Largest entry of the operator's torque at the end, N.m."""
    return float(np.abs(m.final(r, TAU_H)).max())


def _slope(r: Run) -> float:
    return m.growth(r, TAU_H, ALL, 60.0, 120.0)


# ---- Figs 6-11 ----------------------------------------------------------------------------------

_S = "independent simulation: {}; 200 seeds here: {}"


def _reached(kind: str, graphs: str, about: tuple[str, ...], band: Expected, source: str) -> Claim:
    text = {"10": "no delay", "delay": "delays"}[kind]
    return Claim(
        f"net-{kind}-{graphs}", about, f"{graphs}, {text}: six arms within 0.05 rad of q_h from",
        "s", band, source, (f"net-{kind}-{graphs}",), _settling,
    )  # fmt: skip


_F6, _F8, _F10 = ("fig6", "fig7", "thm3"), ("fig8", "fig9", "thm3"), ("fig10", "fig11", "thm4")
_FIGURES_6_7 = (
    _reached("10", "ring", _F6, within(40.0, 51.5), _S.format("43.5 to 45.4", "41.1 to 50.3")),
    _reached("10", "tree3", _F6, within(19.5, 36.0), _S.format("21.6 to 30.0", "20.4 to 35.0")),
    _reached("10", "dense", _F6, within(31.0, 38.5),
             _S.format("31 to 36, other chords", "31.6 to 37.7")),
    Claim("fig6-rest", _F6, "the hand rests: |tau_h| at 120 s", "N.m", at_most(1e-4),
          "Theorem 3", ("net-10-ring",), lambda r: m.length(m.final(r, TAU_H))),
    Claim("fig6-slope", _F6, "ring: M^t grows: d log M/d log t, 60 to 120 s", "1",
          within(0.55, 0.7), _S.format("0.62", "0.608 to 0.656"), ("net-10-ring",), _slope),
    Claim("thm3-slope-tree3", ("thm3",), "tree3: the same", "1", within(0.5, 0.6),
          _S.format("0.55", "0.540 to 0.565"), ("net-10-tree3",), _slope),
    Claim("thm3-slope-dense", ("thm3",), "dense: the same", "1", within(0.55, 0.62),
          _S.format("0.58", "0.575 to 0.598"), ("net-10-dense",), _slope),
    Claim("fig6-torque", _F6, "ring: largest |tau|", "N.m", within(55.0, 230.0),
          _S.format("up to 190", "61 to 209"), ("net-10-ring",),
          lambda r: m.peak(r, TORQUES)),
    Claim("thm3-torque-tree3", ("thm3",), "tree3: largest |tau|", "N.m", within(28.0, 75.0),
          _S.format("up to 70", "31 to 67"), ("net-10-tree3",), lambda r: m.peak(r, TORQUES)),
    Claim("thm3-torque-dense", ("thm3",), "dense: largest |tau|", "N.m", within(42.0, 130.0),
          _S.format("up to 110", "46 to 120"), ("net-10-dense",), lambda r: m.peak(r, TORQUES)),
)  # fmt: skip

_ZERO, _RING_0 = "lambda_M = 0", ("net-0-ring",)
_REST = oracles.rest_position(STARTS[2], Q_H, K, ALPHA, K_P)
_HOLD = oracles.holding_torque(STARTS[2], Q_H, K, ALPHA, K_P)
_MEAN = oracles.consensus_without_integral(STARTS, 1 / 6, Q_H, K, ALPHA, K_P)


def _off_rest(r: Run) -> float:
    return m.largest_error(m.final(r, "robot3.q"), _REST)


_FIGURES_8_9 = (
    Claim("fig8-agreed", _F8, "lambda_M = 0, ring: within 0.05 rad of each other from", "s",
          within(19.0, 43.0), _S.format("23 to 33", "20.7 to 40.2"), _RING_0, _agreement),
    Claim("fig8-reached", _F8, "but within 0.05 rad of q_h from", "s", never(),
          "Sec. VII-B: they do not converge to q_h", _RING_0, _settling, _ZERO),
    Claim("fig8-error", _F8, "robot 3 is off q_h at 120 s by", "rad", at_least(2.8),
          "independent simulation: 2.8", _RING_0,
          lambda r: m.largest_error(m.final(r, "robot3.q"), Q_H), _ZERO),
    Claim("fig8-held", _F8, "held for ever: largest |tau_h| at 120 s", "N.m",
          within(27.5, 35.5), _S.format("29 to 33", "28.3 to 34.7"), _RING_0, _holding, _ZERO),
    Claim("fig8-slope", _F8, "M^t has stopped growing: slope, 60 to 120 s", "1", at_most(0.15),
          "M^t has a limit", _RING_0, _slope, _ZERO),
    Claim("thm3-0-dense", ("thm3",), "lambda_M = 0, dense: within 0.05 rad of q_h from", "s",
          never(), "Theorem 3 needs lambda_M > 0", ("net-0-dense",), _settling, _ZERO),
    Claim("fig8-mean", ("fig8", "fig9"), "theta known, graphs in turn: rest is off O2 by", "rad",
          at_most(0.005), "O2 of the mean graph: (αq̄(0) + γ(k_p/K)q_h)/(α + γk_p/K), γ = 1/6",
          ("net-0-in-turn",), lambda r: m.largest_error(m.final(r, "robot3.q"), _MEAN)),
    Claim("o7-rest", ("o7", "thm3"), "lambda_M = 0, tree3: robot 3 is off (2.866, 0.0897) by",
          "rad", at_most(0.005), "O7: the root alone obeys O2", ("net-0-tree3",), _off_rest, _ZERO),
    Claim("o7-rest-other", ("o7", "thm3"), "the same with another seed", "rad", at_most(0.005),
          "O7: whatever the others do", ("net-0-tree3-other",), _off_rest, _ZERO),
    Claim("o7-held", ("o7", "thm3"), "tau_h is off (6.34, 29.10) by", "N.m", at_most(0.05), "O7",
          ("net-0-tree3",), lambda r: m.largest_error(m.final(r, TAU_H), _HOLD), _ZERO),
)  # fmt: skip

_FIGURES_10_11 = (
    _reached("delay", "ring", _F10, within(44.5, 56.5), _S.format("46 to 52", "45.6 to 54.7")),
    _reached("delay", "tree3", _F10, within(20.5, 36.5), _S.format("26.9", "21.9 to 34.9")),
    _reached("delay", "dense", _F10, within(34.0, 43.5),
             _S.format("40, other chords", "35.2 to 41.9")),
    Claim("fig10-rest", _F10, "ring, delays: |tau_h| at 120 s", "N.m", at_most(1e-3),
          "Theorem 4", ("net-delay-ring",), lambda r: m.length(m.final(r, TAU_H))),
    Claim("fig10-slope", _F10, "ring, delays: slope of M^t, 60 to 120 s", "1",
          within(0.55, 0.7), "200 seeds here: 0.609 to 0.653", ("net-delay-ring",), _slope),
)  # fmt: skip


# ---- free motion, and what the theorems need ----------------------------------------------------


def _spread(t: float) -> Any:
    def at(r: Run) -> float:
        return float(m.spread(r, ALL)[m.row(r, t)])

    return at


def _moving(r: Run) -> float:
    """The distance that robot 5 still moves in the last 10 s, rad."""
    last = r.array("robot5.q")[m.row(r, r.t[-1] - 10.0) :]
    return float(np.ptp(last, axis=0).max())


def _off(r: Run) -> float:
    """Largest distance of any robot from q_h at the end, rad."""
    return max(m.largest_error(m.final(r, name), Q_H) for name in ALL)


_NO_ROOT, _NO_TREE = "the held robot is no root", "no joint spanning tree"
_SILENCE = "silent from 3 s on: the delays have no bound"
_THEOREMS = (
    Claim("thm3-free", ("thm3",), "free, ring: arms apart at 150 s by", "rad", at_most(0.05),
          "Theorem 3; 40 seeds here: up to 0.008", ("net-free",), _spread(150.0)),
    Claim("thm4-free", ("thm4",), "free, ring, delays, Gamma = 8: arms apart at 200 s by", "rad",
          at_most(0.05), "Theorem 4; 40 seeds here: up to 0.007", ("net-free-delay",),
          _spread(200.0)),
    Claim("thm4-free-dense", ("thm4",), "free, dense, delays, Gamma = 1: apart at 150 s by",
          "rad", at_most(0.05), "Theorem 4; 40 seeds here: up to 0.003",
          ("net-free-delay-dense",), _spread(150.0)),
    Claim("thm4-free-known", ("thm4",), "free, ring, delays, theta known: apart at 100 s by",
          "rad", at_most(0.005), _S.format("3e-4", "up to 0.001 (40 seeds)"),
          ("net-free-delay-known",), _spread(100.0)),
    Claim("necessity", ("necessity", "thm3"), "tree3, robot 5 held: a robot is off q_h by", "rad",
          at_least(3.5), "robot 3 does not hear; independent simulation: 4", ("net-leaf",), _off,
          _NO_ROOT),
    Claim("necessity-motion", ("necessity", "thm3"), "and robot 5 goes on moving by", "rad",
          at_least(0.1), "independent simulation: persistent motion", ("net-leaf",), _moving,
          _NO_ROOT),
    Claim("thm3-split", ("thm3", "necessity"), "ring without G3, held: arms apart by", "rad",
          at_least(1.0), "two chains that nothing joins", ("net-split",), _spread(120.0),
          _NO_TREE),
    Claim("thm3-split-free", ("thm3", "necessity"), "the same, free: arms apart by", "rad",
          at_least(1.0), "two chains that nothing joins", ("net-split-free",), _spread(120.0),
          _NO_TREE),
    Claim("thm4-silent-free", ("thm4",), "free, links silent: arms apart at 120 s by", "rad",
          at_least(0.1), "each goes to the last xi it heard", ("net-silent-free",),
          _spread(120.0), _SILENCE),
    Claim("thm4-silent", ("thm4",), "held, links silent: six arms within 0.05 rad of q_h from",
          "s", never(), "each is held by the last xi it heard", ("net-silent",), _settling,
          _SILENCE),
)  # fmt: skip

CLAIMS = (*_FIGURES_6_7, *_FIGURES_8_9, *_FIGURES_10_11, *_THEOREMS)
