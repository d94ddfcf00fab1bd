"""FMUs in processes of their own: how the two sides wake each other, several at once, the end.

What an isolated FMU may do wrong is in ``test_bad_behaviour.py``.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from time import sleep

import numpy as np
import pytest

from cosim.base.errors import FmuError, RunError
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.file.intervals import Interval, fraction
from cosim.fmi.isolation import protocol, remote
from cosim.fmi.layout import StepLayout
from cosim.fmi.library import Setup
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan, compile_plan
from fmus.models import planar2r
from tests.children import fork
from tests.cosim.fmi.exporter import export, nasty2, plan_of, run, strict2, strict3

HANG, DISCARD = 2, 5
RETURNS, ENDS = 5, 6  # of strict3.c
WAYS = pytest.mark.parametrize("bytes_wake", [False, True], ids=["futex", "pipe"])


@pytest.fixture(scope="module")
def nasty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(nasty2(), tmp_path_factory.mktemp("fmu") / "nasty2.fmu")


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(strict3(), tmp_path_factory.mktemp("fmu") / "strict3.fmu")


def pid_of(engine: Engine, index: int = 0) -> int:
    component = engine.plan.components[index].component
    assert isinstance(component, FmuComponent) and component.remote is not None
    return component.remote.pid


def several(
    path: Path, values: Sequence[dict[str, float]], isolate: bool, h: float = 0.1, period: int = 1
) -> Plan:
    """FMUs `x0`, `x1` and so on whose steps follow each other, as nothing connects them."""
    steps, at = [], 0
    for i, some in enumerate(values):
        name = f"x{i}"
        component = FmuComponent(path, name, None, FmuOptions(isolate=isolate))
        sides = []
        for ports in (component.inputs, component.outputs):
            sides.append([])
            for p in ports:
                sides[-1].append(Slot(f"{name}.{p.name}", name, p.name, at, p.shape, p.unit))
                at += p.size
        given = {k: (float(v),) for k, v in some.items()}
        start = {"u": (i + 1.0,)}
        steps.append(Step(name, component, "continuous", period, given, *map(tuple, sides), start))
    return compile_plan(h, 10, steps, [], [])


@WAYS
def test_both_ways_of_waking_give_the_same_bits(monkeypatch, bytes_wake: bool) -> None:
    monkeypatch.setattr(remote, "BYTES_WAKE", bytes_wake)
    rows = []
    for isolate in (False, True):
        plan = plan_of(planar2r.fmu("3.0"), 300, h=0.001, options=FmuOptions(isolate=isolate))
        found, engine = run(plan, {"tau": np.cos(np.arange(600.0)).reshape(300, 2)})
        engine.close()
        rows.append(found.tobytes())
    assert rows[0] == rows[1]


@WAYS
@pytest.mark.parametrize("processors", [1, 2])
def test_a_slow_step_is_waited_for_asleep(nasty, monkeypatch, bytes_wake, processors) -> None:
    """Also on one processor, where a side that waits takes it from the other."""
    if processors > len(os.sched_getaffinity(0)):
        pytest.skip("fewer processors")
    monkeypatch.setattr(remote, "BYTES_WAKE", bytes_wake)
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[:processors]))
    try:
        _, engine = run(plan_of(nasty, 300, options=FmuOptions(isolate=True)))
        engine.close()
    finally:
        os.sched_setaffinity(0, before)


@WAYS
def test_a_process_that_stands_still_for_more_than_a_second_is_waited_for(
    nasty: Path, monkeypatch, bytes_wake: bool
) -> None:
    """Only who is told to stop waits for no more than that."""
    monkeypatch.setattr(remote, "BYTES_WAKE", bytes_wake)
    with Engine(plan_of(nasty, 10, options=FmuOptions(isolate=True))) as engine:
        engine.initialize()
        engine.run(2)
        os.kill(pid_of(engine), signal.SIGSTOP)
        threading.Timer(1.3, os.kill, (pid_of(engine), signal.SIGCONT)).start()
        engine.run(1)
        assert engine.tick == 3


@WAYS
def test_a_killed_process_is_a_sentence(nasty: Path, monkeypatch, bytes_wake: bool) -> None:
    """In the middle of a step, and while nothing is asked of it."""
    monkeypatch.setattr(remote, "BYTES_WAKE", bytes_wake)
    values = {"how": (float(HANG),), "when": (0.25,)}
    with Engine(plan_of(nasty, 10, values=values, options=FmuOptions(isolate=True))) as engine:
        engine.initialize()

        def kill() -> None:
            while engine.tick < 3:
                sleep(0.01)
            os.kill(pid_of(engine), signal.SIGKILL)

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        with pytest.raises(RunError, match=r"x: its process ended in doStep: SIGKILL .* at tick 3"):
            engine.run(10)
        thread.join()
    with Engine(plan_of(nasty, 10, options=FmuOptions(isolate=True))) as engine:
        engine.initialize()
        engine.run(2)
        os.kill(pid_of(engine), signal.SIGKILL)
        with pytest.raises(RunError, match=r"its process ended in doStep: SIGKILL .* at tick 2"):
            engine.run(1)


@WAYS
def test_a_process_ends_with_the_run_that_is_killed(nasty, monkeypatch, bytes_wake, tmp_path):
    """Its pipe is closed then, which is all it has to hear."""
    monkeypatch.setattr(remote, "BYTES_WAKE", bytes_wake)

    def killed() -> int:
        _, engine = run(plan_of(nasty, 1, options=FmuOptions(isolate=True)))
        (tmp_path / "pid").write_text(str(pid_of(engine)))
        os.kill(os.getpid(), signal.SIGKILL)
        return 0

    os.waitpid(fork(killed), 0)
    pid = int((tmp_path / "pid").read_text())
    for _ in range(200):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().split()[2]
        except FileNotFoundError:
            return
        if state == "Z":
            return
        sleep(0.05)
    raise AssertionError("it still runs")


@pytest.mark.parametrize("period", [1, 2])
def test_several_are_stepped_together_and_each_gets_its_own(strict: Path, period: int) -> None:
    found = []
    for isolate in (False, True):
        gains = [{"gain": 2 + i} for i in range(10)]  # more than AT_ONCE
        plan = several(strict, gains, isolate, period=period)
        record = np.zeros((10, plan.n_signals))
        with Engine(plan) as engine:
            engine.initialize()
            engine.run(10, record)
        found.append(record.tobytes())
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([{}, {"how": RETURNS, "status": 3, "when": 0.25}, {}], r"x1: doStep returned error"),
        ([{"how": ENDS, "when": 0.25}, {"how": RETURNS, "status": 3, "when": 0.25}, {}],
         r"x1: doStep returned error"),
        ([{"how": RETURNS, "status": 3, "when": 0.25}, {"how": RETURNS, "status": 4, "when": 0.25}],
         r"x0: doStep returned error"),
    ],
)  # fmt: skip
@pytest.mark.parametrize(("period", "tick"), [(1, 3), (2, 5)])
def test_of_several_the_one_that_fails_is_named(strict, values, message, period, tick) -> None:
    with Engine(several(strict, values, isolate=True, period=period)) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=f"{message} .* at tick {tick}"):
            engine.run(10)


@pytest.mark.parametrize("isolate", [False, True])
def test_of_several_the_one_whose_output_is_no_number_is_named(strict, isolate: bool) -> None:
    plan = several(strict, [{}, {"gain": 1.7e308}, {}], isolate)
    with Engine(plan) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"x1: .* at tick 0"):
            engine.run(10)


@pytest.mark.parametrize("isolate", [False, True])
def test_one_of_several_that_ends_the_simulation_lets_the_others_finish(strict, isolate) -> None:
    plan = several(strict, [{}, {"how": ENDS, "when": 0.25}, {}], isolate)
    record = np.zeros((10, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        assert engine.run(10, record) == 4
        assert engine.ended is not None and engine.ended.component == "x1"
        last = {n: float(engine.signals[s.start]) for n, s in plan.slots().items()}
    assert last["x0.y"] == pytest.approx(1.0 + 2.0 * 1.0 * 0.4)  # four steps each, none twice
    assert last["x2.y"] == pytest.approx(1.0 + 2.0 * 3.0 * 0.4)


def test_the_process_loads_little() -> None:
    """What it imports is most of the time that it takes to start."""
    code = "import sys, cosim.fmi.isolation.worker; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "cosim.fmi.component", "subprocess"} & set(done.stdout.split())


# ---- messages -----------------------------------------------------------------------------------


def test_messages_have_types() -> None:
    setup = Setup("2.0", Path("/a b/c.so"), "x", "t", Path("/r"), tolerance=1e-6)
    assert protocol.requested(protocol.request("start", (setup, 5, 0))) == ("start", (setup, 5, 0))
    layout = StepLayout(0.1, 0, 1, 0, 1, 1, 1, (), ())
    assert protocol.requested(protocol.request("bind", (layout,)))[1] == (layout,)
    intervals = {3: Interval(0.5, 0.0), 4: fraction(1, 2, 30)}
    assert protocol.answered("intervals", protocol.answer(intervals)) == intervals
    assert protocol.answered("terminated", protocol.answer(None)) is None
    with pytest.raises(FmuError, match="it says no"):
        protocol.answered("setup", protocol.refusal("it says no"))


@pytest.mark.parametrize("name", ["__init__", "_types", "system", "log"])
def test_nothing_but_the_calls_of_an_instance_is_executed(name: str) -> None:
    with pytest.raises(FmuError, match="no call"):
        protocol.requested(name.encode() + b"\0\x90")


def test_an_argument_of_another_type_is_refused() -> None:
    import msgspec

    with pytest.raises(msgspec.ValidationError):
        protocol.requested(protocol.request("setup", ("now",)))


def test_an_fmu_of_fmi_2_that_hears_of_its_own_error_is_not_terminated(tmp_path, monkeypatch):
    path = tmp_path / "calls"
    monkeypatch.setenv("STRICT_CALLS", str(path))
    fmu = export(strict2(), tmp_path / "x.fmu")
    with Engine(several(fmu, [{"how": RETURNS, "status": 3, "when": 0.0}], True)) as engine:
        engine.initialize()
        with pytest.raises(RunError):
            engine.run(1)
    assert path.read_text().splitlines()[-1] == "FreeInstance"


def _held() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("fails", [False, True])
def test_nothing_stays_open_after_the_end(nasty, fails: bool) -> None:
    """Its memory has a descriptor, and so have the two pipes: a study has thousands of them."""
    kept, before = [], _held()
    gc.disable()
    try:
        for _ in range(3):
            plan = plan_of(nasty, 3, options=FmuOptions(isolate=True))
            with Engine(plan) as engine:
                engine.initialize()
                if fails:
                    os.kill(pid_of(engine), signal.SIGKILL)
                with pytest.raises(RunError) if fails else nullcontext():
                    engine.run(1)
            kept.append(engine)  # as the traceback of an error would hold it
        assert _held() == before
    finally:
        gc.enable()
