"""Points that are run together, or one after the other in the same place: the rows of one alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.fmi import component
from cosim.loading.files import read_document
from cosim.study import batch, memory
from cosim.study.batch import PLACES
from cosim.study.design import Point
from cosim.study.run_point import StudyRow, StudySetup, run_point, run_points
from tests.system.runs import CONFIG, teleoperation

MASTER, CONTROL = "components.master", "components.master_control"
#: What differs in numbers, in structure, and what cannot be run or does not reach its end.
NUMBERS = [
    "run.seed=3", "run.seed=4", "run.seed =5", "run={step=1e-3, stop=0.3, seed=6}",
    f"{MASTER}.parameters.k_p=25.0", f"{MASTER}.start.q=[0.5, -0.5]",
    f"{MASTER}.start.q_h=[1, 2]", f"{CONTROL}.parameters.K=3.0",
    f"{CONTROL}.parameters.lambda_M=0.5", "links.0.delay.low=0.0", "links.1.initial=[0.5, 1.5]",
    "metrics.holding_torque.window=0.1",
]  # fmt: skip
OTHERS = [
    "run.stop='200 ms'", "run.record.every=7", f"{CONTROL}.period=0.01", f"{MASTER}.fmi='3.0'",
    "links.0.delay={law='constant', delay=0.02}", f"{MASTER}.model='fmus.models.planar2r:Plant'",
    "metrics.effort.of=['slave.tau_e']", f"{MASTER}.preset='other'",
    f"{MASTER}.parameters.k_p=-1.0",
    f"{MASTER}.parameters.substeps=1.5", f"{MASTER}.parameters.none=1", "run.algorithm='jacobi'",
    f"{CONTROL}.parameters.K=9e5", f"{MASTER}.start.q=[1e9, 0]", f"{MASTER}.log=true",
]  # fmt: skip


@cache
def study() -> StudySetup:
    document = teleoperation(stop=0.3)
    for link in document["links"]:
        link["delay"] |= {"low": "30 ms", "high": "120 ms"}
    document["figures"] = {}
    document["metrics"] = read_document(CONFIG)["metrics"] | {
        "end": {"kind": "final", "of": ["slave.q", "master.q"]},
        "heard": {"kind": "rms", "of": ["slave_control.xi_in"]},
    }
    return StudySetup(CONFIG, document, {})


def point(number: int, chosen: Sequence[str]) -> Point:
    return Point(f"{number}", {}, tuple(dict.fromkeys(chosen)))


def rows(found: Sequence[StudyRow]) -> list[str]:
    """As text: NaN is NaN."""
    return [repr(replace(row, wall=0.0)) for row in found]


def expected(points: Sequence[Point]) -> list[str]:
    return rows([run_point(study(), each) for each in points])


CHOSEN = st.lists(
    st.one_of(
        st.lists(st.sampled_from(NUMBERS), max_size=3),
        st.tuples(st.sampled_from(OTHERS)),
    ),
    min_size=1, max_size=9,
)  # fmt: skip


@given(CHOSEN)
@settings(max_examples=12, deadline=None)
def test_rows_are_those_of_points_alone(chosen: list[Sequence[str]]) -> None:
    points = [point(i, each) for i, each in enumerate(chosen)]
    assert rows(run_points(study(), points)) == expected(points)


def test_every_kind_of_point_after_every_other_one() -> None:
    points = [point(i, [each]) for i, each in enumerate([*NUMBERS, *OTHERS, *NUMBERS])]
    assert rows(run_points(study(), points)) == expected(points)
    reasons = [row.reason for row in run_points(study(), points)]
    assert sum(map(bool, reasons)) >= 5
    found = run_points(study(), points)
    assert len({repr(row.measures) for row in found if not row.reason}) > 15


def test_one_that_fails_leaves_the_others_alone() -> None:
    bad = f"{CONTROL}.parameters.K=9e5"
    fails = [i % PLACES == 1 for i in range(3 * PLACES)]  # in the same place, again and again
    points = [point(i, [f"run.seed={i}", *[bad] * f]) for i, f in enumerate(fails)]
    found = run_points(study(), points)
    assert [bool(row.reason) for row in found] == fails
    assert rows(found) == expected(points)


def test_a_run_in_company_is_the_same_as_one_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where rows are kept of some ticks only, and where a plant is not stepped in each."""
    slow = [f"{MASTER}.period=0.01", "components.slave.period=0.01"]
    points = [point(i, each) for i, each in enumerate([slow, *([x] for x in NUMBERS + OTHERS)])]
    found = run_points(study(), points)
    assert not found[0].reason
    monkeypatch.setattr(memory, "can_join", lambda _: False)
    assert rows(found) == expected(points)


def test_engines_run_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """They do: as many as there are places, in one call."""
    groups = []
    record = batch.record_many

    def noted(engines: list, *rest: object) -> list:
        groups.append(len(engines))
        return record(engines, *rest)

    monkeypatch.setattr(batch, "record_many", noted)
    run_points(study(), [point(i, [f"run.seed={i}"]) for i in range(2 * PLACES + 1)])
    assert groups == [PLACES, PLACES, 1]


def test_fmus_of_others_are_made_anew_for_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is known of our own FMUs only is not assumed of others."""
    points = [point(i, [each]) for i, each in enumerate(NUMBERS)]
    wanted = expected(points)
    monkeypatch.setattr("cosim.fmi.alike.CommonInstance.values_address", lambda _: 0)
    monkeypatch.setattr("cosim.fmi.alike.CommonInstance.steps_function", lambda _: 0)
    made, instantiate = [], component.instantiate

    def noted(*given: object) -> object:
        made.append(instantiate(*given))
        return made[-1]

    monkeypatch.setattr(component, "instantiate", noted)
    assert (
        rows(run_points(replace(study(), stable={"effort": 1e9}), points)) == wanted
    )  # another one
    assert len(made) == 4 * len(points)
