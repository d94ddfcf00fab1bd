"""Metrics against closed forms, and their messages if there is no number."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isnan, nan, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.measure.metrics import Error, Measure, MetricResult, evaluate, metric, settle_time
from cosim.record.signals import Array

T = np.linspace(0, 10, 10_001)


class Recorded:
    """Signals in memory: name -> (values (n, m), unit)."""

    def __init__(self, t: Array, signals: Mapping[str, tuple[Array, str]]) -> None:
        self.t = t
        self._signals = signals

    def array(self, prefix: str) -> Array:
        if prefix not in self._signals:
            raise ScenarioError(f"no signal {prefix!r} was recorded")
        values = self._signals[prefix][0]
        return values if values.ndim == 2 else values[:, None]

    def entries(self, prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}[{i}]" for i in range(self.array(prefix).shape[1]))

    def unit(self, prefix: str) -> str:
        return self._signals[prefix][1]


def recorded(t: Array = T, **signals: Array | tuple[Array, str]) -> Recorded:
    pairs = {k: v if isinstance(v, tuple) else (v, "rad") for k, v in signals.items()}
    return Recorded(t, pairs)


def number(kind: str, x: Array, t: Array = T, **options: float) -> MetricResult:
    return metric("m", kind, ["x"], **options).evaluate(recorded(t, x=(x, "N.m")))


# ---- error ---------------------------------------------------------------------------------------


def test_error_of_an_exponential() -> None:
    # e = exp(-t) on one joint, half of it on the other: below 0.05 from ln 20 on
    x = 3.0 - np.outer(np.exp(-T), [1, 0.5])
    r = Error("e", ("x",), (3.0, 3.0), within=0.05).evaluate(recorded(x=x))
    assert r.unit == "rad"
    assert r.value == r.parts["final"] == pytest.approx(np.exp(-10))
    assert r.parts["settle_s"] == pytest.approx(np.log(20), abs=1.1e-3)
    assert r.parts["max"] == 1 and r.parts["max_at_s"] == 0
    assert r.parts["rmse"] == pytest.approx(sqrt((1 - np.exp(-20)) / 20), rel=1e-6)
    assert r.facts == (
        ("e", "4.54e-05 rad at the end (10 s)"),
        ("e, RMS", "0.224 rad over 10 s"),
        ("e, peak", "1 rad at 0 s"),
        ("settled", "after 2.996 s (e below 0.05 rad)"),
    )


def test_norm_of_the_error_changes_the_settle_time() -> None:
    x = np.outer(np.exp(-T), [1, 1])
    by = {
        norm: metric("e", "error", ["x"], target=[0, 0], within=0.05, norm=norm)
        .evaluate(recorded(x=x))
        .parts["settle_s"]
        for norm in ("max", "euclidean")
    }
    assert by["max"] == pytest.approx(np.log(20), abs=1.1e-3)
    assert by["euclidean"] == pytest.approx(np.log(20 * sqrt(2)), abs=1.1e-3)


def test_error_is_that_of_the_worst_signal() -> None:
    slow, fast = np.exp(-T), np.exp(-5 * T)
    run = recorded(slow=slow, fast=fast)
    both = Error("e", ("fast", "slow"), (0.0,), within=0.01).evaluate(run)
    alone = Error("e", ("slow",), (0.0,), within=0.01).evaluate(run)
    assert both.parts == alone.parts


def test_error_between_signals() -> None:
    run = recorded(a=np.column_stack([T, T]), b=np.column_stack([T - 0.1, T + 0.2]))
    r = Error("sync", ("a",), "b").evaluate(run)
    assert r.value == pytest.approx(0.2) and "settle_s" not in r.parts
    assert Error("sync", ("a",), "b").signals == ("a", "b")


def test_error_that_leaves_the_band_at_the_end() -> None:
    r = Error("e", ("x",), (0.0,), within=0.05).evaluate(recorded(x=T - 9.0))
    assert r.parts["settle_s"] == inf
    assert r.more[-1] == ("settled", "never (e 1 rad at the end, expected below 0.05 rad)")


@given(
    st.lists(st.sampled_from([0.0, 0.04, 0.05, 0.06, 1.0, nan, inf]), min_size=1, max_size=20),
)
def test_settle_time_is_the_last_exit(values: list[float]) -> None:
    t = np.arange(len(values)) * 0.5
    inside = [v < 0.05 for v in values]
    stays = [all(inside[i:]) for i in range(len(values))]
    expected = t[stays.index(True)] if True in stays else inf
    assert settle_time(np.array(values), t, 0.05) == expected


# ---- measures ------------------------------------------------------------------------------------


def test_norm_of_a_damped_signal() -> None:
    r = number("norm", np.outer(np.exp(-T), [3, 4]))  # |x| = 5 exp(-t)
    assert r.value == pytest.approx(5 * sqrt((1 - np.exp(-20)) / 2), rel=1e-6)
    assert r.unit == "N.m.√s"


def test_integral_and_rms_of_a_sine() -> None:
    t = np.linspace(0, 2 * pi, 20_001)
    assert number("integral_abs", np.sin(t), t).value == pytest.approx(4, rel=1e-6)
    assert number("integral_abs", np.sin(t), t).unit == "N.m.s"
    assert number("rms", np.sin(t), t).value == pytest.approx(1 / sqrt(2), rel=1e-6)


def test_tail_mean_is_of_the_tail() -> None:
    x = np.where(T[:, None] < 9, 100.0, [[3.0, -4.0]])
    r = number("tail_mean", x, window=1.0)
    assert r.value == pytest.approx(5.0) and r.unit == "N.m"
    assert r.text == "5 N.m (mean magnitude of x over the last 1 s)"
    whole = number("tail_mean", np.ones(10_001), window=60.0)
    assert whole.value == 1 and "over 10 s, which is all there is" in whole.detail


def test_peak_says_when_and_where() -> None:
    x = np.zeros((10_001, 2))
    x[5000, 1], x[7000, 0], x[8000, 1] = -26.9, 20.0, 26.9
    r = number("peak", x)
    assert r.value == 26.9 and r.parts == {"at_s": 5.0}
    assert r.detail == "at 5 s (x[1])"


def test_final_of_a_scalar_keeps_its_sign() -> None:
    assert number("final", -T).value == -10
    vector = number("final", np.outer(T, [0.3, -0.4]))
    assert vector.value == pytest.approx(5)
    assert vector.parts == pytest.approx({"x[0]": 3.0, "x[1]": -4.0})


@given(
    st.sampled_from(["norm", "integral_abs", "rms", "tail_mean", "peak"]),
    st.floats(-1e3, 1e3),
    st.integers(2, 50),
)
def test_scaling_a_signal_scales_its_measure(kind: str, factor: float, n: int) -> None:
    x = np.random.default_rng(n).normal(size=(n, 3))
    t = np.arange(n) * 0.01
    options = {"window": 0.1} if kind == "tail_mean" else {}
    one, scaled = number(kind, x, t, **options), number(kind, factor * x, t, **options)
    assert scaled.value == pytest.approx(abs(factor) * one.value, rel=1e-9, abs=1e-12)


@given(st.integers(1, 40), st.integers(1, 8))
def test_trapezoids_do_not_need_equal_steps(n: int, every: int) -> None:
    # rows decimated, the last one kept: a straight line is still integrated exactly
    k = np.unique([*range(0, n + 1, every), n])
    t = k * 0.1
    assert number("integral_abs", 2 * t, t).value == pytest.approx((n * 0.1) ** 2)


def test_signals_are_stacked() -> None:
    run = recorded(a=(np.full(10_001, 3.0), "N.m"), b=(np.full(10_001, 4.0), "N.m"))
    assert Measure("m", "rms", ("a", "b")).evaluate(run).value == pytest.approx(5)


# ---- no number, no sense -------------------------------------------------------------------------

KINDS = {
    "error": {"target": (0.0,), "within": 0.1},
    "norm": {}, "integral_abs": {}, "rms": {}, "tail_mean": {"window": 1.0},
    "peak": {}, "final": {},
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_hardly_any_rows(kind: str, rows: int) -> None:
    r = metric("m", kind, ["x"], **KINDS[kind]).evaluate(recorded(T[:rows], x=np.ones(rows)))
    if rows == 0:
        assert isnan(r.value) and r.text == "no number: nothing was recorded"
    else:
        assert r.value == pytest.approx(
            {"norm": sqrt(T[rows - 1]), "integral_abs": T[rows - 1]}.get(kind, 1)
        )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bad", [nan, inf])
def test_a_value_that_is_not_finite(kind: str, bad: float) -> None:
    x = np.ones(10_001)
    x[2000] = bad
    r = metric("m", kind, ["x"], **KINDS[kind]).evaluate(recorded(x=x))
    assert isnan(r.value) and r.text == f"no number: x[0] is {bad} at 2 s"


def test_results_come_in_order_with_labels() -> None:
    run = recorded(x=np.ones(10_001))
    results = evaluate([metric("b", "peak", ["x"], label="peak"), metric("a", "rms", ["x"])], run)
    assert [(r.name, r.label, r.value) for r in results] == [("b", "peak", 1), ("a", "a", 1)]


@pytest.mark.parametrize(
    ("declared", "sentence"),
    [
        ({"of": ["y"]}, "no signal 'y' was recorded"),
        ({"of": ["x", "v"]}, r"x is in \[rad\] but v is in \[rad/s\]"),
        ({"of": ["short"]}, "short has 3 rows, the time has 10001"),
        ({"kind": "error", "target": "v"}, r"x is in \[rad\] but v is in \[rad/s\]"),
        ({"kind": "error", "target": "y"}, "no signal 'y' was recorded"),
        ({"kind": "error", "target": [1.0]}, "x has size 2, but its target is a list of length 1"),
        ({"kind": "error", "target": "one"}, "x has size 2, but its target is one of size 1"),
    ],
)
def test_signals_that_do_not_fit(declared: dict[str, object], sentence: str) -> None:
    x = np.ones((10_001, 2))
    run = recorded(x=x, v=(x, "rad/s"), one=np.ones(10_001), short=np.ones((3, 2)))
    arguments = {"kind": "rms", "of": ["x"], **declared}
    with pytest.raises(ScenarioError, match=rf"^metrics\.m: {sentence}"):
        metric("m", **arguments).evaluate(run)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("declared", "sentence"),
    [
        ({"kind": "nrom"}, "unknown kind 'nrom'; expected one of error, norm"),
        ({"kind": "error"}, "kind 'error' needs 'target'"),
        ({"kind": "tail_mean"}, "kind 'tail_mean' needs 'window'"),
        ({"kind": "peak", "window": 1.0}, "kind 'peak' takes no 'window'"),
        ({"kind": "tail_mean", "window": 0.0}, "found 0, expected a number above 0"),
        ({"kind": "tail_mean", "window": nan}, "found nan, expected a number above 0"),
        ({"kind": "error", "target": [1], "within": -1}, "found -1, expected a number above 0"),
        ({"kind": "rms", "of": []}, "'of' names no signal"),
    ],
)
def test_declarations_that_make_no_sense(declared: dict[str, object], sentence: str) -> None:
    arguments = {"of": ["x"], "place": "a.toml at metrics.m", **declared}
    with pytest.raises(ScenarioError, match=rf"^a\.toml at metrics\.m.*: {sentence}"):
        metric("m", **arguments)  # type: ignore[arg-type]


def test_vibration_is_the_swing_of_the_last_seconds_and_its_frequency() -> None:
    """The greatest entry counts, not what was before, nor where it swings about."""
    x = np.stack([0.1 * np.sin(2 * pi * 12.7 * T), 0.5 + 0.3 * np.sin(2 * pi * 3.3 * T)], axis=1)
    x[T < 5] *= 4.0
    r = number("vibration", x, window=2.0)
    assert r.value == pytest.approx(0.3, rel=1e-3) and "x[1]" in r.detail
    assert r.parts["frequency_hz"] == pytest.approx(3.3, rel=1e-3)
    still = number("vibration", np.exp(-T), window=1.0)
    assert still.parts["frequency_hz"] == 0.0 and still.value < 1e-4
