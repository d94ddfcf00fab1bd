"""FMUs in WebAssembly that loop, crash, exit, or reach for what is not theirs."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("wasmtime")

from cosim.base.errors import FmuError, RunError
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent, FmuOptions
from cosim.sandbox.instances import GUESTS
from tests.cosim.fmi.exporter import by_command, column, plan_of, run, stopped_at
from tests.cosim.sandbox.exporter import hostile

LOOP, WILD, EXIT, ABORT, RECURSION, BIG_FRAMES, HUGE, READ, WRITE, CALL, ASK, LIE = range(1, 13)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile(tmp_path_factory.mktemp("fmu") / "hostile3.fmu")


def plan(path: Path, how: int, **options):
    return plan_of(path, 6, values={"how": (float(how),), "when": (0.25,)},
                   options=FmuOptions(**options))  # fmt: skip


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize(
    ("how", "options", "message"),
    [
        (LOOP, {"timeout": 0.3}, "doStep took longer than 0.3 s and was ended (last words)"),
        (WILD, {}, "doStep touched memory that is not its own (last words)"),
        (EXIT, {}, "doStep tried to end the process, with exit code 7 (last words)"),
        (ABORT, {}, "doStep gave up: it called abort or trapped itself (last words)"),
        (RECURSION, {}, "doStep used up its stack (last words)"),
        (BIG_FRAMES, {}, "doStep touched memory that is not its own (last words)"),
        (HUGE, {"memory": 128}, "doStep returned fatal (last words)"),
        (CALL, {}, "doStep called a function that is none (last words)"),
        (LIE, {}, "doStep returned fatal (last words)"),
    ],
)
def test_each_ends_as_a_named_failure_and_rows_before_it_are_kept(
    path: Path, how: int, options: dict, message: str, isolate: bool
) -> None:
    found = plan(path, how, isolate=isolate, **options)
    record = np.full((6, found.n_signals), -1.0)
    with Engine(found) as engine:
        engine.initialize()
        with pytest.raises(RunError) as caught:
            engine.run(6, record)
        assert engine.rows == 4
    assert message in str(caught.value)
    assert "at tick 3 (t = 0.3 s)" in str(caught.value)
    assert column(found, record, "y")[:4].tolist() == pytest.approx([0.0, 1.0, 1.1, 1.2])


@pytest.mark.parametrize("how", [READ, WRITE, ASK])
def test_nothing_of_the_host_is_there(path: Path, how: int) -> None:
    """No file to read or to write, and no environment."""
    found = plan(path, how)
    rows, engine = run(found)
    engine.close()
    assert column(found, rows, "y")[-1] == -1.0
    assert not Path("/tmp/written-by-an-fmu").exists()


def test_one_that_crashes_leaves_the_memory_of_another_alone(path: Path) -> None:
    good = Engine(plan(path, 0))
    good.initialize()
    for how in (WILD, RECURSION, ABORT):
        with Engine(plan(path, how)) as bad:
            bad.initialize()
            with pytest.raises(RunError):
                bad.run(6)
    good.run(6)
    assert good.signals[1] == pytest.approx(1.5)
    good.close()
    assert not GUESTS


def test_memory_is_given_back(path: Path) -> None:
    for _ in range(50):
        _, engine = run(plan(path, 0, memory=64))
        engine.close()
    assert not GUESTS
    assert not [t for t in threading.enumerate() if t.name == "wasm epochs" and not t.daemon]


def test_a_step_that_hangs_can_be_stopped(path: Path) -> None:
    """Ctrl-C asks the engine to stop: the FMU gets a moment more, then the run ends."""
    with Engine(plan(path, LOOP)) as engine:
        engine.initialize()
        with (
            stopped_at(engine, 3),
            pytest.raises(RunError, match="doStep was stopped and was ended"),
        ):
            engine.run(6)


def test_the_command_ends_with_the_sentence_and_its_data(path: Path) -> None:
    folder = path.parent
    (folder / "bad.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1.0\n[components.plant]\nmodel = "hostile3.fmu"\n'
        f'isolate = "wasm"\ntimeout = "300 ms"\nparameters = {{ how = {LOOP}, when = 0.25 }}\n',
        encoding="utf-8",
    )
    done = by_command(folder)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "plant: doStep took longer than 0.3 s and was ended (last words)" in done.stderr
    assert "at tick 3 (t = 0.3 s)" in done.stderr
    assert "RunError" in json.loads((folder / "here" / "run.json").read_text())["error"]


def test_a_file_that_is_no_component_is_a_sentence(path: Path, tmp_path: Path) -> None:
    import zipfile

    broken = tmp_path / "broken.fmu"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(broken, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, content[:500] if name.endswith(".wasm") else content)
    component = FmuComponent(broken, "x")
    with pytest.raises(FmuError, match=r"x: .*hostile3\.wasm is no WebAssembly component"):
        component.initialize({})
