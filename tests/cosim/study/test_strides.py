"""Ticks that are run as one: how many, and the rows of ``cosim run``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from cosim.base.copies import replace
from cosim.engine import batch
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.study.design import Point
from cosim.study.run_point import StudyRow, StudySetup, run_points
from tests.system.runs import CONFIG, teleoperation

EVERY = "run.record.every="
ARM = "components.slave"
#: What leaves the range of numbers: an arm, the first arm after the other one, a controller.
WRONG = [
    *[[f"{ARM}.start.dq=[{dq}, 0.0]"] for dq in (3e3, 1e4, 1e7)],
    ["components.master.start.dq=[1e4, 0.0]", f"{ARM}.start.dq=[1e7, 0.0]"],
    ["components.master.start.dq=[1e7, 0.0]", f"{ARM}.start.dq=[1e4, 0.0]"],
    ["components.master_control.parameters.K=9e5"],
]
#: Two arms that fail, of which the second one is stepped in another call.
WRONG += [[*each, "components.master.fmi='3.0'"] for each in WRONG[3:5]]
CONTROLS = ("components.master_control", "components.slave_control")
SLOW = [f"{name}.{what}" for name in CONTROLS for what in ("period='70 ms'", "parameters.K=0.1")]
SLOW += [f"links.{i}.delay.low='110 ms'" for i in range(2)]  # no link without delay

#: A sampled component with a step in each tick, which comes before what is recorded.
ALONE = "components.alone={model='fmus.models.teleoperation', period='1 ms', sizes={neighbours=0}}"


def study(keep: Path | None = None) -> StudySetup:
    document = teleoperation(stop=0.303)
    for link in document["links"]:
        link["delay"] |= {"low": "30 ms", "high": "120 ms"}
    document["figures"], document["require"] = {}, {}
    document["metrics"] = {
        f"{kind} {of}": {"kind": kind, "of": [of]}
        for kind in ("rms", "final")
        for of in ("slave.q", "master.dq", "master.tau_h", "master_control.tau")
    }
    return StudySetup(CONFIG, document, {}, keep)


def rows(found: Sequence[StudyRow]) -> list[str]:
    """As text: NaN is NaN."""
    return [repr(replace(row, wall=0.0)) for row in found]


@pytest.fixture
def strides(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    found: list[int] = []
    stride = batch.stride
    monkeypatch.setattr(batch, "stride", lambda bound: found.append(stride(bound)) or found[-1])
    return found


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ([EVERY + "5"], 5),
        ([EVERY + "10"], 5),
        ([EVERY + "1"], 1),
        ([EVERY + "7"], 1),
        ([EVERY + "6", "components.master_control.period='4 ms'"], 1),
        ([EVERY + "8", *[f"{name}.period='4 ms'" for name in CONTROLS]], 4),
        ([EVERY + "70", *SLOW], 70),
        ([EVERY + "5", "run.algorithm='jacobi'"], 1),
        ([EVERY + "5", "run.algorithm='gauss-seidel'"], 1),
        ([EVERY + "5", "components.slave_control.period='1 ms'"], 1),
        ([EVERY + "10", f"{ARM}.period='2 ms'"], 1),
        ([EVERY + "5", f"{ARM}.inputs.q_h='master.q'"], 1),
        ([EVERY + "5", "components.master.period='5 ms'"], 1),
        ([EVERY + "5", ALONE], 1),
    ],
)
def test_the_rows_of_a_run(
    tmp_path: Path, strides: list[int], settings: list[str], expected: int
) -> None:
    points = [Point(f"{i}", {}, (*settings, f"run.seed={i}")) for i in range(3)]
    found = run_points(study(), points)
    assert rows(found) == rows(run_points(study(tmp_path), points))
    assert not any(row.reason for row in found)
    assert set(strides) == {expected}


def test_what_fails_does_so_in_its_tick(tmp_path: Path, strides: list[int]) -> None:
    """A run fails in the same tick, whichever runs are stepped with it; the others go on."""
    chosen = [*WRONG, [f"{ARM}.start.q=[0.0, 1.0]"]]
    points = [Point(f"{i}", {}, (EVERY + "5", *each)) for i, each in enumerate(chosen)]
    found = run_points(study(), points)
    assert rows(found) == rows(run_points(study(tmp_path), points))
    assert [bool(row.reason) for row in found] == [True] * len(WRONG) + [False]
    first = [row.reason.partition(":")[0] for row in found]
    assert first[3:5] == first[6:8] == ["slave", "master"]
    ticks = {round(row.stopped_at * 1000) for row in found if row.reason}
    assert len({tick % 5 for tick in ticks}) > 1 and max(ticks) > 5
    assert 5 in strides


def test_values_of_an_fmu_with_others_between_them(tmp_path: Path) -> None:
    """An arm whose gains are observed beside its outputs: such values are moved one by one."""
    observed = study()
    metrics = {
        "gain": {"kind": "final", "of": ["master.k_p[0]"]},
        "parameter": {"kind": "final", "of": ["master.theta[2]"]},
    }
    document = {**observed.document, "metrics": {**observed.document["metrics"], **metrics}}
    points = [Point(f"{i}", {}, (EVERY + "5", f"run.seed={i}")) for i in range(2)]
    found = run_points(replace(observed, document=document), points)
    kept = run_points(replace(observed, document=document, keep=tmp_path), points)
    assert rows(found) == rows(kept)
    theta = assemble(build(document, CONFIG)).component("master").values["theta"]
    for row, alone in zip(found, run_points(observed, points), strict=True):
        assert (row.measures["gain"], row.measures["parameter"]) == (10.0, theta[2])
        assert alone.measures.items() <= row.measures.items()
