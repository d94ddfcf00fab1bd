"""``cosim run X.fmu``: an FMU as a scenario of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.loading.files import load
from cosim.record import Run
from fmus.models import operator
from tests.cli.command import Command
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
