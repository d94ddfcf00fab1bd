"""A network that cosim falsify has found breaks the same requirement wherever the scenario runs.

The twin, and the rehearsal in lock-step, give the same bits. The scenarios are those of
`benchmarks/falsify_cases.py`. The shipped deployments limit torques to 100 N.m, and then a stiff
hand breaks nothing; those of here limit nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim
from benchmarks.falsify_cases import Document, settling, stiff, waves
from cosim.base import toml
from cosim.base.errors import RunError
from cosim.falsify.scenario_text import text

ROOT = Path(__file__).resolve().parents[3]
ZENOH = ROOT / "configs" / "deploy" / "zenoh.toml"
SEED = {"run.seed": 0}
#: Segments of links: (from, to, delay), s; otherwise the delay is 750 ms.
Segments = Sequence[tuple[float, float, float]]


@dataclass(frozen=True)
class Case:
    """A scenario that fails, its deployment, and the name of the requirement that it violates."""

    scenario: Path
    deployment: Path
    requirement: str


def failing(folder: Path, document: Document, segments: Sequence[Segments], stop: float) -> Path:
    """The file of a scenario over this network, as it is in the folder of a search."""
    document["run"]["stop"] = stop
    for requirement in document["require"].values():
        if "after" in requirement:
            requirement["after"] = stop - 1.0
    for link, found in zip(document["links"], segments, strict=True):
        keys = [{"from": a, "to": b, "delay": T} for a, b, T in found]
        link["delay"] = {"law": "segments", "delay": "750 ms", "segments": keys}
    path = folder / "failing.toml"
    path.write_text(text(document))
    return path


def open_deployment(folder: Path, to_slave: str, to_master: str) -> Path:
    """The shipped deployment over Zenoh without guards, settings and ranges; its two signals."""
    shipped = toml.read(ZENOH)
    nodes: dict[str, Any] = {
        name: {"components": node["components"], "number": node["number"]}
        for name, node in shipped["nodes"].items()
    }
    messages = {
        "to_slave": {"bus": "net", "carries": [f"master_control.{to_slave}"]},
        "to_master": {"bus": "net", "carries": [f"slave_control.{to_master}"]},
    }
    kept = {key: shipped[key] for key in ("title", "clock", "latency", "buses")}
    path = folder / "open.toml"
    path.write_text(text({**kept, "nodes": nodes, "messages": messages}))
    return path


@pytest.fixture(params=["stiff", "settling", "waves"])
def case(request: pytest.FixtureRequest, tmp_path: Path) -> Case:
    if request.param == "stiff":
        one_value = [(0.659, 0.664, 0.5)]
        path = failing(tmp_path, stiff(), [[], one_value], 0.9)
        return Case(path, open_deployment(tmp_path, "xi", "xi"), "near")
    if request.param == "waves":
        path = failing(tmp_path, waves(), [[(2.5, 3.5, 0.3)], []], 6.0)
        return Case(path, open_deployment(tmp_path, "u", "v"), "offset")
    there = [(0.5, 1.5, 0.3), (2.4, 3.4, 1.2), (8.4, 9.2, 1.2), (9.4, 10.6, 0.3)]
    path = failing(tmp_path, settling(), [there, [(0.5, 13.5, 1.2)]], 7.0)
    return Case(path, ZENOH, "settled")


def run(make: Any, *args: Any) -> cosim.RunResult:
    """A run, also of one that diverges."""
    try:
        found: cosim.RunResult = make(*map(str, args), set=SEED)
    except RunError as error:
        found = cosim.open(error.saved)
    return found


def test_offline_and_in_the_twin(case, cosim_run, twin):
    """The twin over Zenoh: its network takes no time, and every link has its delay."""
    runs = [run(cosim_run, case.scenario), run(twin, case.scenario, case.deployment)]
    found = [one.requirements[case.requirement] for one in runs]
    assert [x.verdict for x in found] == ["failed", "failed"]
    if case.requirement == "near":
        assert [x.value for x in found] == [-inf, -inf]
        assert found[0].time == pytest.approx(found[1].time, abs=2e-3) and found[0].time < 0.9
    else:
        assert found[0].value == pytest.approx(found[1].value, rel=1e-2)


@pytest.mark.slow
def test_in_lock_step_with_the_bits_of_the_twin(case, twin, rehearsal):
    one = run(twin, case.scenario, case.deployment)
    two = rehearsal(str(case.scenario), str(case.deployment), set=SEED)
    assert not two.passes(case.requirement)
    if case.requirement != "near":
        assert two.is_identical_to(one)
        return
    n = len(one) - 1  # until the tick in which the master diverges; the slave runs to the end
    assert n > 800 and one.signals == two.signals
    for name in one.signals:
        assert np.array_equal(one[name][:n], two[name][:n]), name
    found = [x.requirements["near"] for x in (one, two)]
    assert found[0].time == pytest.approx(found[1].time, abs=2e-3)


@pytest.mark.slow
def test_in_a_rehearsal_on_the_wall_clock(case, rehearsal):
    found = rehearsal(str(case.scenario), str(case.deployment), set=SEED, clock="wall")
    assert found.requirements[case.requirement].verdict == "failed"
