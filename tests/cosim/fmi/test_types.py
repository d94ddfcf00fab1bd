"""Every numeric type through the engine; texts, sizes, ranges, units, early return, events."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import CosimError, FmuError, RunError
from cosim.base.units import conversion
from cosim.fmi import FmuComponent, FmuOptions
from tests.cosim.fmi.exporter import (
    FOLDER,
    TYPES3,
    column,
    events3,
    export,
    nasty2,
    passing3,
    plan_of,
    run,
)

EXACT = 2.0**53
VALUES = {
    "Float64": [0.1, -1e300, 5.0], "Float32": [0.5, -3.0, 2.0**100],
    "Int8": [-128, 127, 3], "UInt8": [255, 0, 7], "Int16": [-(2**15), 2**15 - 1, 1],
    "UInt16": [65535, 1, 0], "Int32": [-(2**31), 2**31 - 1, 0], "UInt32": [2**32 - 1, 0, 1],
    "Int64": [-EXACT, EXACT, 1], "UInt64": [EXACT, 0, 1], "Enumeration": [2, 1, 3],
    "Boolean": [1, 0, 1],
}  # fmt: skip


@pytest.fixture(scope="module")
def passing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(passing3(), tmp_path_factory.mktemp("fmu") / "passing3.fmu")


@pytest.fixture(scope="module")
def events(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(events3(), tmp_path_factory.mktemp("fmu") / "events3.fmu")


@pytest.mark.parametrize("isolate", [False, True])
def test_every_type_of_fmi3_passes_exactly(passing: Path, isolate: bool) -> None:
    plan = plan_of(passing, 3, options=FmuOptions(isolate=isolate))
    feed = {f"u_{kind}": np.array(values, float) for kind, values in VALUES.items()}
    rows, engine = run(plan, feed)
    with engine:
        for kind in TYPES3:
            assert column(plan, rows, f"y_{kind}")[1:].tolist() == VALUES[kind], kind


@pytest.mark.parametrize("isolate", [False, True])
def test_every_type_of_fmi2_passes_exactly(tmp_path: Path, isolate: bool) -> None:
    path = export(nasty2(), tmp_path / "nasty2.fmu")
    plan = plan_of(path, 3, options=FmuOptions(texts={"label": "hello ξ"}, isolate=isolate))
    feed = {"count": [-(2**31), 2**31 - 1, 5], "flag": [1, 0, 1], "mode": [2, 1, 2]}
    rows, engine = run(plan, {k: np.array(v, float) for k, v in feed.items()})
    with engine:
        for given, got in (("count", "counted"), ("flag", "up"), ("mode", "chosen")):
            assert column(plan, rows, got)[1:].tolist() == feed[given]
        assert engine.texts() == {"x.said": ["hello ξ"]}


@pytest.mark.parametrize(
    ("kind", "value"),
    [("Int8", 128.0), ("UInt8", -1.0), ("Int32", 0.5), ("UInt16", 65536.0), ("Boolean", 2.0),
     ("Int64", 2 * EXACT), ("UInt64", -1.0), ("Float32", 1e39), ("Int16", np.nan)],
)  # fmt: skip
@pytest.mark.parametrize("isolate", [False, True])
def test_a_value_the_type_has_not_stops_the_run(
    passing: Path, kind: str, value: float, isolate: bool
) -> None:
    plan = plan_of(passing, 2, options=FmuOptions(isolate=isolate))
    with pytest.raises(RunError, match=rf"x\.u_{kind} = .* is no value of its type.*tick 0"):
        run(plan, {f"u_{kind}": np.array([value, value])})


@pytest.mark.parametrize("isolate", [False, True])
def test_a_64_bit_output_that_float64_cannot_carry_stops_the_run(
    passing: Path, isolate: bool
) -> None:
    plan = plan_of(passing, 2, values={"mode": (3.0,)}, options=FmuOptions(isolate=isolate))
    with pytest.raises(CosimError, match=r"x\.y_Int64 = 9007199254740992 is no value of its type"):
        run(plan)


def test_texts_go_in_at_the_start_and_come_out_at_the_end(passing: Path) -> None:
    options = FmuOptions(texts={"label": "left arm", "blob": "c0ffee00"})
    _, engine = run(plan_of(passing, 1, options=options))
    with engine:
        assert engine.texts() == {"x.said": ["left arm"], "x.sent": ["c0ffee00"]}


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ({"u_Int8": "x"}, "no String or Binary variable 'u_Int8' .there are: label, said, blob"),
        ({"label": ["a", "b"]}, "label has 1 entries, found 2"),
    ],
)
def test_a_text_that_does_not_fit_is_refused(passing: Path, texts: dict, message: str) -> None:
    with pytest.raises(FmuError, match=message):
        FmuComponent(passing, "x", None, FmuOptions(texts=texts))


def test_binary_start_values_are_hexadecimal(passing: Path) -> None:
    with pytest.raises(CosimError, match="expected hexadecimal text"):
        run(plan_of(passing, 1, options=FmuOptions(texts={"blob": "xyz"})))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("isolate", [False, True])
def test_sizes_are_set_before_the_start(passing: Path, n: int, isolate: bool) -> None:
    plan = plan_of(passing, 1, values={"factor": (2.0,)},
                   options=FmuOptions(sizes={"n": n}, isolate=isolate))  # fmt: skip
    matrix = np.arange(n * n, dtype=float).reshape(n, n)
    rows, engine = run(plan, {"A": matrix[None]})
    with engine:
        assert column(plan, rows, "B")[1].tolist() == (2.0 * matrix).tolist()


@pytest.mark.parametrize("isolate", [False, True])
def test_structural_parameters_that_are_no_sizes_are_parameters(
    passing: Path, isolate: bool
) -> None:
    fmu = FmuComponent(passing)
    assert {p.name: p.type for p in fmu.parameters}["flip"] == "boolean"
    assert "n" not in {p.name for p in fmu.parameters}
    plan = plan_of(passing, 1, values={"flip": (1.0,)}, options=FmuOptions(isolate=isolate))
    rows, engine = run(plan, {"A": np.arange(4.0).reshape(1, 2, 2)})
    with engine:
        assert column(plan, rows, "B")[1].tolist() == [[0.0, -1.0], [-2.0, -3.0]]


def test_sizes_that_are_none_are_refused(passing: Path, tmp_path: Path) -> None:
    with pytest.raises(FmuError, match=r"no structural parameter 'm' is a size .there are: n.$"):
        FmuComponent(passing, "x", None, FmuOptions(sizes={"m": 3}))
    with pytest.raises(FmuError, match=r"has no structural parameters, found \['n'\]"):
        FmuComponent(export(nasty2(), tmp_path / "x.fmu"), "x", None, FmuOptions(sizes={"n": 3}))
    with pytest.raises(CosimError, match="fmi3SetUInt64: 1 values do not fit variable 300"):
        run(plan_of(passing, 1, options=FmuOptions(sizes={"n": 9})))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"factor": (-1.0,)}, "factor = -1 is below its minimum 0"),
        ({"factor": (11.0,)}, "factor = 11 is above its maximum 10"),
        ({"mode": (1.5,)}, "mode = 1.5 is not a valid Enumeration; expected a whole number"),
    ],
)
def test_a_start_value_out_of_range_is_a_sentence(
    passing: Path, values: dict, message: str
) -> None:
    with pytest.raises(CosimError, match=message):
        run(plan_of(passing, 1, values=values))


def test_units_are_the_fmus_own(passing: Path) -> None:
    component = FmuComponent(passing)
    gain, offset = conversion("deg", component.unit("turns"))
    assert (gain * 180.0 + offset, offset) == (pytest.approx(0.5, rel=1e-15), 0.0)
    gain, offset = conversion("K", component.unit("Cel"))
    assert gain * 273.15 + offset == 0.0
    assert conversion("N.m", component.unit("Nm")) == (1.0, 0.0)
    assert component.unit("kg") == "kg"


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("kind", ["sampled", "continuous"])
def test_events_clocks_and_early_returns(events: Path, isolate: bool, kind) -> None:
    """20 steps of 0.1 s: the clock ticks in every other, the bell rings every 0.3 s."""
    plan = plan_of(
        events, 20, values={"half": (1.0,)}, kind=kind, options=FmuOptions(isolate=isolate)
    )
    fed = np.arange(20.0)
    rows, engine = run(plan, {"clocked": fed, "discrete": np.floor(fed / 5)})
    with engine:
        assert column(plan, rows, "ticks")[1:].tolist() == [1 + k // 2 for k in range(20)]
        assert column(plan, rows, "sampled")[1:].tolist() == [k - k % 2 for k in range(20)]
        assert column(plan, rows, "changes")[-1] == 5.0  # at the start, and four values
        assert column(plan, rows, "bells")[-1] == 6.0
        assert column(plan, rows, "calls")[-1] >= 40.0
        assert column(plan, rows, "integral")[-1] == pytest.approx(2.0, abs=1e-12)


def test_a_time_event_within_a_step_is_met(events: Path) -> None:
    """Steps of 0.2 s are cut at 0.3 s, 0.9 s and 1.5 s."""
    plan = plan_of(events, 10, h=0.2)
    rows, engine = run(plan)
    with engine:
        assert column(plan, rows, "bells").tolist() == [0, 0, 1, 2, 2, 3, 4, 4, 5, 6, 6]
        assert column(plan, rows, "calls")[-1] == 13.0


@pytest.mark.parametrize(
    ("clock", "message"),
    [
        ('intervalVariability="constant" intervalDecimal="0.25"', "0.25 s, is not a multiple"),
        ('intervalVariability="countdown"', "the binary lacks fmi3GetIntervalDecimal"),
        ('intervalVariability="now and then"', "'now and then'; expected one of constant, fixed"),
        ('intervalVariability="fixed"', "the binary lacks fmi3GetIntervalDecimal"),
        ('intervalVariability="constant"', "states no interval"),
        ('intervalVariability="fixed" intervalCounter="0" resolution="10"', "interval 0 s"),
        ('intervalVariability="constant" intervalDecimal="0.2" shiftDecimal="0.05"', "the shift"),
    ],
)
def test_a_clock_that_cannot_be_kept_is_refused(tmp_path: Path, clock: str, message: str) -> None:
    with pytest.raises(CosimError, match=message):
        run(plan_of(export(events3(clock), tmp_path / "x.fmu"), 1))


def test_a_shifted_clock_by_counters(tmp_path: Path) -> None:
    clock = 'intervalVariability="fixed" intervalCounter="3" shiftCounter="1" resolution="10"'
    plan = plan_of(export(events3(clock), tmp_path / "x.fmu"), 8)
    rows, engine = run(plan)
    with engine:
        assert column(plan, rows, "ticks")[1:].tolist() == [0, 1, 1, 1, 2, 2, 2, 3]


def test_a_step_that_is_no_multiple_of_the_inner_one_is_refused(tmp_path: Path) -> None:
    fixed = nasty2('fixedInternalStepSize="0.03"').replace('StepSize="true"', 'StepSize="false"', 1)
    path = export(fixed, tmp_path / "x.fmu")
    with pytest.raises(CosimError, match=r"0\.1 s, is not a multiple of the step 0\.03 s"):
        run(plan_of(path, 1))
    run(plan_of(path, 1, h=0.06))[1].close()


def test_an_array_of_another_size_than_the_binarys_is_refused(tmp_path: Path) -> None:
    wrong = passing3().replace('<Dimension valueReference="300"/></Float64>',
                               '<Dimension start="3"/></Float64>')  # fmt: skip
    with pytest.raises(CosimError, match="6 values do not fit variable"):
        run(plan_of(export(wrong, tmp_path / "x.fmu"), 1))


def test_several_instances_of_one_fmu(passing: Path) -> None:
    plans = [plan_of(passing, 2) for _ in range(3)]
    engines = []
    for i, plan in enumerate(plans):
        rows, engine = run(plan, {"u_Int32": np.array([i, 10 + i], float)})
        engines.append(engine)
        assert column(plan, rows, "y_Int32")[1:].tolist() == [i, 10 + i]
    for engine in engines:
        engine.close()


def test_what_a_scenario_gives_is_sorted_into_sizes_texts_and_numbers(passing: Path) -> None:
    values = {"n": 3, "label": "left", "mode": "fast", "factor": 2.0}
    component = FmuComponent(passing, "x", None, FmuOptions(given=values))
    assert component.taken == {"n", "label"}
    assert {p.name: p.shape for p in component.inputs}["A"] == (3, 3)
    assert component.number("mode", "fast") == 2
    assert component.number("mode", ["slow", 2]) == [1, 2]
    assert component.number("factor", "2 rad") == "2 rad"
    with pytest.raises(FmuError, match="mode has no item 'faster'; expected one of: slow, fast"):
        component.number("mode", "faster")
    with pytest.raises(FmuError, match="n is a size; expected a whole number, found 'three'"):
        FmuComponent(passing, "x", None, FmuOptions(given={"n": "three"}))
    _, engine = run(plan_of(passing, 1, options=FmuOptions(given=values)))
    with engine:
        assert engine.texts()["x.said"] == ["left"]


def test_the_log_of_an_fmu_is_kept(tmp_path: Path) -> None:
    path = export(nasty2(), tmp_path / "x.fmu")
    _, engine = run(plan_of(path, 1, options=FmuOptions(log=True)))
    with engine:
        assert engine.logs() == {"x": "[ok] logAll: x is made\n"}


@given(
    st.lists(st.integers(-(2**53), 2**53), min_size=4, max_size=4),
    st.lists(st.integers(0, 2**32 - 1), min_size=4, max_size=4),
    st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=4, max_size=4),
)
def test_whatever_a_type_holds_passes_exactly(
    int64: list[int], uint32: list[int], float32: list[float]
) -> None:
    plan = plan_of(_any_passing(), 4)
    feed = {"Int64": int64, "UInt32": uint32, "Float32": float32}
    rows, engine = run(plan, {f"u_{k}": np.array(v, float) for k, v in feed.items()})
    with engine:
        for kind, values in feed.items():
            assert column(plan, rows, f"y_{kind}")[1:].tolist() == values


@cache
def _any_passing() -> Path:
    return export(passing3(), Path(FOLDER.name) / "passing3.fmu")
