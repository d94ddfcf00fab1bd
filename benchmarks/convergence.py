"""Agreement, ages and bandwidth of large networks: predictions of docs/scale.md beside runs.

    python benchmarks/convergence.py [--robots 100,1000,10000] [--graph "small world"|grid]
                                     [--stop S] [--threads N] [--json FILE]

The network of configs/many.toml without an operator, in a graph laid out by regions: up to
100 robots form one, and samples from another region travel longer. All start at rest, apart from
each other along the slowest mode v of the graph, sum_j (v_i - v_j) = lambda_2 v_i, of length 1, and
with the right estimates of their inertia (wrong ones change p by a term in p²). Then what they
differ by decays as exp(p t), p the root near 0 of

    p + lambda sum_ij v_i (v_i - v_j exp(-p T_ij)) = 0

over all edges (robot i receives from j), with the mean age T_ij of what controller i holds when it
steps, and its gain lambda; without delays p = -lambda lambda_2. It is the slowest root of v'L(p)v,
with L(p) of cosim/predict/network.py. "Measured" is the slope of the logarithm of the differences,
projected on v, over the second half of the run.
"""

from __future__ import annotations

import argparse
import json
import sys
from math import isqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables

ROOT = Path(__file__).resolve().parents[1]
REGION = 100
#: rad, the greatest distance from the mean at the start, and the mean.
APART, MIDDLE = 0.5, (0.7, 0.9)
LAMBDA = 1.0  #: 1/s
#: Of a sample, with the protection of the bridge and the headers of Zenoh, TCP, IP and Ethernet.
BYTES = 110
#: Links whose ages are looked at.
LOOKED_AT = 2000
WITHIN, BETWEEN = ("5 ms", "15 ms"), ("30 ms", "90 ms")
HEADER = ("robots", "λ₂, 1/s", "mean age, ms: expected", "measured", "-p, 1/s: without delays",
          "with", "measured", "leave a region", "Mbit/s between regions", "run, s")  # fmt: skip

Vector = NDArray[np.floating[Any]]
Edges = NDArray[np.int64]


def graph_of(kind: str, robots: int) -> dict[str, Any]:
    """The keys of [graphs.net]; a grid is nearly square."""
    if kind == "grid":
        rows = max(k for k in range(1, isqrt(robots) + 1) if robots % k == 0)
        return {"kind": kind, "rows": rows, "columns": robots // rows}
    return {"kind": kind, "n": robots, "neighbours": 4, "rewire": 0.1}


def slowest(robots: int, edges: Edges) -> tuple[float, Vector]:
    """lambda_2 (for weights of 1) and v (robots,), of length 1."""
    from scipy.sparse import coo_array, identity
    from scipy.sparse.linalg import LinearOperator, eigsh

    adjacent = coo_array((np.ones(len(edges)), edges.T), (robots, robots)).tocsr()
    degrees = adjacent.sum(axis=1)
    top = 2 * degrees.max()
    shifted = (
        identity(robots) * top
        + adjacent
        - coo_array((degrees, (np.arange(robots),) * 2), (robots, robots))
    )  # its greatest eigenvalue is `top`, of the sum; that is taken away
    away = LinearOperator((robots, robots), lambda x: shifted @ x - top * x.mean(), dtype=float)
    values, vectors = eigsh(away, k=1, which="LA", tol=1e-8, maxiter=100_000,
                            v0=np.sin(np.arange(robots) + 1.0))  # fmt: skip
    return float(top - values[0]), vectors[:, 0]


def rate(alone: float, heard: Vector, ages: Vector) -> float:
    """-p of p + alone - sum_k heard_k exp(-p ages_k) = 0, 1/s, by Newton's method."""
    p = 0.0
    for _ in range(20):
        now = heard * np.exp(-p * ages)
        p -= (p + alone - now.sum()) / (1 + (ages * now).sum())
    return -p


def settings(graph: dict[str, Any], regions: int, starts: Path) -> tuple[str, ...]:
    """Settings of configs/many.toml."""

    def law(ends: tuple[str, str]) -> str:
        return f'{{ law = "uniform", low = "{ends[0]}", high = "{ends[1]}", hold = "30 ms" }}'

    return (
        f"graphs.net={{ {', '.join(f'{k} = {json.dumps(v)}' for k, v in graph.items())} }}",
        "components.robot.each={}",
        f"components.control.parameters.lambda={LAMBDA}",
        "components.control.start.theta_hat=[3.34, 1.2, 0.97]",
        f'components.robot.start.q={{ file = "{starts}", columns = ["a", "b"] }}',
        f"links.0.delay={law(WITHIN)}",
        f"links.0.regions={regions}",
        f"links.0.between={{ delay = {law(BETWEEN)} }}",
        "metrics={}",
        "figures={}",
    )


def mean_delay(ends: tuple[str, str]) -> float:
    """s, of a uniform law; a link holds the sample nearest to the time that is asked for."""
    low, high = (float(x.split()[0]) / 1000 for x in ends)
    return (low + high) / 2


def measure(kind: str, robots: int, stop: float, threads: int) -> dict[str, Any]:
    """One row."""
    from cosim.engine.engine import Engine
    from cosim.engine.tables import LinkRows
    from cosim.graphs.named import GraphSpec, graph_edges
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    begin = perf_counter()
    graph, regions = graph_of(kind, robots), max(1, robots // REGION)
    edges = graph_edges(GraphSpec(**graph), ROOT, "graph")[1] - 1  # receiver, sender
    lambda_2, v = slowest(robots, edges)
    region, (i, j) = np.arange(robots) * regions // robots, edges.T
    far = region[i] != region[j]
    leaves = float(far.mean())
    with TemporaryDirectory() as folder:
        starts = Path(folder) / "starts.csv"
        q = np.add.outer(v * APART / np.abs(v).max(), MIDDLE)
        np.savetxt(starts, q, delimiter=",", header="a,b", comments="")
        plan = assemble(load(ROOT / "configs" / "many.toml", settings(graph, regions, starts)))
    h, steps = plan.h, plan.component("control1").period
    every = max(1, len(plan.links) // LOOKED_AT)
    held: list[NDArray[np.int32]] = []

    def look(drawn: LinkRows) -> None:
        held.append(np.array(drawn.parts()[::every]))

    slots = [plan.slots()[f"robot{i}.q"].start for i in range(1, robots + 1)]
    along = []
    with Engine(plan, keep_tables=look, threads=threads) as engine:
        engine.initialize()
        for _ in range(round(stop)):
            engine.run(round(1 / h))
            along.append(float(v @ engine.signals[slots]))
    samples = np.concatenate(held, axis=1)
    looks = np.arange(samples.shape[1])
    age = float((looks - samples)[samples >= 0].mean() * steps * h)
    half = len(along) // 2
    slope = np.polyfit(np.arange(half, len(along)), np.log(np.abs(along[half:])), 1)[0]
    delays = np.array([mean_delay(WITHIN), mean_delay(BETWEEN)])
    heard = LAMBDA * np.bincount(far, v[i] * v[j], minlength=2)
    return {
        "robots": robots,
        "lambda_2": lambda_2,
        "age_expected": float(delays @ [1 - leaves, leaves]),
        "age": age,
        "rate_without_delays": LAMBDA * lambda_2,
        "rate_expected": rate(LAMBDA * float((v[i] ** 2).sum()), heard, delays),
        "rate": -float(slope),
        "leave": leaves,
        "between": leaves * len(edges) / (steps * h) * BYTES * 8 / 1e6,
        "seconds": perf_counter() - begin,
    }


def line(row: dict[str, Any]) -> list[str]:
    """A row of the table."""
    return [
        str(row["robots"]), f"{row['lambda_2']:.4f}",
        f"{1000 * row['age_expected']:.1f}", f"{1000 * row['age']:.1f}",
        f"{row['rate_without_delays']:.4f}", f"{row['rate_expected']:.4f}", f"{row['rate']:.4f}",
        f"{row['leave']:.0%}", f"{row['between']:.3g}", f"{row['seconds']:.0f}",
    ]  # fmt: skip


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robots", default="100,1000,10000")
    parser.add_argument("--graph", choices=("small world", "grid"), default="small world")
    parser.add_argument("--stop", type=float, default=30, help="simulated time, s")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    options = parser.parse_args()
    rows = [
        measure(options.graph, int(n), options.stop, options.threads)
        for n in options.robots.split(",")
    ]
    print(tables.grid(HEADER, [line(row) for row in rows]))
    if options.json:
        facts = {"machine": tables.machine(), "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
