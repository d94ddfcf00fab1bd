"""Inputs over time (tables, points, events), and variables of FMUs that are no outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.engine.simulate import columns
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.cosim.fmi.exporter import export, strict2, strict3
from tests.cosim.scenarios import document

H, STEPS = 0.25, 8
HOLD = {"model": "Gain"}


def rows_of(
    components: Mapping[str, Any], names: tuple[str, ...], folder: Path = Path(), **more: Any
) -> dict[str, list[float]]:
    """Signals by name at each tick, and at the end."""
    plan = assemble(build(document(components, step=H, **more), folder / "test.toml"))
    record = np.zeros((plan.ticks + 1, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        engine.run(3, record)  # the values do not depend on the chunks
        engine.run(plan.ticks - 3, record[3:])
        record[-1] = engine.signals
    slots = plan.slots()
    return {n: record[:, slots[n].start].tolist() for n in names}


def fed(given: Any, folder: Path = Path(), **more: Any) -> list[float]:
    """What an input gets in eight ticks of 0.25 s."""
    components = {"plant": {**HOLD, "inputs": {"u": given}} if given else HOLD}
    return rows_of(components, ("plant.u",), folder, **more)["plant.u"][:STEPS]


# ---- tables and points ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, [1, 1, 3, 3, 3, 3, 0, 0]),
        ({"interpolate": "linear"}, [1, 2, 3, 2.25, 1.5, 0.75, 0, 0]),
        ({"gain": 2.0, "offset": 1.0}, [3, 3, 7, 7, 7, 7, 1, 1]),
    ],
)
def test_points_are_held_or_joined_by_lines(more: dict[str, Any], expected: list[float]) -> None:
    assert fed({"points": [[0, 1], ["500 ms", 3], [1.5, 0]], **more}) == expected


def test_before_the_first_point_its_value_holds() -> None:
    points = {"points": [[1.0, 4.0], [1.5, 5.0]], "interpolate": "linear"}
    assert fed(points) == [4, 4, 4, 4, 4, 4.5, 5, 5]


def test_a_column_of_a_file_feeds_an_input(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("time,u,other\n0,1,9\n0.5,3,9\n1.5,0,9\n")
    assert fed({"table": "u.csv"}, tmp_path) == [1, 1, 3, 3, 3, 3, 0, 0]
    assert fed({"table": "u.csv", "column": "other"}, tmp_path) == [9] * STEPS


def test_the_columns_of_a_file_have_units(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    fields = [pa.field("t", pa.float64()), pa.field("a", pa.float64(), metadata={"unit": "deg"})]
    table = pa.table([[0.0, 1.0], [180.0, 90.0]], schema=pa.schema(fields))
    pq.write_table(table, tmp_path / "a.parquet")
    arm = {
        "model": "fmus.models.planar2r",
        "inputs": {"q_h[0]": {"table": "a.parquet", "column": "a"}},
    }
    found = rows_of({"arm": arm}, ("arm.q_h",), tmp_path)["arm.q_h"]
    assert found[:6] == pytest.approx([np.pi] * 5 + [np.pi / 2])  # a row has the inputs used last
    with pytest.raises(
        ScenarioError, match=r"a of .*a.parquet is in \[deg\], arm.tau\[0\] expects"
    ):
        rows_of({"arm": {**arm, "inputs": {"tau[0]": arm["inputs"]["q_h[0]"]}}}, (), tmp_path)


# ---- events --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ([{"at": 0.5, "set": {"plant.u": 2}}], [0, 0, 2, 2, 2, 2, 2, 2]),
        ([{"at": 0.4, "set": {"plant.u": 2}}], [0, 0, 2, 2, 2, 2, 2, 2]),
        ([{"at": 0.5, "over": 1, "set": {"plant.u": 2}}], [0, 0, 0, 0.5, 1, 1.5, 2, 2]),
        ([{"at": 0.5, "for": "500 ms", "set": {"plant.u": 2}}], [0, 0, 2, 2, 0, 0, 0, 0]),
        (
            [{"at": 0.25, "for": 0.75, "over": 0.5, "set": {"plant.u": 2}}],
            [0, 0, 1, 2, 2, 1, 0, 0],
        ),
        (
            [{"at": 1.0, "set": {"plant.u": 3}}, {"at": 0.5, "set": {"plant.u": 2}}],
            [0, 0, 2, 2, 3, 3, 3, 3],
        ),
        (  # one begins when the other is over: 0.1 + 0.2 > 0.3, by rounding
            [{"at": 0.1, "over": 0.2, "set": {"plant.u": 2}}, {"at": 0.3, "set": {"plant.u": 4}}],
            [0, 1.5, 4, 4, 4, 4, 4, 4],
        ),
    ],
)
def test_events_change_an_input(events: list[dict[str, Any]], expected: list[float]) -> None:
    assert fed(None, extra={"events": events}) == expected


def test_an_event_starts_from_the_start_value_and_its_component_may_be_slow() -> None:
    plant = {**HOLD, "start": {"u": 5.0}, "period": 0.5}
    events = [{"at": 0.75, "set": {"plant.u": 7.0}}]
    found = rows_of({"plant": plant}, ("plant.u",), extra={"events": events})["plant.u"]
    assert found[:STEPS] == [5, 5, 5, 5, 7, 7, 7, 7]  # read at 0, 0.5, 1.0 s ...


@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(-5, 5), st.integers(0, 3)), max_size=5),
    st.integers(1, 3),
    st.lists(st.integers(1, 9), min_size=1, max_size=6),
)
def test_values_do_not_depend_on_chunks_and_follow_the_events(
    given_: list[tuple[int, int, int]], period: int, chunks: list[int]
) -> None:
    events, at = [], 0
    for gap, value, over in given_:
        at += gap
        events.append({"at": 0.1 * at, "set": {"plant.u": value}, "over": 0.1 * over})
        at += over
    components = {"plant": {**HOLD, "period": 0.1 * period}}
    text = document(components, step=0.1, stop=6.0, extra={"events": events})
    players = assemble(build(text, Path("test.toml"))).players
    if not events:
        assert not players
        return
    stream = players[0].source.stream()
    found = np.concatenate([stream.rows(n) for n in chunks])
    for k, value in enumerate(found):
        assert value == pytest.approx(_expected(events, 0.1 * k * period), abs=1e-9)


def _expected(events: list[dict[str, Any]], t: float) -> float:
    """The value at `t`, event after event, in the simplest way."""
    now = 0.0
    for event in events:
        target, over = event["set"]["plant.u"], event["over"]
        if t < event["at"] - 1e-9:
            return now
        if t < event["at"] + over - 1e-9:
            return now + (target - now) * (t - event["at"]) / over
        now = target
    return now


# ---- variables of FMUs ---------------------------------------------------------------------------


@pytest.fixture
def fmu(tmp_path: Path) -> Callable[[str], Path]:
    texts = {"2.0": strict2(), "3.0": strict3(), "3.0 events": strict3('hasEventMode="true"')}
    return lambda fmi: export(texts[fmi], tmp_path / "x.fmu")


ALL = pytest.mark.parametrize("fmi", ["2.0", "3.0", "3.0 events"])


@ALL
@pytest.mark.parametrize("isolate", [False, True])
def test_a_tunable_parameter_changes_while_the_fmu_runs(
    fmu, fmi: str, isolate: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = tmp_path / "calls"
    monkeypatch.setenv("STRICT_CALLS", str(calls))
    x = {
        "model": str(fmu(fmi)),
        "parameters": {"rate": 4.0},
        "start": {"u": 0.0},
        "isolate": isolate,
    }
    events = [{"at": 0.5, "set": {"x.rate": 8.0}, "for": 0.25}]
    found = rows_of({"x": x}, ("x.y", "x.rate"), extra={"events": events})
    assert found["x.rate"][:STEPS] == [4, 4, 4, 8, 4, 4, 4, 4]  # a row has the inputs used last
    assert np.diff(found["x.y"]).tolist() == [1, 1, 2, 1, 1, 1, 1, 1]
    assert "ILLEGAL" not in calls.read_text()


@ALL
@pytest.mark.parametrize("isolate", [False, True])
def test_any_variable_is_recorded_and_wired(
    fmu, fmi: str, isolate: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = tmp_path / "calls"
    monkeypatch.setenv("STRICT_CALLS", str(calls))
    x = {
        "model": str(fmu(fmi)),
        "parameters": {"gain": 3.0},
        "start": {"u": 4.0},
        "isolate": isolate,
    }
    follower = {**HOLD, "inputs": {"u": "x.x"}}
    names = ("x.x", "x.y", "x.gain", "follower.u")
    found = rows_of({"x": x, "follower": follower}, names, record={"signals": ["x.gain", "x.x"]})
    assert found["x.x"] == found["x.y"] == [1.0 + 3 * k for k in range(9)]
    assert found["follower.u"][:STEPS] == found["x.x"][:STEPS]
    assert found["x.gain"] == [3.0] * 9
    assert "ILLEGAL" not in calls.read_text()


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        (["x.*"], {"x.gain", "x.how", "x.rate", "x.status", "x.u", "x.when", "x.x", "x.y"}),
        (["x.?", "z.*"], {"x.u", "x.x", "x.y", "z.u", "z.y"}),
        (["*.?"], {"x.u", "x.x", "x.y", "z.u", "z.y"}),
        (["x.y", "x.gain"], {"x.y", "x.gain"}),
        ([], {"x.y", "z.y"}),
    ],
)  # fmt: skip
def test_what_is_recorded_may_be_a_pattern(fmu, signals: list[str], expected: set[str]) -> None:
    text = document({"x": {"model": str(fmu("2.0"))}, "z": HOLD}, record={"signals": signals})
    plan = assemble(build(text, Path("test.toml")))
    assert {c.name for c in columns(plan, signals)} == expected


def test_what_events_change_is_recorded() -> None:
    events = [{"at": 1, "set": {"plant.u": 1}}]
    text = document({"plant": HOLD}, extra={"events": events})
    assert {c.name for c in columns(assemble(build(text, Path("test.toml"))))} == {
        "plant.u",
        "plant.y",
    }


# ---- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "found none of from, table, points; expected one of them"),
        ({"from": "a.y", "points": [[0, 1]]}, "found from and points of from, table, points"),
        ({"from": "a.y", "interpolate": "linear"}, "found interpolate with from"),
        ({"points": [[0, 1]], "column": "u"}, "found column with points"),
        ({"points": [[1, 1], [0.5, 2]]}, "the times of the points do not increase"),
        ({"table": "gone.csv"}, "cannot be read"),
        ({"table": "u.csv", "column": "v"}, "no signal 'v' (there are: u)"),
    ],
)
def test_inputs_that_fit_nothing_are_refused(given: Any, message: str, tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("t,u\n0,1\n")
    components = {"plant": {**HOLD, "inputs": {"u": given}}, "a": HOLD}
    with pytest.raises(ScenarioError) as caught:
        rows_of(components, (), tmp_path)
    assert message in str(caught.value) and "components.plant.inputs.u" in str(caught.value)


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ([{"at": -1, "set": {"plant.u": 1}}], "expected 0 s or more"),
        ([{"at": 1, "over": -1, "set": {"plant.u": 1}}], "events.0.over: expected 0 s or more"),
        ([{"at": 1, "over": 1, "for": 0.5, "set": {"plant.u": 1}}], "expected at least `over`"),
        ([{"at": 1, "set": {"plant.v": 1}}], "no input of plant 'v'"),
        ([{"at": 1, "set": {"plant.y": 1}}], "plant.y is not an input"),
        ([{"at": 1, "set": {"fed.u": 1}}], "fed.u is fed twice: by plant.y and by events"),
        (
            [{"at": 1, "set": {"plant.u": 1}, "over": 1}, {"at": 1.5, "set": {"plant.u": 2}}],
            "events.1: changes plant.u at 1.5 s, before the event at 1 s is over at 2 s",
        ),
    ],
)
def test_events_that_fit_nothing_are_refused(events: Any, message: str) -> None:
    components = {"plant": HOLD, "fed": {**HOLD, "inputs": {"u": "plant.y"}}}
    with pytest.raises(ScenarioError) as caught:
        rows_of(components, (), extra={"events": events})
    assert message in str(caught.value)
