"""One run, in memory: the numbers of `cosim run`, and a row whatever happens."""

from __future__ import annotations

from math import inf, isnan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.engine.simulate import columns, simulate
from cosim.measure.declared_metrics import metrics
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.study import figures
from cosim.study.design import points
from cosim.study.execute import check
from cosim.study.memory import record
from cosim.study.run_point import StudyRow, StudySetup, job, run_point, scenario_of
from cosim.study.study import load_study
from tests.cosim import scenarios
from tests.cosim.study.studies import ROOT, STUDY, written


def row(folder: Path, study: str, **changes: object) -> StudyRow:
    loaded = load_study(written(folder, study))
    return run_point(replace(job(loaded, None), **changes), next(points(loaded)))


def gain(value: float, more: str = "") -> str:
    return STUDY + f"values = [{value}]\n{more}"


def test_the_measures_are_those_of_a_run_folder_to_the_bit(tmp_path: Path) -> None:
    loaded = load_study(ROOT / "configs" / "studies" / "lambda_M_K.toml")
    common, point = job(loaded, None), next(points(loaded))
    point = replace(point, settings=(*point.settings, "run.stop='3 s'"))
    in_memory = run_point(common, point)
    on_disk = run_point(replace(common, keep=tmp_path), point)
    assert not in_memory.reason
    assert in_memory.measures == on_disk.measures
    assert in_memory.measures["sync_error.settle_s"] == inf
    scenario = scenario_of(common, point.settings)
    for metric in metrics(scenario):
        result = metric.evaluate(Run.open(tmp_path / point.run))
        assert in_memory.measures[metric.name] == result.value


@given(ticks=st.integers(1, 400), every=st.integers(1, 50))
def test_memory_holds_the_rows_that_a_recorder_writes(ticks: int, every: int) -> None:
    plan = scenarios.plan(
        {"c": {"model": "Clock"}, "i": {"model": "Integrator", "start": {"u": 1.0}}},
        step=0.5, stop=ticks * 0.5,
    )  # fmt: skip
    found = record(plan, columns(plan), every)
    kept = [k for k in range(ticks) if k % every == 0]
    assert found.t.tolist() == [0.5 * k for k in (*kept, ticks)]
    assert found.array("i.y")[:, 0].tolist() == found.t.tolist()
    assert found.array("c.y")[: len(kept), 0].tolist() == [0.5 * k for k in kept]


def test_long_runs_in_several_chunks_are_the_same_on_disk(tmp_path: Path) -> None:
    scenario = scenarios.scenario(
        {"c": {"model": "Clock"}, "i": {"model": "Integrator", "start": {"u": 1.0}}},
        step=0.001, stop=20.0, record={"every": 7},
    )  # fmt: skip
    plan = assemble(scenario)
    found = record(plan, columns(plan), 7)
    simulate(scenario, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    for name in ("c.y", "i.y"):
        assert np.array_equal(found.array(name), run.array(name))
    assert np.array_equal(found.t, run.t)


def test_a_run_that_diverges_says_when(tmp_path: Path) -> None:
    r = row(tmp_path, gain(1500))
    assert r.reason.startswith("gain: not a finite number: gain.y = ")
    assert 2.5 < r.stopped_at < 3
    assert not r.stable
    assert not r.measures
    assert r.cells == {"gain": 1500}


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        (
            "components.gain.parameters.how=1",
            "gain: ZeroDivisionError: one over nothing (bl",
        ),
        ("components.gain.parameters.how=0.5", "how is an integer, found [0.5]"),
        ("run.stop='1 kg'", "[kg] cannot feed [s] (expected [s])"),
        ("components.gain.model='no:thing'", "cannot import 'no'"),
    ],
)
def test_what_goes_wrong_is_the_reason_of_a_row(tmp_path: Path, setting: str, said: str) -> None:
    r = row(tmp_path, gain(1) + f'[vary.b.cases]\na = ["{setting}"]\n')
    assert said in r.reason
    assert not r.stable
    assert isnan(r.stopped_at) or r.stopped_at == 1.0


@pytest.mark.parametrize(
    ("value", "bounds", "stable"),
    [
        (10, {}, True),
        (205, {}, True),  # grows, but has not left the range of numbers
        (205, {"rest": 1.0}, False),
        (10, {"rest": 1.0, "rest.max": 1.0}, True),
        (10, {"rest.max": 0.5}, False),
        (10, {"rest.settle_s": 1.0}, True),
        (0, {"rest.settle_s": 1.0}, False),
    ],
)
def test_stable_is_what_the_study_says(
    tmp_path: Path, value: float, bounds: dict[str, float], stable: bool
) -> None:
    assert row(tmp_path, gain(value), stable=bounds).stable is stable


CHECKED = [
    (gain(1).replace(".gain.param", ".gian.param"), "(first run: gain = 1): --set"),
    (gain(1).replace("meters.gain", "meters.gani"), "gani"),
    (gain(1, "[vary.how.cases]\na = ['run.seed=1']\nb = ['components.plant.model=x']\n"),
     "study.toml at vary.how (b): "),
    (gain(1, "[stable]\nrest.nothing = 1\n"), "stable: no measure 'rest.nothing'"),
    (gain(1, "[stable]\nrest = 'small'\n"), "at stable.rest: found 'small', expected its max"),
    (gain(1, "[stable]\n'rest.nothing' = 1\n"), "stable: no measure 'rest.nothing'; there are"),
    (gain(1, "[metrics.gain]\nkind = 'peak'\nof = ['plant.y']\n"), "the metric 'gain' has the"),
    (gain(1, "[metrics.rest]\nkind = 'peak'\nof = ['plant.y']\n"), "at metrics.rest: "),
    (gain(1, "[metrics.a]\nkind = 'peak'\nof = ['plant.x']\n"), "no recorded signal 'plant.x'"),
    (gain(1, "[figures.a]\nkind = 'map'\nx = 'gain'\ny = 'gian'\nz = 'rest'\n"),
     "at figures.a.y: no column 'gian'; did you mean 'gain'?"),
    (gain(1, "[figures.a]\nkind = 'line'\nx = 'gain'\ny = 'effort'\n"),
     "at figures.a.y: no column 'effort' (there are: rest, rest.final, "),
]  # fmt: skip


@pytest.mark.parametrize(("study", "said"), CHECKED)
def test_a_study_that_does_not_fit_its_scenario_is_refused(
    tmp_path: Path, study: str, said: str
) -> None:
    with pytest.raises(CosimError) as error:
        loaded = load_study(written(tmp_path, study))
        _, units = check(loaded, job(loaded, None))
        figures.check(loaded, [axis.name for axis in loaded.axes], units)
    assert said in str(error.value)
    assert isinstance(error.value, ScenarioError)


def test_a_job_is_small_and_plain(tmp_path: Path) -> None:
    import pickle

    loaded = load_study(written(tmp_path, gain(1)))
    common: StudySetup = job(loaded, None)
    assert pickle.loads(pickle.dumps(common)) == common
