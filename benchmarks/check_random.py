"""``cosim check`` against runs: random scenarios of many families, what it misses, what it invents.

    python -m benchmarks.check_random [--count N] [--seed S] [--from-start] [--show] [--json FILE]

The families are one arm, pairs, several arms over graphs, torque over links, grips that are too
stiff for the step, gains off the diagonal, springs over delays, and links whose delays vary. Each
scenario is generated from its number and the seed. By default all robots rest where they would come
to rest, each joint moved by 1e-5 rad; with `--from-start` they start anywhere, and a hand pulls one
of them. A run of 80 s tells what is true: it is unstable if it fails, if the speeds of its last
fifth exceed those from 40 s to 56 s, or if a start that is 1000 times nearer to rest leads to
speeds that are not as much less; from a start anywhere, the last quarter counts against the one
before. A *miss* is an unstable run without an error of the check, a *false alarm* a stable run with
one.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from cosim.base.copies import replace

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from cosim.checks import Finding
from cosim.checks.ports import WITHIN
from cosim.checks.preflight import check
from cosim.engine.memory_run import trace
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

Document = dict[str, Any]
#: The parameters of the arm SL91.
TRUE = (3.34, 1.20, 0.97)
#: Angle by which a joint is moved, rad, and the length of a scenario and of the run beside it, s.
SMALL, STOP, LONG = 1e-5, 20.0, 80.0
#: A speed (rad/s) below which growth is looked at for longer: with delays that vary it may end.
SURE = 0.01
#: The share of a start that is nearer to rest; the share of speeds that tells growth then, and
#: speeds (rad/s) from which on it is run.
NEARER, BOUNDED, MOVED = 1e-3, 1e-2, 1e-4
#: Ratio of speeds that tells growth; speeds (rad/s) that a motion from anywhere does not have at
#: last, and that are rest.
RATIO, FAST, FLOOR = 1.3, 1.0, 1e-10


@dataclass(frozen=True)
class RandomScenario:
    """A scenario of a `family`; `arms` are the names of its robots."""

    number: int
    family: str
    document: Document
    arms: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """The result of a scenario: the truth, the findings, and the cost (s of processor time)."""

    number: int
    family: str
    unstable: bool | None
    alarm: bool
    warned: bool
    seconds: float
    settled: bool | None
    said: tuple[str, ...]


# ---- scenarios ----------------------------------------------------------------------------------


def scenario(number: int, seed: int, *, start: bool = False) -> RandomScenario:
    """The scenario of a number; `start`: from anywhere with a hand, else nearly at rest."""
    rng = np.random.default_rng([seed, number, start])
    family = list(FAMILIES)[number % len(FAMILIES)]
    document, arms = FAMILIES[family](rng)
    rest = rng.uniform(-1.5, 1.5, 2)
    held = start or rng.random() < 0.5 or "stiff" in family
    for i, name in enumerate(arms):
        robot = document["components"][name]
        here = rng.uniform(-1.5, 1.5, 2) if start else rest + SMALL * rng.standard_normal(2)
        robot["start"] |= {"q": here.tolist(), "q_h": rest.tolist()}
        if not start:
            robot["start"]["dq"] = (SMALL * rng.standard_normal(2)).tolist()
        if i == 0 and held and "k_p" not in robot["parameters"]:
            robot["parameters"] |= {"k_p": log(rng, 2, 40), "k_d": log(rng, 1, 10)}
    return RandomScenario(number, family, document, tuple(arms))


def log(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two others, evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def constant(delay: float) -> Document:
    """A constant delay, s."""
    return {"law": "constant", "delay": round(delay, 6)}


def arm(torque: str, substeps: int = 0) -> Document:
    """A planar arm."""
    inputs = {"tau": torque} if torque else {}
    return {
        "model": "fmus.models.planar2r",
        "parameters": {},
        "start": {"substeps": substeps} if substeps else {},
        "inputs": inputs,
    }


def law(
    rng: np.random.Generator, name: str, period: float, neighbours: int, **gains: Any
) -> Document:
    """The adaptive controller of the paper for the arm `name`; `gains` in place of drawn ones."""
    drawn = {
        "K": log(rng, 4, 40), "Gamma": float(rng.choice([0.0, 1.0])), "alpha": log(rng, 0.2, 4),
        "lambda_M": log(rng, 0.3, 30),
    }  # fmt: skip
    if neighbours:
        drawn["lambda"] = log(rng, 0.5, 40)
    estimate = list(TRUE) if rng.random() < 0.5 else [0.0, 0.0, 0.0]
    return {
        "model": f"fmus.models.{'teleoperation' if neighbours else 'adaptive'}",
        "period": period,
        "parameters": drawn | gains,
        "start": {"theta_hat": gains.pop("theta_hat", estimate)},
        "inputs": {"q": f"{name}.q", "dq": f"{name}.dq"},
    } | ({"sizes": {"neighbours": neighbours}} if neighbours > 1 else {})


def base(
    period: float, components: Document, links: list[Document] | None = None, step: float = 0.0
) -> Document:
    """A scenario whose arms step with the controllers, in substeps of 2 ms, or by `step`, s."""
    for component in components.values():
        if component["model"].endswith("planar2r") and not step:
            component["start"].setdefault("substeps", int(np.ceil(period / 2e-3)))
    run = {"step": step or period, "stop": STOP}
    return {"run": run, "components": components, "links": links or []}


def one(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """One arm at periods of 2 to 40 ms."""
    T = float(rng.choice([5, 10, 20, 32, 40])) * 1e-3
    return base(T, {"a": arm("c.tau"), "c": law(rng, "a", T, 0, K=log(rng, 4, 80))}), ["a"]


def off(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """One arm whose gain is not diagonal."""
    T = float(rng.choice([10, 20, 25, 32])) * 1e-3
    K = log(rng, 4, 40)
    control = law(rng, "a", T, 0, K=K, K_off=float(rng.uniform(-0.95, 0.95)) * K)
    return base(T, {"a": arm("c.tau"), "c": control}), ["a"]


def late(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """One arm whose torque, or whose motion, comes over a link."""
    T = float(rng.choice([1, 2, 5])) * 1e-3
    robot, control = arm("c.tau"), law(rng, "a", T, 0)
    delay, links = constant(log(rng, 2e-3, 100e-3)), []
    if rng.random() < 0.5:
        robot["inputs"] = {}
        links = [{"from": "c.tau", "to": "a.tau", "delay": delay}]
    else:
        control["inputs"] = {}
        links = [{"from": f"a.{x}", "to": f"c.{x}", "delay": delay} for x in ("q", "dq")]
    return base(T, {"a": robot, "c": control}, links, 1e-3), ["a"]


def together(
    rng: np.random.Generator, T: float, edges: list[tuple[int, int]], delay: Callable[[], Document],
    **gains: Any,
) -> tuple[Document, list[str]]:  # fmt: skip
    """Arms of one law over a graph of (from, to); `gains` of all of them."""
    n = max(max(e) for e in edges) + 1
    same = law(rng, "x", T, 1)
    components: Document = {}
    links = []
    for i in range(n):
        heard = [j for j, k in edges if k == i]
        components[f"r{i}"] = arm(f"c{i}.tau")
        control = law(rng, f"r{i}", T, max(1, len(heard)))
        control["parameters"], control["start"] = same["parameters"] | gains, dict(same["start"])
        if not heard:
            control["start"] |= {"w": 0.0, "xi_in": 0.0}
        components[f"c{i}"] = control
        for row, j in enumerate(heard):
            links.append({"from": f"c{j}.xi", "to": f"c{i}.xi_in[{row}]", "delay": delay()})
    return base(T, components, links), [f"r{i}" for i in range(n)]


def pair(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """Two arms, another delay each way."""
    T = float(rng.choice([5, 8, 16])) * 1e-3
    return together(rng, T, [(0, 1), (1, 0)], lambda: constant(log(rng, T, 1.0)),
                    **{"lambda": log(rng, 4, 200)})  # fmt: skip


def strong(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """All to all with a coupling up to twice what the period allows."""
    n, T = int(rng.integers(2, 8)), float(rng.choice([2, 5, 10])) * 1e-3
    edges = [(i, j) for i in range(n) for j in range(n) if i != j]
    weight = log(rng, 0.1, 4.0) / (T * (n - 1))
    return together(rng, T, edges, lambda: constant(T), **{"lambda": weight})


def graph(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """Three to eight arms over a tree from the first one, and more edges."""
    n, T = int(rng.integers(3, 9)), float(rng.choice([5, 8, 16])) * 1e-3
    edges = {(int(rng.integers(0, i)), i) for i in range(1, n)}
    while len(edges) < n + int(rng.integers(0, 4)):
        i, j = rng.integers(0, n, 2).tolist()
        if i != j:
            edges.add((i, j))
    delay = log(rng, T, 0.5)
    return together(rng, T, sorted(edges), lambda: constant(delay * rng.uniform(0.5, 1.5)),
                    **{"lambda": log(rng, 4, 200)})  # fmt: skip


def varying(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """Two arms over a network whose delays vary."""
    T = 5e-3
    low = log(rng, 5e-3, 0.5)
    spread = {"law": "uniform", "low": low, "high": low * rng.uniform(1.1, 3.0), "hold": 0.03}
    return together(rng, T, [(0, 1), (1, 0)], lambda: spread, **{"lambda": log(rng, 1, 80)})


def fast(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """One arm with lambda_M up to what a period of 5 ms allows, and beyond."""
    T = 5e-3
    return base(T, {"a": arm("c.tau"), "c": law(rng, "a", T, 0, lambda_M=log(rng, 60, 1000))}), [
        "a"
    ]


def stiff(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """One arm with a grip that may be too stiff for its steps of 5 to 20 ms."""
    T = float(rng.choice([5, 10, 20])) * 1e-3
    robot = arm("c.tau", int(rng.integers(1, 4)))
    robot["parameters"] = {"k_p": log(rng, 30, 1e5), "k_d": log(rng, 1, 1000)}
    return base(T, {"a": robot, "c": law(rng, "a", T, 0)}), ["a"]


def springs(rng: np.random.Generator) -> tuple[Document, list[str]]:
    """Two arms coupled by springs, with damping to the ground or between them."""
    T = float(rng.choice([2, 5, 10])) * 1e-3
    model = str(rng.choice(["pd", "p_d"]))
    gains = {"pd": {"K_p": log(rng, 4, 60), "K_d": log(rng, 1, 20)},
             "p_d": {"K": log(rng, 4, 60), "B": log(rng, 0.5, 15)}}[model]  # fmt: skip
    components: Document = {}
    links = []
    delay = log(rng, T, 1.0)
    for me, other in (("a", "b"), ("b", "a")):
        components[me] = arm(f"{me}_c.tau")
        components[f"{me}_c"] = {
            "model": f"fmus.models.{model}", "period": T, "parameters": gains,
            "inputs": {"q": f"{me}.q", "dq": f"{me}.dq"},
        }  # fmt: skip
        for signal in ("q", "dq") if model == "pd" else ("q",):
            links.append({"from": f"{other}.{signal}", "to": f"{me}_c.{signal}_j",
                          "delay": constant(delay)})  # fmt: skip
    return base(T, components, links), ["a", "b"]


FAMILIES: dict[str, Callable[[np.random.Generator], tuple[Document, list[str]]]] = {
    "one arm": one,
    "pair": pair,
    "over links": late,
    "graph": graph,
    "all to all": strong,
    "off-diagonal": off,
    "stiff grip": stiff,
    "springs": springs,
    "varying": varying,
    "fast lambda_M": fast,
}


# ---- what is true, and what is said -------------------------------------------------------------


def speeds(found: RandomScenario, stop: float) -> tuple[np.ndarray[Any, Any], bool]:
    """The greatest speed of all joints over a run, (n,) rad/s, and whether it reached its end."""
    document = found.document | {"run": found.document["run"] | {"stop": stop}}
    plan = assemble(build(document, Path("random.toml")))
    run = trace(plan, [f"{name}.dq" for name in found.arms], max(1, plan.ticks // 8000))
    v = np.abs(np.hstack([run.columns[f"{name}.dq"] for name in found.arms])).max(axis=1)
    return v, not run.stopped


def unstable_at_rest(found: RandomScenario) -> bool | None:
    """True if a small motion grows, also one that is bounded later; None if a run does not tell."""
    v, whole = speeds(found, stop := LONG)
    grows = _grows(v) if whole else True
    if grows and whole and v.max() < SURE:
        v, whole = speeds(found, stop := 8 * LONG)
        grows = _grows(v) if whole else True
    if grows or v.max() <= MOVED:
        return grows
    smaller, whole = speeds(nearer(found), stop)
    bounded = not whole or _grows(smaller) or smaller.max() > BOUNDED * v.max()
    return True if bounded else grows


def _grows(v: np.ndarray[Any, Any]) -> bool | None:
    n = len(v)
    before, last = v[n // 2 : 7 * n // 10].max(), v[-n // 5 :].max()
    if last > RATIO * before and last > FLOOR:
        return True
    return False if last < before or last < FLOOR else None


def nearer(found: RandomScenario) -> RandomScenario:
    """The same scenario, nearer to rest."""
    document = deepcopy(found.document)
    for name in found.arms:
        start = document["components"][name]["start"]
        q, place = np.array(start["q"]), np.array(start["q_h"])
        start |= {"q": (place + NEARER * (q - place)).tolist()}
        start |= {"dq": (NEARER * np.array(start["dq"])).tolist()}
    return replace(found, document=document)


def unstable_from_start(found: RandomScenario) -> bool | None:
    """True if the run fails, or moves on and on."""
    for stop in (60.0, 2 * LONG):
        v, whole = speeds(found, stop)
        if not whole:
            return True
        n = len(v)
        last, before = v[3 * n // 4 :], v[n // 2 : 3 * n // 4]
        decays = np.sqrt((last**2).mean()) < 0.9 * np.sqrt((before**2).mean())
        if last.max() < 1e-3 or (decays and last.max() < FAST):
            return False
    return True


#: Rules whose errors say that the loop is unstable.
ALARMS = {"run", "poles"}


def outcome(found: RandomScenario, *, start: bool) -> Outcome:
    """The check of a scenario, next to its run."""
    document = found.document
    if start:
        document = document | {"run": document["run"] | {"stop": 60.0}}
    built = build(document, Path("random.toml"))
    before = process_time()
    said = check(built, assemble(built))
    seconds = process_time() - before
    true = unstable_from_start(found) if start else unstable_at_rest(found)
    alarms = [f for f in said if f.severity == "error" and f.rule in ALARMS]
    warned = [f for f in said if f.severity != "note"]
    settled = settles_as_stated(found, said) if start and true is False else None
    return Outcome(
        found.number, found.family, true, bool(alarms), bool(warned), seconds, settled,
        tuple(line(f) for f in warned),
    )  # fmt: skip


def settles_as_stated(found: RandomScenario, said: tuple[Finding, ...]) -> bool | None:
    """True if the time to settle with another seed is in the interval that the check states."""
    stated = [f for f in said if f.rule == "settling" and np.isfinite(f.number)]
    if not stated:
        return None
    low = high = stated[0].number
    other = re.search(r"from ([\d.]+) to ([\d.]+) s on with", stated[0].reason)
    if other:
        low, high = float(other[1]), float(other[2])
    document = found.document | {"run": found.document["run"] | {"stop": 60.0, "seed": 1}}
    run = trace(assemble(build(document, Path("random.toml"))), [f"{found.arms[0]}.q"])
    place = document["components"][found.arms[0]]["start"]["q_h"]
    away = np.abs(run.columns[f"{found.arms[0]}.q"] - place).max(axis=1) > WITHIN
    time = run.t[int(np.flatnonzero(away)[-1])] if away.any() else 0.0
    return bool(0.98 * low - 0.05 <= time <= 1.02 * high + 0.05)


def line(finding: Finding) -> str:
    """A finding in one line."""
    return finding.line[:300]


def outcomes(numbers: range, seed: int, *, start: bool) -> Iterator[Outcome]:
    """All of them, in order."""
    for number in numbers:
        yield outcome(scenario(number, seed, start=start), start=start)


def main() -> None:
    """Check and run them, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first scenario")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--from-start", action="store_true")
    parser.add_argument("--show", action="store_true", help="print what is missed or invented")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found, numbers = [], range(options.first, options.first + options.count)
    for one in outcomes(numbers, options.seed, start=options.from_start):
        found.append(one)
        wrong = one.unstable is not None and one.unstable != one.alarm
        if options.show and wrong:
            kind = "missed" if one.unstable else "invented"
            print(f"{kind}: {one.number} {one.family}: {one.said}", flush=True)
    print_table(found)
    if options.json:
        options.json.write_text(json.dumps([vars(o) for o in found]), "utf-8")


def print_table(found: list[Outcome]) -> None:
    """The counts by family."""
    print("| family | scenarios | unstable | missed | false alarms | good and warned | not told |")
    print("|---|---|---|---|---|---|---|")
    rows = Counter[tuple[str, str]]()
    for o in found:
        for family in (o.family, "all"):
            rows[family, "n"] += 1
            rows[family, "unstable"] += o.unstable is True
            rows[family, "missed"] += o.unstable is True and not o.alarm
            rows[family, "false"] += o.unstable is False and o.alarm
            rows[family, "warned"] += o.unstable is False and o.warned and not o.alarm
            rows[family, "none"] += o.unstable is None
    for family in [*FAMILIES, "all"]:
        cells = [
            str(rows[family, k]) for k in ("n", "unstable", "missed", "false", "warned", "none")
        ]
        print(f"| {family} | {' | '.join(cells)} |")
    good = [o for o in found if o.seconds]
    timed = [o.settled for o in found if o.settled is not None]
    if timed:
        print(f"\nsettles in the interval that is stated: {sum(timed)} of {len(timed)}")
    print(f"\nmedian of the check: {np.median([o.seconds for o in good]) * 1e3:.0f} ms")


if __name__ == "__main__":
    main()
