"""Claims that detect a late sample, a wrong delay or a missing limit, exact in sampled time."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.claim import Claim, absolute, at_most, relative, within
from fmus.paper.experiments import (
    PERIOD,
    Q_H,
    STARTS,
    THETA,
    Document,
    network,
    single,
    teleoperator,
)
from fmus.paper.operators import on_mean_graph

K, ALPHA, K_P = 16.0, 2.0, 10.0
KNOWN: dict[str, Any] = {"theta_hat": list(THETA), "Gamma": 0.0}
#: Limit of the torque of each joint, N.m; a delay, s; a velocity so small that M does not change.
LIMIT, LATE, SMALL = (10.0, 5.0), 0.05, (1e-6, -2e-6)
SIX = [f"robot{i}.q" for i in range(1, 7)]


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; nothing in them is random."""
    link = {"delay": {"law": "constant", "delay": LATE}}
    same = {"q": [0.0, 0.0]}
    third: dict[str, Any] = {"lambda": 1 / 3, "lambda_M": 0.0}
    return {
        "limited": single(30.0, tau_max=list(LIMIT)),
        "sampled-decay": single(
            0.5, grip={}, lambda_M=ALPHA, Gamma=0.0, arm_values={"dq": list(SMALL)}
        ),
        "first-motion": _every(
            teleoperator(
                0.2, link=link, grip={}, master={**same, "tau_ext": [1.0, 0.0]}, slave=same
            )
        ),
        "net-0-mean": on_mean_graph(network(200.0, **third, **KNOWN)),
    }


def _every(document: Document) -> Document:
    document["run"]["record"]["every"] = 1
    return document


def _beyond(r: Run) -> float:
    """tau| of each joint is from its limit, N.m.|The difference of the largest |tau| of each joint
    and its limit, N.m.|tau| of each joint is from its limit, N.m.
    """
    return m.largest_error(np.abs(r.array("control.tau")).max(axis=0), LIMIT)


def _wound(r: Run) -> float:
    """Largest step of z or theta_hat after a sample at which the torque was limited."""
    tau = np.abs(r.array("control.tau")[:-2])
    held = (tau >= np.array(LIMIT)).any(axis=1)
    steps = [np.diff(r.array(f"control.{x}")[:-1], axis=0)[held] for x in ("z", "theta_hat")]
    return max(float(np.abs(step).max()) for step in steps)


def _limited(r: Run) -> float:
    """Share of the samples of the first second at which the torque was limited."""
    tau = np.abs(r.array("control.tau")[: m.row(r, 1.0)])
    return float((tau >= np.array(LIMIT)).any(axis=1).mean())


def _decayed(r: Run) -> float:
    """dq(0)|.|Largest error of dq against (I - h M⁻¹K)ⁿ dq(0), as a share of |dq(0)|.|dq(0)|."""
    M = oracles.inertia(THETA, np.zeros((1, 2)))[0]
    step = np.eye(2) - PERIOD * K * np.linalg.inv(M)
    dq = r.array("robot.dq")
    powers = np.array([np.linalg.matrix_power(step, n) @ dq[0] for n in range(len(dq))])
    return m.largest_error(dq, powers) / m.length(dq[0])


def _first(r: Run) -> float:
    """The time at which the slave first moves, s."""
    moving = np.abs(r.array("slave.dq")).max(axis=1) > 0.0
    return float(r.t[int(moving.argmax())]) if moving.any() else inf


_MEAN = oracles.consensus_without_integral(STARTS, 1 / 6, Q_H, K, 1.6, K_P)
_LIMITED = ("limited",)
CLAIMS = (
    Claim("limit-reached", ("sampling", "limit"), "tau_max = (10, 5): largest |tau| off it by",
          "N.m", at_most(0.0), "a limit is a limit", _LIMITED, _beyond),
    Claim("limit-often", ("sampling", "limit"), "share of the first second at a limit", "1",
          within(0.2, 1.0), "the case is of use only where it is met", _LIMITED, _limited),
    Claim("limit-windup", ("sampling", "limit"), "step of z or theta_hat while at a limit", "SI",
          at_most(0.0), "anti-windup: both stand still", _LIMITED, _wound),
    Claim("limit-settled", ("sampling", "limit"), "q within 0.05 rad of q_h from", "s",
          relative(4.37, 0.05), "second simulator: 4.37 s", _LIMITED,
          lambda r: m.time_to_target(r, ["robot.q"], Q_H)),
    Claim("sampled-decay", ("sampling", "o1"), "lambda_M = alpha, no estimate: dq off the power of "
          "I - h M⁻¹K by", "1", at_most(1e-5), "O1 sampled: τ = -K dq held over h",
          ("sampled-decay",), _decayed),
    Claim("first-motion", ("sampling", "thm5"), "T = 50 ms, master pushed at 0: slave moves at",
          "s", absolute(LATE + 3 * PERIOD, PERIOD / 4), "ξ of the first sample after, T, then z, "
          "then τ: T + 3 h", ("first-motion",), _first),
    Claim("net-0-mean", ("sampling", "thm3", "o2"), "lambda_M = 0, theta known, constant mean "
          "graph: off O2 by", "rad", at_most(1e-4), "(αq̄(0) + γ(k_p/K)q_h)/(α + γk_p/K), γ = 1/6",
          ("net-0-mean",), lambda r: max(m.largest_error(m.final(r, x), _MEAN) for x in SIX),
          "lambda_M = 0"),
)  # fmt: skip
