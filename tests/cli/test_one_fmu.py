"""``cosim run X.fmu``: an FMU as a scenario of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.loading.files import load
from cosim.record import Run
from fmus.models import operator
from tests.cli.command import Command
from tests.cosim.fmi import plain
from tests.cosim.fmi.exporter import export, strict2, strict3

EXPERIMENT = '<DefaultExperiment stopTime="2" stepSize="0.25" tolerance="1e-5"/><ModelVariables>'


def exported(name: str, text: str) -> Path:
    return export(text.replace("<ModelVariables>", EXPERIMENT), Path(name))


@pytest.mark.parametrize("text", [strict2(), strict3()], ids=["2.0", "3.0"])
def test_an_fmu_runs_as_its_default_experiment_says(cosim: Command, text: str) -> None:
    exported("x.fmu", text)
    done = cosim("run", "x.fmu", "--no-plot", "--out", "run", "--set", "gain=5", "--set", "x=7")
    assert done.code == 0, done.err
    run = Run.open("run")
    assert run.t.tolist() == [0.25 * k for k in range(9)]
    assert run.column("strict2.y" if "strict2" in text else "strict3.y")[0] == 7.0


@pytest.mark.parametrize(
    ("settings", "step", "stop"),
    [
        ([], 0.25, 2.0),
        (["run.stop=10"], 0.25, 10.0),
        (["run.stop=0.1"], 0.1, 0.1),
        (["run.stop=0.6"], 0.2, 0.6),  # three steps of 0.2 s: 0.6 s are no multiple of 0.25 s
        (["run.step=0.5"], 0.5, 2.0),
        (["run.stop=1 s"], 0.25, "1 s"),
    ],
)
def test_the_step_divides_the_stop_time(
    cosim: Command, settings: list[str], step: float, stop: float | str
) -> None:
    exported("x.fmu", strict2())
    run = load("x.fmu", settings).run
    assert (run.step, run.stop) == (pytest.approx(step), stop)


@pytest.mark.parametrize(("stop", "step"), [("1", 0.002), ("3", 0.005), ("0.7", 0.001)])
def test_an_fmu_that_states_no_step_gets_about_500(cosim: Command, stop: str, step: float) -> None:
    export(strict2(), Path("x.fmu"))
    assert load("x.fmu").run.stop == 1.0
    assert load("x.fmu", [f"run.stop={stop}"]).run.step == pytest.approx(step)


def test_the_start_time_is_an_option(cosim: Command) -> None:
    exported("x.fmu", strict2())
    done = cosim("run", "x.fmu", "--start", "1500 ms", "--no-plot", "--out", "run")
    assert done.code == 0, done.err
    assert "2 ticks of 250 ms from 1.5 s on" in done.out
    assert Run.open("run").t.tolist() == [1.5, 1.75, 2.0]


def test_the_stop_time_is_an_option(cosim: Command) -> None:
    exported("x.fmu", strict2())
    assert cosim("run", "x.fmu", "--stop", "500 ms", "--no-plot", "--out", "run").code == 0
    assert Run.open("run").t[-1] == 0.5
    assert "run.stop" in cosim.refused("run", "x.fmu", "--stop", "soon")


def test_what_the_fmu_does_not_have_is_refused(cosim: Command) -> None:
    exported("x.fmu", strict2())
    assert "gain" in cosim.refused("run", "x.fmu", "--set", "gian=5")
    assert "expected path=value" in cosim.refused("run", "x.fmu", "--set", "gain")


def test_other_commands_take_an_fmu_as_well(cosim: Command) -> None:
    path = operator.fmu("2.0")
    assert cosim("show", path).code == 0
    assert cosim("check", path).code == 0


def test_a_table_feeds_the_inputs(cosim: Command) -> None:
    exported("x.fmu", strict2())
    Path("u.csv").write_text("time,u,other\n0,0,1\n1,4,1\n")
    done = cosim("run", "x.fmu", "--input", "u.csv", "--no-plot", "--out", "run", "--record", "all")
    assert (done.code, done.err) == (0, "")
    run = Run.open("run")
    assert run.column("strict2.u").tolist() == [0, 0, 1, 2, 3, 4, 4, 4, 4]  # the last one used
    assert run.column("strict2.gain").tolist() == [2.0] * 9
    Path("w.csv").write_text("t,w\n0,1\n")
    said = cosim.refused("run", "x.fmu", "--input", "w.csv")
    assert "no column is an input of x.fmu; it has u, the file has w" in said


def test_a_table_is_for_an_fmu_alone(cosim: Command) -> None:
    Path("x.toml").write_text("")
    assert 'inputs.INPUT = { table = "FILE" }' in cosim.refused("run", "x.toml", "--input", "u.csv")


def test_an_fmu_without_outputs_says_what_is_recorded(cosim: Command) -> None:
    exported("x.fmu", strict2().replace('causality="output"', 'causality="local"'))
    assert "only the time is recorded" in cosim("run", "x.fmu", "--no-plot", "--out", "a").err
    assert Run.open("a").names == ()
    done = cosim("run", "x.fmu", "--no-plot", "--out", "b", "--record", "strict2.?")
    assert done.err == "" and Run.open("b").names == ("strict2.u", "strict2.x", "strict2.y")


def test_what_is_recorded_may_be_named_without_the_component(cosim: Command) -> None:
    exported("x.fmu", strict2())
    for out, given, names in (
        ("a", "x", ("strict2.x",)), ("b", "?", ("strict2.u", "strict2.x", "strict2.y")),
        ("c", "strict2.gain", ("strict2.gain",)),
    ):  # fmt: skip
        cosim("run", "x.fmu", "--no-plot", "--out", out, "--record", given)
        assert Run.open(out).names == names
    assert "no signal 'nothing'" in cosim.refused("run", "x.fmu", "--record", "nothing")


def test_events_are_set_on_the_command_line_with_names_of_the_fmu(cosim: Command) -> None:
    exported("x.fmu", strict2())
    events = 'events=[{at="0.2 s", set={u=2.0}}, {at=0.5, set={"strict2.rate"=1.0}}]'
    cosim("run", "x.fmu", "--stop", "1", "--set", "run.step=0.1", "--set", events, "--no-plot",
          "--out", "a")  # fmt: skip
    y = Run.open("a").column("strict2.y")
    assert y[-1] == pytest.approx(1.0 + 2.0 * 2.0 * 0.8 + 0.5)
    assert "no input of strict2 'gain'" in cosim.refused(
        "run", "x.fmu", "--set", "events=[{at=0.2, set={gain=2.0}}]"
    )


def test_an_fmu_that_changes_the_directory_does_not_move_the_results(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plain.export(Path("wanders.fmu"), plain.counted(), {"CHDIR": None})
    done = cosim(
        "run",
        "wanders.fmu",
        "--stop",
        "0.2",
        "--no-plot",
        "--out",
        "out9",
        "--json",
        "out9.json",
        "--csv",
    )
    assert done.code == 0, done.err
    assert Path.cwd() == tmp_path
    assert Run.open(tmp_path / "out9").t[-1] == 0.2
    assert {p.name for p in tmp_path.iterdir()} == {"out9", "out9.json", "wanders.fmu"}
    assert not Path("/out9").exists()
    assert "out9" in done.out and str(tmp_path) not in done.out
