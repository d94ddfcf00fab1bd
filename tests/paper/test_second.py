"""The engine against a second simulator, on random scenarios.

The scenarios contain lost and late packets, operators that release and grasp again, walls,
projection, torque limits, alpha = 0, Remark 3, and two different arms. Positions agree to 1e-5 rad,
and to 1e-10 without a wall. Walls have no damper here: its force jumps at contact, which reduces
the order of integrators with a fixed step.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.record import Run
from fmus.paper import experiments as e
from fmus.paper.reproduction import open_case, run_case
from tests.paper import second
from tests.tiers import first_fast

H, SAMPLES = 5e-3, 500
AGREE = 1e-5  # rad
ARMS = ((3.34, 1.20, 0.97), (5.33, 1.5, 1.0), (4.2, 1.3, 1.2))
Rng = np.random.Generator


def gains(rng: Rng, coupled: bool) -> dict[str, Any]:
    """Gains of a controller at random, with Remark 3, projection and limits now and then."""
    theta_hat = np.array(ARMS[0]) * rng.uniform(0.8, 1.2)
    drawn: dict[str, Any] = {
        "K": rng.uniform(8, 20, 2), "Gamma": rng.uniform(0.2, 2.0, 3),
        "alpha": float(rng.uniform(0.3, 2.0)), "lambda_M": float(rng.choice([0.0, 1.0, 6.0])),
        "z": rng.uniform(-0.3, 0.3, 2), "theta_hat": theta_hat,
    }  # fmt: skip
    drawn |= {"lambda_": float(rng.uniform(0.5, 2.0))} if coupled else {}
    if rng.random() < 0.3:
        drawn |= {"lambda_c": 5.0}
    if rng.random() < 0.4:
        drawn |= {"theta_min": theta_hat - 0.02, "theta_max": theta_hat + 0.02}
    if rng.random() < 0.3:
        drawn |= {"tau_max": np.array([12.0, 6.0])}
    return drawn


def law(drawn: dict[str, Any]) -> second.Law:
    names = {"lambda_": "coupling", "theta_min": "least", "theta_max": "most"}
    pairs = {names.get(k, k): v for k, v in drawn.items()}
    return second.Law(**{k: tuple(v) if isinstance(v, np.ndarray) else v for k, v in pairs.items()})


def start(drawn: dict[str, Any]) -> dict[str, Any]:
    """As a scenario says it."""
    plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in drawn.items()}
    return {"lambda" if k == "lambda_" else k: v for k, v in plain.items()}


def body(rng: Rng, wall: bool, let_go: tuple[float, float] | None) -> second.Body:
    hand = second.Hand(
        k_p=tuple(rng.uniform(2, 15, 2)), k_d=tuple(rng.uniform(1, 6, 2)),
        q_h=tuple(rng.uniform(-2, 3, 2)),
    )  # fmt: skip
    if let_go:
        first, then = let_go
        hand.holds = lambda t: 0.0 if first - 1e-9 <= t < then - 1e-9 else 1.0
    made = second.Body(
        theta=ARMS[rng.integers(len(ARMS))], q=tuple(rng.uniform(-1, 1, 2)),
        dq=tuple(rng.uniform(-1, 1, 2)), hand=hand, push=tuple(rng.uniform(-2, 2, 2)),
    )  # fmt: skip
    if wall:
        made.k_w, made.q_w = 80.0, float(rng.uniform(-0.5, 0.5))
    return made


def values(made: second.Body) -> dict[str, Any]:
    wall = {"k_w": made.k_w, "b_w": made.b_w, "q_w": made.q_w} if made.k_w else {}
    hand = {"k_p": list(made.hand.k_p), "k_d": list(made.hand.k_d), "q_h": list(made.hand.q_h)}
    return {
        "theta": list(made.theta), "q": list(made.q), "dq": list(made.dq),
        "tau_ext": list(made.push), **hand, **wall,
    }  # fmt: skip


def run(document: e.Document, folder: Path) -> Run:
    """The engine's run of a document, every row recorded."""
    document["run"]["record"]["every"] = 1
    found = open_case("it", folder, run_case("it", document, folder))
    assert isinstance(found, Run), found
    return found


def grasping(document: e.Document, arm: str, let_go: tuple[float, float]) -> None:
    times = [*let_go, *[1e9] * 6]
    hand = {"model": "fmus.models.grasp", "period": H, "start": {"times": times}}
    document["components"]["when"] = hand
    document["components"][arm]["inputs"]["grip"] = "when.grip"


def apart(run: Run, names: list[str], places: list[list[second.Pair]]) -> float:
    """Largest distance of any arm of the two simulators, rad."""
    return max(
        float(np.abs(run.array(f"{name}.q") - np.array(place)).max())
        for name, place in zip(names, places, strict=True)
    )


@pytest.mark.parametrize("seed", first_fast(range(6), 2))
def test_one_arm(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([1, seed])
    let_go = (0.5, 1.2) if seed % 2 else None
    drawn, made = gains(rng, False), body(rng, seed % 3 == 0, let_go)
    drawn |= {"alpha": 0.0} if seed == 5 else {}
    document = e.single(SAMPLES * H, grip={}, **start(drawn))
    document["components"]["robot"]["start"] |= values(made)
    if let_go:
        grasping(document, "robot", let_go)
    found = run(document, tmp_path)
    places = second.simulate([made], [law(drawn)], [], SAMPLES, H)
    assert apart(found, ["robot"], places) < AGREE


@pytest.mark.parametrize("seed", first_fast(range(5), 2))
def test_two_different_arms_over_links_that_lose(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng([2, seed])
    let_go = (0.6, 1.1) if seed % 2 else None
    drawn = gains(rng, True)
    bodies = [body(rng, False, let_go), body(rng, seed % 2 == 0, None)]
    delays = rng.uniform(0.012, 0.25, (2, SAMPLES + 1))
    delays[rng.random(delays.shape) < 0.3] = np.nan
    links = []
    for k, row in enumerate(delays):
        path = tmp_path / f"trace{k}.csv"
        rows = [f"{j * H:.6f},{'' if np.isnan(x) else repr(float(x))}" for j, x in enumerate(row)]
        path.write_text("\n".join(["t_send,delay", *rows]) + "\n")
        trace = {"law": "trace", "file": str(path), "lookup": "index"}
        links.append({"delay": trace, "semantics": "newest-stamp"})
    document = e.teleoperator(
        SAMPLES * H, back=links[0], link=links[1], grip={}, master=values(bodies[0]),
        slave=values(bodies[1]), **start(drawn),
    )  # fmt: skip
    if let_go:
        grasping(document, "master", let_go)
    found = run(document, tmp_path)
    places = second.simulate(bodies, [law(drawn), law(drawn)], delays.tolist(), SAMPLES, H)
    assert apart(found, ["master", "slave"], places) < AGREE
