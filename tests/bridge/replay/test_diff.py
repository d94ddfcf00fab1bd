"""Two runs side by side: numbers, bounds and verdicts."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from bridge.cli.diff import diff, lines
from bridge.replay import aligned
from bridge.replay import diff as comparing
from bridge.replay.aligned import Changes, rows_within
from bridge.replay.diff import compare_runs
from bridge.replay.page import write_diff_page, write_junit
from bridge.results.outcome import run_twin
from cosim.base.errors import ScenarioError
from cosim.cli.options import flat
from cosim.record import Column, Recorder, Run, groups, write_metadata
from tests.bridge.deployments import SHORT, TELEOPERATION, named, offline
from tests.cosim.record.in_pieces import read_in_pieces

app = typer.Typer()
app.command()(flat(diff))


def made(folder, signals, h=0.1, every=1, metadata=None):
    """A run folder of these scalars, (n,) each."""
    folder.mkdir(parents=True)
    columns = [Column(name, "rad", i) for i, name in enumerate(signals)]
    rows = np.column_stack(list(signals.values()))
    with Recorder(
        folder, columns, h=h, every=every, rows_per_chunk=max(1, len(rows)), n_signals=len(signals)
    ) as recorder:
        buffer = recorder.buffer()
        buffer[: len(rows)] = rows
        if len(rows):
            recorder.submit(buffer, 0, len(rows))
    if metadata is not None:
        write_metadata(folder, metadata)
    return folder


T = 0.1 * np.arange(100)
WAVE = np.sin(T)


def test_a_run_is_identical_to_itself(tmp_path):
    a = made(tmp_path / "a", {"x.q[0]": WAVE, "x.v": T})
    found = compare_runs(a, a)
    assert found.verdict == "identical" and found.exit_code == 0
    assert found.sentence() == "identical to the bit in 2 signals, 100 rows"
    assert {s.largest for s in found.signals} == {0.0}


def test_one_bit_makes_them_not_identical(tmp_path):
    other = WAVE.copy()
    other[41] = np.nextafter(other[41], 2.0)
    a, b = made(tmp_path / "a", {"x": WAVE}), made(tmp_path / "b", {"x": other})
    found = compare_runs(a, b)
    assert found.verdict == "equal"
    assert found.signals[0].at == pytest.approx(4.1)
    assert found.signals[0].largest == abs(other[41] - WAVE[41])


def test_what_is_less_than_a_period_apart_is_equal_and_what_is_more_is_not(tmp_path):
    a = made(tmp_path / "a", {"x": WAVE})
    for delay, verdict in ((0.09, "equal"), (0.3, "different")):
        b = made(tmp_path / f"b{delay}", {"x": np.sin(T - delay)})
        found = compare_runs(a, b)
        assert found.verdict == verdict
        assert found.exit_code == (verdict == "different")
    assert found.sentence().startswith("different: 1 of 1 signals are further apart than")


def test_a_constant_offset_of_what_stands_still_is_a_difference(tmp_path):
    a = made(tmp_path / "a", {"x": np.ones(100)})
    b = made(tmp_path / "b", {"x": np.full(100, 1.0 + 1e-12)})
    assert compare_runs(a, b).verdict == "different"
    assert compare_runs(a, b, tolerance=1e-9).verdict == "equal"
    assert "equal within 1e-09 of each signal's unit" in compare_runs(a, b, (), 1e-9).sentence()


@given(offset=st.floats(-10, 10), n=st.integers(2, 50))
def test_rms_and_maximum_are_those_of_the_difference(offset, n, tmp_path_factory):
    folder = tmp_path_factory.mktemp("d")
    x = np.linspace(0, 1, n)
    a, b = made(folder / "a", {"x": x}), made(folder / "b", {"x": x + offset})
    s = compare_runs(a, b).signals[0]
    assert np.isclose(s.rms, abs(offset), rtol=1e-9, atol=1e-12)
    assert np.isclose(s.largest, abs(offset), rtol=1e-9, atol=1e-12)


def test_a_coarser_run_is_compared_where_it_has_rows_the_other_holds(tmp_path):
    a = made(tmp_path / "a", {"x": WAVE})
    b = made(tmp_path / "b", {"x": WAVE}, every=5)
    found = compare_runs(a, b)
    assert found.verdict == "identical"
    assert found.rows == len(Run.open(b))
    held = made(tmp_path / "c", {"x": WAVE[::3]}, h=0.3)
    assert compare_runs(a, held).verdict == "identical"


def test_runs_of_different_length_are_compared_over_what_both_have(tmp_path):
    a, b = made(tmp_path / "a", {"x": WAVE}), made(tmp_path / "b", {"x": WAVE[:60]})
    found = compare_runs(a, b)
    assert (found.rows, found.t_end) == (60, pytest.approx(5.9))
    assert (found.verdict, found.exit_code) == ("different", 1)
    assert found.sentence() == (
        "different: identical to the bit in 1 signals, 60 rows over the common 5.9 s; "
        "a is 9.9 s long; b is 5.9 s long"
    )
    assert f"a  {a}, to 9.9 s" in lines(found)
    assert compare_runs(a, b, whole=False).verdict == "identical"
    cases = ElementTree.parse(write_junit(found, tmp_path / "j.xml")).getroot()
    assert cases.get("failures") == "1" and cases.get("tests") == "2"
    assert [c.get("name") for c in cases if c.find("failure") is not None] == ["length"]


def test_two_rows_more_are_another_length_and_one_or_a_coarser_run_is_not(tmp_path):
    a, b = made(tmp_path / "a", {"x": WAVE}), made(tmp_path / "b", {"x": WAVE[:-2]})
    one = made(tmp_path / "one", {"x": WAVE[:-1]})
    assert compare_runs(a, one).verdict == "identical"
    assert compare_runs(a, b).verdict == compare_runs(b, a).verdict == "different"
    coarse = made(tmp_path / "coarse", {"x": WAVE}, every=7)  # ends at 9.8 s
    assert compare_runs(a, coarse).verdict == "identical"


@pytest.mark.parametrize("empty", ["a", "b", "ab"])
def test_a_run_without_rows_is_named_whichever_it_is(empty, tmp_path):
    paths = [made(tmp_path / n, {"x": WAVE[: 0 if n in empty else 100]}) for n in "ab"]
    with pytest.raises(ScenarioError, match="a run without rows"):
        compare_runs(*paths)


def within_a_period(t, period):
    """RMS and maximum of what a ramp changes by within a period."""
    found = Changes(len(t), rows_within(len(t), t[-1] - t[0], period))
    found.add(t)
    return found.rms, found.largest


@pytest.mark.parametrize(("step", "rows"), [(0.1, 5), (0.2, 2), (1.0, 1)])
def test_a_ramp_changes_within_a_period_by_the_rows_in_it(step, rows):
    """On a ramp of 1/s, a period of 0.5 s has this many whole rows, and at least one."""
    t = step * np.arange(50)
    assert within_a_period(t, 0.5) == pytest.approx((rows * step, rows * step))
    assert within_a_period(t[:1], 0.5) == (0.0, 0.0)


@pytest.mark.parametrize("count", [3, 4])
def test_a_period_of_a_few_rows_that_begin_late_has_the_same_rows(count):
    """On a ramp of 1/s in steps of 0.1 s, a period of 0.2 s has two rows."""
    t = 10 + 0.1 * np.arange(count)
    assert within_a_period(t, 0.2) == pytest.approx((0.2, 0.2))
    assert within_a_period(t[:2], 0.1) == pytest.approx((0.1, 0.1))


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("values", [1, 7000])
def test_a_comparison_does_not_depend_on_pieces(tmp_path, monkeypatch, values, every):
    """Two runs with gaps, the second one also recorded more coarsely, are read in pieces."""
    random = np.random.default_rng(3)
    x = np.cumsum(random.normal(size=(2, 5000)), axis=1)
    gaps = x[0].copy()
    gaps[[7, 2000, 4000]] = np.nan
    monkeypatch.setattr(groups, "_GROUP_MOST", 1024)
    a = made(tmp_path / "a", {"x": x[0], "y": x[1], "z": gaps})
    b = made(tmp_path / "b", {"x": x[0] + x[1] / 9, "y": x[1], "z": gaps + 1}, every=every)
    expected = compare_runs(a, b)
    read_in_pieces(monkeypatch, values)
    monkeypatch.setattr(aligned, "VALUES", values)
    read = []
    monkeypatch.setattr(
        comparing, "together", lambda *x: [read.append(x[3]), aligned.together(*x)][1]
    )
    assert compare_runs(a, b) == expected
    assert max(map(len, read)) == (1 if values == 1 else 3)
    monkeypatch.undo()
    rows = np.unique([*range(0, 5000, every), 4999])  # the last one is always there
    n = rows_within(len(rows), 499.9, 0.1 * every)
    d, z = x[1][rows] / 9, gaps[rows]
    found = {s.name: s for s in expected.signals}
    assert found["x"].largest == pytest.approx(np.abs(d).max())
    assert found["x"].rms == pytest.approx(np.sqrt(np.mean(d * d)))
    changes = np.abs(z[n:] - z[:-n])
    changes = changes[np.isfinite(changes)]
    assert found["z"].bound_rms == pytest.approx(np.sqrt(np.mean(changes**2)), rel=1e-6)


def test_numbers_that_are_none_are_equal_to_each_other_only(tmp_path):
    gap = WAVE.copy()
    gap[5] = np.nan
    a, b = made(tmp_path / "a", {"x": gap}), made(tmp_path / "b", {"x": WAVE})
    assert compare_runs(a, a).verdict == "identical"
    found = compare_runs(a, b)
    assert found.verdict == "different"
    assert found.signals[0].largest == np.inf


def test_the_largest_by_its_bound_comes_first_and_what_one_lacks_is_said(tmp_path):
    a = made(tmp_path / "a", {"x": WAVE, "y": WAVE, "z": WAVE, "u": T})
    b = made(tmp_path / "b", {"x": WAVE, "y": WAVE + 0.5, "z": WAVE + 0.1, "v": T})
    found = compare_runs(a, b)
    assert [s.name for s in found.signals] == ["y", "z", "x"]
    assert found.only == (("u",), ("v",))
    assert "only in a: u" in lines(found)


@pytest.mark.parametrize(
    ("wanted", "names"),
    [
        (["arm"], {"arm.q[0]", "arm.q[1]", "arm.v"}),
        (["arm.q"], {"arm.q[0]", "arm.q[1]"}),
        (["arm.q[1]", "arms.v"], {"arm.q[1]", "arms.v"}),
    ],
)
def test_signals_may_be_chosen(wanted, names, tmp_path):
    signals = dict.fromkeys(["arm.q[0]", "arm.q[1]", "arm.v", "arms.v"], WAVE)
    a = made(tmp_path / "a", signals)
    assert {s.name for s in compare_runs(a, a, wanted).signals} == names


def test_what_cannot_be_compared_is_said(tmp_path):
    a, b = made(tmp_path / "a", {"x": WAVE}), made(tmp_path / "b", {"y": WAVE})
    with pytest.raises(ScenarioError, match="no signal of both runs"):
        compare_runs(a, b)
    with pytest.raises(ScenarioError, match="there is no such run folder"):
        compare_runs(a, tmp_path / "c")


# ---- runs of a scenario -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """An offline run and twins of can.toml and can-classic.toml, 10 s."""
    folder, stop = tmp_path_factory.mktemp("runs"), "run.stop=10"
    offline(TELEOPERATION, folder / "offline", stop)
    for name in ("can", "can-classic"):
        run_twin(named(name, stop), folder / name)
    return folder


@pytest.mark.parametrize("name", ["can", "can-classic"])
def test_a_twin_is_equal_to_the_offline_run_within_a_period(name, runs):
    found = compare_runs(runs / "offline", runs / name)
    assert found.verdict == "equal", found.sentence()
    assert found.period == 5e-3
    assert "one period (5 ms)" in found.sentence()
    assert not found.remarks


def test_a_step_of_the_codec_is_in_the_bound(runs):
    plain = compare_runs(runs / "offline", runs / "offline", ["slave_control.xi[0]"]).signals[0]
    coarse = compare_runs(runs / "offline", runs / "can-classic", ["slave_control.xi[0]"]).signals[
        0
    ]
    assert coarse.bound - plain.bound > 0.9 * 2**-10
    assert coarse.bound_rms - plain.bound_rms > 0.9 * 2**-10


def test_another_seed_is_another_run(runs, tmp_path):
    run_twin(named("can", "run.stop=10", "run.seed=1"), tmp_path / "other")
    found = compare_runs(runs / "can", tmp_path / "other")
    assert found.verdict == "different"
    assert found.exit_code == 1


def test_metrics_that_both_declare_are_compared_with_settle_times(runs, tmp_path):
    found = compare_runs(runs / "offline", runs / "can")
    labels = {m.label: m for m in found.metrics}
    assert {"sync error", "sync error, settles", "operator effort"} <= set(labels)
    effort = labels["operator effort"]
    assert effort.b == pytest.approx(effort.a, rel=0.01)
    offline(TELEOPERATION, tmp_path / "x", SHORT, "metrics.effort.kind=peak")
    assert compare_runs(runs / "offline", tmp_path / "x").metrics == ()


# ---- the command --------------------------------------------------------------------------------


def test_the_command_prints_rows_and_a_verdict_and_exits_by_it(runs, tmp_path):
    out = tmp_path / "diff.json"
    shown = CliRunner().invoke(
        app, [str(runs / "offline"), str(runs / "can"), "master.q", "--json", str(out)]
    )
    assert shown.exit_code == 0, shown.output
    assert "signal       RMS" in shown.output
    assert shown.output.strip().endswith("equal within quantisation and one period (5 ms)")
    data = json.loads(out.read_text())
    assert data["verdict"] == "equal"
    assert {s["name"] for s in data["signals"]} == {"master.q[0]", "master.q[1]"}
    strict = [str(runs / "offline"), str(runs / "can"), "master.q", "--tolerance", "1e-9"]
    assert CliRunner().invoke(app, strict).exit_code == 1


def test_all_signals_are_counted_where_not_all_are_shown(runs):
    found = compare_runs(runs / "offline", runs / "can")
    shown = "\n".join(lines(found))
    assert f"… and {len(found.signals) - 12} signals that differ less" in shown


def test_estimates_that_nobody_is_sent_are_shown_and_not_judged(runs):
    found = compare_runs(runs / "offline", runs / "can")
    judged = {s.name for s in found.signals if s.judged}
    assert {"master.q[0]", "slave.dq[1]", "master_control.tau[0]", "slave_control.xi[1]"} <= judged
    assert not any("theta_hat" in name for name in judged)
    assert any("theta_hat" in s.name for s in found.signals)
    assert [s.judged for s in found.signals] == sorted(
        (s.judged for s in found.signals), reverse=True
    )


@pytest.mark.parametrize("rows", [1, 5])
def test_the_page_of_two_runs_shows_each_where_it_was(tmp_path, rows):
    """Also of runs of one row, which has no step."""
    x = np.arange(float(rows))
    a = made(tmp_path / "a", {"x": x}, h=0.25)
    b = made(tmp_path / "b", {"x": x + 1}, h=0.25)
    text = write_diff_page(compare_runs(a, b), tmp_path / "page.html").read_text(encoding="utf-8")
    assert "a: x" in text and "b: x" in text
    assert "Until" in text and f"{0.25 * (rows - 1):g} s" in text


def test_the_page_has_the_signals_and_then_the_metrics_of_both(runs, tmp_path):
    found = compare_runs(runs / "offline", runs / "can", ["master.q"])
    text = write_diff_page(found, tmp_path / "page.html").read_text(encoding="utf-8")
    signals, metrics = text.index("<h2>Signals</h2>"), text.index("<h2>Metrics</h2>")
    assert signals < text.index("master.q[1]", signals) < metrics
    effort = next(m for m in found.metrics if m.label == "operator effort")
    row = text[text.index("operator effort", metrics) :]
    assert f"{effort.a:.5g}" in row and f"{effort.b:.5g}" in row
    assert f"{effort.b - effort.a:.2g}" in row
