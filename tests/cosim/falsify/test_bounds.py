"""Bounds of [falsify]: what any family proposes keeps to them, counted packet by packet."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.simulate import simulate
from cosim.falsify.evaluation import document_of, with_paths
from cosim.falsify.families import Space
from cosim.falsify.paths import Candidate
from cosim.falsify.problem import problem_of
from cosim.falsify.rounds import perform
from cosim.falsify.scenario_text import failing_document, text
from cosim.falsify.search import FAMILIES, Account, Budget, search
from cosim.measure.requirements import of_run
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.study.workers import threads
from tests.cosim.falsify.plants import Document, integrator

H, STOP = 0.1, 30.0
SENT = (0.2, 0.6)  # periods of the two links of the channel


def document(semantics: str, bounds: Document, vary: Document | None = None) -> Document:
    """Two loops whose values travel in one channel, sent with different periods."""
    delay = {"law": "uniform", "low": 0.5, "high": 4.0}
    keys = {"semantics": semantics, **({"depth": 9} if semantics == "queue" else {})}
    parts = {
        name: {"model": "tests.cosim.falsify.plants:Decay", "period": period}
        for name, period in zip(("fast", "slow"), SENT, strict=True)
    }
    return {
        "run": {"step": H, "stop": STOP},
        "components": parts,
        "links": [
            {"from": f"{x}.x", "to": f"{x}.u", "delay": delay, "channel": "air", **keys}
            for x in parts
        ],
        "require": {"small": {"always": "abs(fast.x) < 100"}},
        "falsify": {"links": {"air": bounds}, "vary": vary or {}},
    }  # fmt: skip


def kept(bounds: Document, delays: list[float], period: float, signal: bool) -> Iterator[str]:
    """The first mistake in the delays (s, not a number: lost) of packets one `period` (s) apart.

    Losses are counted on the faster link.
    """
    low, high = bounds.get("delay", (0.5, 4.0))
    rate, row, lost, last = bounds.get("rate", inf), 0, 0, None
    for k, T in enumerate(delays):
        if T != T:
            row, lost = row + 1, lost + 1
            if period == min(SENT) and row > bounds.get("lost", inf):
                yield f"{row} packets in a row are lost"
            if period == min(SENT) and row * period > bounds.get("outage", inf) + 1e-9:
                yield f"everything is lost for {row * period} s"
            continue
        row = 0
        if not low - 1e-6 <= T <= high + 1e-6:
            yield f"a delay of {T} s"
        if last is not None:
            gap, change = (k - last) * period, T - delays[last]
            if abs(change) > rate * gap + 1e-6:
                yield f"from {delays[last]} s to {T} s in {gap} s"
            if not bounds.get("reorder", True) and (change if signal else -change) > gap + 1e-6:
                yield f"one overtakes: {delays[last]} s, {gap} s later {T} s"
        last = k
    may_lose = bounds.get("share", 1.0) if {"lost", "outage", "share"} & set(bounds) else 0.0
    if period == min(SENT) and lost > may_lose * len(delays):
        yield f"{lost} of {len(delays)} are lost"


DELAYS = st.tuples(st.integers(5, 30), st.integers(0, 30)).map(
    lambda x: [x[0] / 10, (x[0] + x[1]) / 10]
)
LOSSES = {
    "lost": st.integers(0, 5),
    "outage": st.sampled_from([0.0, 0.3, 0.6, 2.5]),
    "share": st.sampled_from([0.0, 0.02, 0.2, 1.0]),
}
OTHERS = {"delay": DELAYS, "rate": st.sampled_from([0.05, 0.7, 3.0]), "reorder": st.booleans()}
PACKETS = st.fixed_dictionaries({}, optional=OTHERS | LOSSES)
SIGNALS = st.fixed_dictionaries({}, optional=OTHERS)
CASES = st.one_of(
    st.tuples(st.just("signal"), SIGNALS),
    st.tuples(st.sampled_from(["last-arrival", "newest-stamp", "queue"]), PACKETS),
)


@pytest.mark.parametrize("family", FAMILIES)
@settings(max_examples=25)
@given(case=CASES, seed=st.integers(0, 3))
def test_candidates_of_every_family_keep_to_random_bounds(
    family: str, case: tuple[str, Document], seed: int
) -> None:
    if family == "optimizer" and not importlib.util.find_spec("cma"):
        pytest.skip("needs cma")
    semantics, bounds = case
    with TemporaryDirectory() as folder:
        path = Path(folder) / "case.toml"
        path.write_text(text(document(semantics, bounds)))
        try:
            problem, _ = problem_of(path)
        except ScenarioError as error:
            assert "nothing can move" in str(error)
            return
        plan = assemble(build(document_of(problem, ()), path))
        rounds = FAMILIES[family][0](Space(problem, seed), 0, 12)
        for candidate in islice((c for some in rounds_of(rounds) for c in some), 12):
            links = with_paths(plan, problem, candidate).links
            for link, period in zip(links, SENT, strict=True):
                table = link.table
                n = -(-candidate.ticks // round(period / H))
                delays = table.law.stream(table.grid.sending_period, None).take(n).tolist()
                wrong = list(kept(bounds, delays, period, semantics == "signal"))
                assert not wrong, (candidate.says, wrong)


def rounds_of(rounds: Any) -> Iterator[list[Candidate]]:
    some = next(rounds, None)
    while some:
        yield some
        try:
            some = rounds.send([1.0] * len(some))
        except StopIteration:
            return


#: x[k+1] = x[k] - a x[k - d] is stable for any d from 0 to 8 if a < 0.1728, and for a constant one
#: if a < 0.1845.
LOST = {"semantics": "last-arrival", "delay": {"law": "constant", "delay": 1.0}}


@pytest.mark.parametrize(
    ("a", "link", "family", "mild", "bad"),
    [
        (0.3, LOST, "wave", {"lost": 1}, {"lost": 9}),
        (0.3, LOST, "wave", {"outage": "1 s"}, {"outage": "9 s"}),
        (0.3, LOST, "wave", {"outage": "9 s", "share": "2 %"}, {"outage": "9 s", "share": "90 %"}),
        (0.182, {}, "greedy", {"rate": 0.05}, {"rate": 9.0}),
        (0.182, {}, "greedy", {"reorder": False, "rate": 0.05}, {"reorder": False}),
        (0.3, LOST, "draw", {"like": ["mild.csv"]}, {"like": ["mild.csv", "bad.csv"]}),
    ],
    ids=["lost", "outage", "share", "rate", "order", "like"],
)
def test_each_bound_decides_whether_a_loop_breaks(
    a: float, link: Document, family: str, mild: Document, bad: Document, tmp_path: Path
) -> None:
    for name, longest in (("mild", 2), ("bad", 9)):
        rows = [f"{k},{1 + k % longest}" for k in range(200)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t_send,delay", *rows]))
    for name, bounds in (("mild", mild), ("bad", bad)):
        loop = integrator(a, 8, 300.0)
        loop["links"][0] |= link
        loop["falsify"] = {"links": {"*": bounds}}
        path = tmp_path / f"{name}.toml"
        path.write_text(text(loop))
        problem, _ = problem_of(path)
        steps = search(Space(problem, 0), Budget(60, False, (family,)), Account())
        found = perform(steps, problem, partial(threads, 1), tmp_path / f"{name}.jsonl")
        assert (found is None) == (name == "mild")
    assert found is not None
    alone = build(failing_document(problem, loop, found.candidate, tmp_path), tmp_path / "x.toml")
    with suppress(RunError):
        simulate(alone, tmp_path / "run")
    assert [r.verdict for r in of_run(alone, Run.open(tmp_path / "run"))] == ["failed"]
