"""FMUs that crash, hang, leak, refuse or print: in this process and isolated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import CosimError, RunError
from cosim.engine.engine import Engine
from cosim.fmi import FmuOptions
from fmus.models import planar2r
from tests.cosim.fmi.exporter import (
    by_command,
    column,
    export,
    nasty2,
    plan_of,
    run,
    stopped_at,
)

CRASH, HANG, NOT_A_NUMBER, LEAK, DISCARD, ERROR, FATAL, EXIT, NO_START, SAY = range(1, 11)


@pytest.fixture(scope="module")
def nasty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(nasty2(), tmp_path_factory.mktemp("fmu") / "nasty2.fmu")


def stopped(path: Path, how: int, **options) -> RunError:
    """The error of a run that goes wrong at tick 3, t = 0.3 s."""
    plan = plan_of(
        path, 10, values={"how": (float(how),), "when": (0.25,)}, options=FmuOptions(**options)
    )
    with pytest.raises(RunError) as caught:
        run(plan)
    error = caught.value
    assert (error.component, error.tick) == ("x", 3)
    assert error.time == pytest.approx(0.3)
    assert str(error).startswith("x: ")
    assert "at tick 3 (t = 0.3 s)" in str(error)
    return error


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(
    ("how", "message"),
    [
        (NOT_A_NUMBER, "not a finite number: x.y = nan"),
        (DISCARD, "doStep returned discard (no step from 0.3 on)"),
        (ERROR, "doStep returned error (no step from 0.3 on)"),
        (FATAL, "doStep returned fatal (no step from 0.3 on)"),
    ],
)
def test_a_step_that_fails_says_so_in_the_same_words(
    nasty: Path, isolate: bool, how: int, message: str
) -> None:
    assert message in str(stopped(nasty, how, isolate=isolate))


@pytest.mark.parametrize(
    ("how", "options", "message"),
    [
        (CRASH, {}, "its process ended in doStep: SIGSEGV (going down at 0.3)"),
        (EXIT, {}, "its process ended in doStep: exit code 7"),
        (HANG, {"timeout": 0.5}, "doStep took longer than 0.5 s and was ended"),
        (LEAK, {"memory": 256}, "doStep returned fatal (no memory left)"),
    ],
)
def test_what_kills_a_process_does_not_kill_the_run(
    nasty: Path, how: int, options: dict, message: str
) -> None:
    assert message in str(stopped(nasty, how, isolate=True, **options))


def test_rows_before_a_crash_are_kept(nasty: Path) -> None:
    plan = plan_of(nasty, 10, values={"how": (float(CRASH),), "when": (0.25,)},
                   options=FmuOptions(isolate=True))  # fmt: skip
    record = np.full((10, plan.n_signals), -1.0)
    with Engine(plan) as engine:
        engine.initialize()
        with pytest.raises(RunError):
            engine.run(10, record)
        assert engine.rows == 4
    assert column(plan, record, "y")[:4].tolist() == pytest.approx([0.0, 1.1, 1.2, 1.3])


def test_a_crash_at_the_start_is_a_sentence(nasty: Path) -> None:
    plan = plan_of(nasty, 1, values={"how": (float(NO_START),)}, options=FmuOptions(isolate=True))
    with pytest.raises(CosimError, match="its process ended in enter_initialization: SIGABRT"):
        run(plan)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_process_of_its_own_gives_the_same_bits(fmi: str) -> None:
    rows = []
    for isolate in (False, True):
        plan = plan_of(planar2r.fmu(fmi), 200, h=0.001, options=FmuOptions(isolate=isolate))  # type: ignore[arg-type]
        tau = np.sin(np.arange(400.0)).reshape(200, 2)
        found, engine = run(plan, {"tau": tau})
        engine.close()
        rows.append(found.tobytes())
    assert rows[0] == rows[1]


@pytest.mark.parametrize("isolate", [False, True])
def test_logging_is_kept_up_to_a_bound(nasty: Path, isolate: bool) -> None:
    options = FmuOptions(log=True, isolate=isolate)
    _, engine = run(plan_of(nasty, 200, values={"how": (float(SAY),)}, options=options))
    engine.close()
    text = engine.logs()["x"]
    assert text.startswith("[ok] logAll: x is made\n[warning] chat: one of many lines")
    assert 2**19 < len(text) < 2**21
    assert "lines left out; the last ones:" in text
    assert text.endswith("when it is told 99\n")


def test_without_logging_nothing_is_kept(nasty: Path) -> None:
    _, engine = run(plan_of(nasty, 1))
    engine.close()
    assert engine.logs() == {}


def test_two_isolated_instances_know_nothing_of_each_other(nasty: Path) -> None:
    found = []
    engines = []
    for value in (1.0, 2.0):
        plan = plan_of(nasty, 3, start={"u": (value,)}, options=FmuOptions(isolate=True))
        rows, engine = run(plan)
        engines.append(engine)
        found.append(column(plan, rows, "y")[-1])
    for engine in engines:
        engine.close()
    assert found[1] == 2 * found[0]


def test_one_instance_per_process_can_be_several(tmp_path: Path) -> None:
    once = nasty2('canBeInstantiatedOnlyOncePerProcess="true"')
    path = export(once, tmp_path / "once.fmu")
    engines = [run(plan_of(path, 1))[1] for _ in range(2)]
    for engine in engines:
        engine.close()


def test_sources_are_built_when_asked_for(tmp_path: Path) -> None:
    path = export(nasty2(), tmp_path / "sources.fmu", sources=True)
    with pytest.raises(CosimError, match=r"could be built: build = true"):
        run(plan_of(path, 1))
    rows, engine = run(plan_of(path, 2, options=FmuOptions(build=True)))
    engine.close()
    assert rows.shape[0] == 3


def test_sources_that_do_not_build_are_a_sentence(tmp_path: Path) -> None:
    listed = nasty2().replace("/>", '><SourceFiles><File name="gone.c"/></SourceFiles>'
                              "</CoSimulation>", 1)  # fmt: skip
    path = export(listed, tmp_path / "gone.fmu", sources=True)
    with pytest.raises(CosimError, match=r"lists the source 'gone\.c', which is not there"):
        run(plan_of(path, 1, options=FmuOptions(build=True)))


def test_the_command_survives_a_crash_and_says_where_the_data_is(nasty: Path) -> None:
    """Statuses reach the user: exit code, component, time (one process, through the command)."""
    folder = nasty.parent
    scenario = folder / "bad.toml"
    scenario.write_text(
        '[run]\nstep = 0.1\nstop = 1.0\n[components.x]\nmodel = "nasty2.fmu"\n'
        f"[components.x.parameters]\nhow = {ERROR}\nwhen = 0.25\n",
        encoding="utf-8",
    )
    done = by_command(folder)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "x: doStep returned error (no step from 0.3 on) at tick 3 (t = 0.3 s)" in done.stderr
    assert "RunError" in json.loads((folder / "here" / "run.json").read_text())["error"]


def test_a_step_that_hangs_can_be_stopped(nasty: Path) -> None:
    """Ctrl-C asks the engine to stop: the FMU gets a moment more, then the run ends."""
    plan = plan_of(nasty, 10, values={"how": (float(HANG),), "when": (0.25,)},
                   options=FmuOptions(isolate=True))  # fmt: skip
    with Engine(plan) as engine:
        engine.initialize()
        with (
            stopped_at(engine, 3),
            pytest.raises(RunError, match="doStep was stopped and was ended"),
        ):
            engine.run(10)  # the step of tick 3 hangs
