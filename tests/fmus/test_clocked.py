"""Sampled models as clocked partitions (FMI 3.0.2 §2.2.8): driven by FMPy, and by the engine."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from ctypes import c_bool, c_double, c_int, c_uint32
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from cosim.base.errors import CosimError, FmuError
from fmus.build.archive import find, pack, shipped_models, versions
from fmus.build.description3 import describe
from fmus.build.kernel import Kernel
from fmus.build.library import compile_model
from fmus.cli import app
from fmus.model import Model, clocked
from fmus.models import nuno_adaptive, pd, planar2r, teleoperation
from tests.system.runs import SIDES, Document, plan, signals
from tests.system.runs import teleoperation as document_of

P = 5e-3  # s
PD = clocked(pd.model(), P)
FEW = ("pd", "nuno_adaptive", "minimum_jerk", "teleoperation_n2")
#: All sampled models; each takes a second to compile.
SAMPLED = [
    pytest.param(m, id=m.identifier, marks=() if m.identifier in FEW else pytest.mark.slow)
    for m in shipped_models()
    if m.kind == "sampled"
]
Inputs = dict[str, np.ndarray]


class Ticked:
    """A clocked FMU driven by FMPy; `said` is what it logs."""

    def __init__(self, model: Model, *, name: str = "it", events: bool = True) -> None:
        path = find(model, "3.0")
        description = read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.model, self.said, self.t, self.started = model, [], 0.0, False
        self.fmu = FMU3Slave(
            guid=description.guid,
            unzipDirectory=extract(str(path)),
            modelIdentifier=model.identifier,
            instanceName=name,
        )
        self.fmu.instantiate(
            loggingOn=True, eventModeUsed=events, logMessage=lambda *a: self.said.append(a[3])
        )
        self.fmu.enterInitializationMode()

    def start(self) -> Ticked:
        self.fmu.exitInitializationMode()
        self.started = True
        return self

    def set(self, u: Inputs) -> None:
        for name, value in u.items():
            self.fmu.setFloat64([self.references[name]], list(np.ravel(value)))

    def get(self) -> Inputs:
        return {
            p.name: np.array(
                self.fmu.getFloat64([self.references[p.name]], nValues=int(np.prod(p.shape)))
            ).reshape(p.shape)
            for p in self.model.outputs()
        }

    def tick(self) -> None:
        self.fmu.setClock([self.references["clock"]], [True])

    def end(self) -> None:
        self.fmu.updateDiscreteStates()
        self.fmu.enterStepMode()

    def step(self, h: float) -> None:
        self.fmu.doStep(self.t, h)
        self.t += h

    def refusal(self, call: Callable[[], object]) -> str:
        self.said.clear()
        with pytest.raises(FMICallException):
            call()
        return str(self.said[-1])

    def free(self) -> None:
        if self.started:
            self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture
def ticked() -> Iterator[Callable[..., Ticked]]:
    made: list[Ticked] = []

    def make(model: Model = PD, **keys: object) -> Ticked:
        made.append(Ticked(model, **keys))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for each in made:
        each.free()


def drawn(model: Model, seed: int) -> Inputs:
    random = np.random.default_rng(seed)
    return {p.name: random.uniform(-1.0, 1.0, p.shape) for p in model.inputs()}


def same(found: Inputs, expected: Inputs) -> None:
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


# --- what it says of itself ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("model", SAMPLED)
def test_fmpy_finds_no_problem(model: Model) -> None:
    assert validate_fmu(str(find(clocked(model, model.step), "3.0"))) == []


@pytest.mark.slow
@pytest.mark.parametrize("model", SAMPLED)
def test_a_second_checker_finds_nothing(model: Model) -> None:
    check = "from fmu_manipulation_toolbox.cli.fmutool import fmutool; fmutool()"
    path = find(clocked(model, model.step), "3.0")
    command = [sys.executable, "-c", check, "-input", str(path), "-check"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    said = result.stdout + result.stderr
    assert result.returncode == 0, said
    assert "compliant with FMI-3.0" in said, said
    assert "No semantic error against the FMI-3 standard" in said, said


def test_everything_but_parameters_is_clocked() -> None:
    model = clocked(nuno_adaptive.model(), 2e-3)
    clock = describe(model).find("ModelVariables/Clock")
    assert clock is not None
    assert (clock.get("intervalVariability"), clock.get("intervalDecimal")) == ("constant", "0.002")
    description = read_model_description(str(find(model, "3.0")))
    assert description.coSimulation.hasEventMode
    for v in description.modelVariables:
        clocks = [c.name for c in v.clocks or []]
        assert clocks == (["clock"] if v.causality in ("output", "local") or (
            v.causality == "input" and v.type != "Clock"
        ) else []), v.name  # fmt: skip


# --- driven by another importer: the kernel's numbers --------------------------------------------


@pytest.mark.parametrize("model", SAMPLED)
def test_ticks_are_the_kernels_steps(model: Model, ticked: Callable[..., Ticked]) -> None:
    partition, kernel = ticked(clocked(model, P)), Kernel(model)
    kernel.initialize({})
    first = drawn(model, 0)
    partition.set(first)
    same(partition.get(), kernel.initial(first))
    partition.start().end()
    for k in range(60):
        u = drawn(model, 1 + k)
        partition.fmu.enterEventMode()
        partition.tick()
        partition.set(u)
        found, expected = partition.get(), kernel.step(k * P, P, u)
        same(found, expected)
        partition.end()
        partition.t = k * P
        partition.step(P)
        same(partition.get(), expected)  # held


def test_the_first_tick_may_come_in_the_event_mode_after_initialization(ticked) -> None:
    partition, u = ticked().start(), drawn(pd.model(), 3)
    partition.tick()
    partition.set(u)
    kernel = pd.kernel()
    kernel.initialize({})
    same(partition.get(), kernel.step(0.0, P, u))
    partition.end()
    partition.step(P)


@given(tries=st.lists(st.integers(0, 9), min_size=1, max_size=6), seen=st.booleans())
def test_only_the_last_inputs_of_a_tick_count(tries: list[int], seen: bool) -> None:
    """An importer that solves a loop sets and gets until it is content; states advance once."""
    model = nuno_adaptive.model()
    partition, kernel = Ticked(clocked(model, P)).start(), nuno_adaptive.kernel()
    kernel.initialize({})
    for k in range(3):
        partition.tick()
        for seed in tries:
            partition.set(drawn(model, 10 * k + seed))
            if seen:
                partition.get()
        expected = kernel.step(k * P, P, drawn(model, 10 * k + tries[-1]))
        same(partition.get(), expected)
        partition.end()
        partition.step(P)
        partition.fmu.enterEventMode()
    partition.free()


def test_two_periods_and_several_instances_are_on_their_own(ticked) -> None:
    model = nuno_adaptive.model()
    fast, slow = clocked(model, P), clocked(model, 4 * P)
    assert find(fast, "3.0") != find(slow, "3.0")
    pairs = [(ticked(m, name=f"i{n}"), Kernel(model), m) for n, m in enumerate((fast, slow, fast))]
    for partition, kernel, _ in pairs:
        kernel.initialize({})
        partition.start().end()
    for k in range(12):
        for n, (partition, kernel, m) in enumerate(pairs):
            if k % round(m.clock / P) == 0:
                u = drawn(model, 100 * n + k)
                partition.fmu.enterEventMode()
                partition.tick()
                partition.set(u)
                same(partition.get(), kernel.step(k * P, m.clock, u))
                partition.end()
            partition.t = k * P
            partition.step(P)


@pytest.mark.parametrize("steps", [1, 4])
@pytest.mark.parametrize("h", [P, P / 4, 3 * P])
def test_without_event_mode_steps_make_the_ticks(ticked, h: float, steps: int) -> None:
    """An importer without clocks: inputs are sampled at the ticks, whatever its step."""
    model = nuno_adaptive.model()
    partition, kernel = ticked(clocked(model, P), events=False).start(), Kernel(model)
    kernel.initialize({})
    done = 0
    for i in range(steps):
        u = drawn(model, i)
        partition.set(u)
        partition.t = i * h
        partition.step(h)
        expected = None
        while done * P < (i + 1) * h - 1e-9:
            expected = kernel.step(done * P, P, u)
            done += 1
        if expected is not None:
            same(partition.get(), expected)


def test_fmpys_own_loop_runs_it() -> None:
    """simulate_fmu ticks no clocks: the FMU does."""
    path = str(find(clocked(pd.model(), P), "3.0"))
    result = simulate_fmu(path, stop_time=0.1, output_interval=P, start_values={"q_j": [1.0, 2.0]})
    np.testing.assert_array_equal(result["tau"][-1], [10.0, 20.0])


# --- saved states --------------------------------------------------------------------------------


@pytest.mark.parametrize("serialized", [False, True])
@pytest.mark.parametrize("active", [False, True])
def test_a_saved_state_goes_on_from_there(ticked, active: bool, serialized: bool) -> None:
    model = nuno_adaptive.model()
    one, other = ticked(clocked(model, P)).start(), ticked(clocked(model, P))
    one.tick()
    one.set(drawn(model, 1))
    if active:
        one.get()
    else:
        one.end()
        one.step(P)
    state = one.fmu.getFMUState()
    bytes_ = one.fmu.serializeFMUState(state)

    def go_on(x: Ticked) -> Inputs:
        x.t = 0.0 if active else P
        for k in range(3):
            if k or not active:
                x.fmu.enterEventMode()
                x.tick()
            x.set(drawn(model, 10 + k))
            x.end()
            x.step(P)
        return x.get()

    first = go_on(one)
    again = other if serialized else one
    taken = again.fmu.deserializeFMUState(bytes_) if serialized else state
    again.fmu.setFMUState(taken)
    same(go_on(again), first)
    one.fmu.freeFMUState(state)


# --- refusals ------------------------------------------------------------------------------------


def test_what_does_not_fit_the_clock_is_refused_with_a_sentence(ticked) -> None:
    x, u = ticked().start(), drawn(pd.model(), 0)
    clock, q = x.references["clock"], x.references["q"]
    assert "inputs are clocked: set them in Event Mode, after fmi3SetClock" in x.refusal(
        lambda: x.set(u)
    )
    assert f"value reference {q} is no clock, expected {clock}" in x.refusal(
        lambda: x.fmu.setClock([q], [True])
    )
    assert f"value reference {clock} is the clock" in x.refusal(lambda: x.fmu.getFloat64([clock]))
    x.tick()
    assert "the clock is active, fmi3UpdateDiscreteStates comes first" in x.refusal(
        x.fmu.enterStepMode
    )
    assert "cannot be deactivated" in x.refusal(lambda: x.fmu.setClock([clock], [False]))
    x.set({"q": np.array([np.nan, 0.0])})
    assert "input q[0] is nan" in x.refusal(x.get)
    x.set(u)
    x.end()
    assert "it ticks every 0.005 s" in x.refusal(lambda: x.step(2 * P))
    assert "fmi3SetClock: not allowed in Step Mode, expected: Event Mode" in x.refusal(x.tick)
    x.step(0.4 * P)
    x.fmu.enterEventMode()
    assert "the clock ticks every 0.005 s, next at t = 0.005" in x.refusal(x.tick)


def test_the_interval_is_constant(ticked) -> None:
    x = ticked().start()
    clock = (c_uint32 * 1)(x.references["clock"])
    interval, qualifier = (c_double * 1)(), (c_int * 1)()
    x.fmu.fmi3GetIntervalDecimal(x.fmu.component, clock, 1, interval, qualifier)
    assert (interval[0], qualifier[0]) == (P, 1)  # unchanged
    x.fmu.fmi3GetShiftDecimal(x.fmu.component, clock, 1, interval)
    assert interval[0] == 0.0
    assert "the interval of the clock is constant" in x.refusal(
        lambda: x.fmu.fmi3SetIntervalDecimal(x.fmu.component, clock, 1, interval)
    )
    flags = (c_bool * 1)(True)
    x.fmu.fmi3GetClock(x.fmu.component, clock, 1, flags)
    assert not flags[0]


def test_no_clock_may_be_asked_for_with_null_pointers(ticked) -> None:
    x = ticked().start()
    x.fmu.fmi3GetClock(x.fmu.component, None, 0, None)
    x.fmu.fmi3SetClock(x.fmu.component, None, 0, None)
    for references, values in ((None, (c_bool * 1)()), ((c_uint32 * 1)(1), None)):
        call = partial(x.fmu.fmi3GetClock, x.fmu.component, references, 1, values)
        assert "is null" in x.refusal(call)


def test_without_event_mode_there_is_none(ticked) -> None:
    x = ticked(events=False).start()
    assert "eventModeUsed is false" in x.refusal(x.fmu.enterEventMode)


def test_only_sampled_models_with_a_proper_interval_and_fmi3(tmp_path: Path) -> None:
    with pytest.raises(FmuError, match="planar2r is continuous; expected a sampled model"):
        clocked(planar2r.model(), P)
    for wrong in (0.0, -P, float("nan"), float("inf")):
        with pytest.raises(FmuError, match="interval is"):
            clocked(pd.model(), wrong)
    model = clocked(pd.model(), P)
    assert versions(model) == ("3.0",)
    with pytest.raises(FmuError, match=r"has a clock; FMI version is '2.0'; expected one of 3.0"):
        pack(model, "2.0", tmp_path, compile_model(model))


def test_the_command(tmp_path: Path) -> None:
    def build(*arguments: str) -> tuple[int, str]:
        result = CliRunner().invoke(app, ["build", *arguments, "--out", str(tmp_path)])
        return result.exit_code, result.output + str(result.exception)

    code, said = build("pd", "--clock", "5 ms")
    assert code == 0, said
    assert [p.name for p in tmp_path.iterdir()] == ["pd_clocked.fmi3.fmu"]
    assert "cannot feed [s]" in build("pd", "--clock", "5 kg")[1]
    assert "expected a sampled model" in build("planar2r", "--clock", "5 ms")[1]


# --- in the engine -------------------------------------------------------------------------------


def clocked_document(period: float, controllers: float, **more: object) -> Document:
    """The shipped teleoperator with clocked controllers, steps of `controllers` (s) each."""
    document = document_of(stop=3.0)
    fmu = str(find(clocked(teleoperation.model(), period), "3.0"))
    for side in SIDES:
        control = document["components"][f"{side}_control"]
        control |= {"model": fmu, "period": controllers, **more}
    return document


@pytest.mark.parametrize("period", [P, 2e-3])
@pytest.mark.parametrize("isolate", [False, True])
def test_a_run_has_the_same_bits_as_with_plain_fmus(period: float, isolate: bool) -> None:
    plain = document_of(stop=3.0)
    for side in SIDES:
        plain["components"][f"{side}_control"]["period"] = period
    expected = signals(plan(plain))
    assert np.ptp(expected[:, 0]) > 0.0
    more = {"isolate": True} if isolate else {}
    np.testing.assert_array_equal(signals(plan(clocked_document(period, period, **more))), expected)


def test_links_hold_the_outputs_of_the_start(tmp_path: Path) -> None:
    """Clocked inputs are set in Initialization Mode, so xi(0) is what it is without a clock."""
    first = [signals(plan(d))[0] for d in (document_of(stop=0.01), clocked_document(P, P))]
    np.testing.assert_array_equal(*first)


def test_a_clock_slower_than_the_component_ticks_at_its_own_times() -> None:
    slow = signals(plan(clocked_document(P, P)))
    asked = plan(clocked_document(P, 1e-3))
    start = asked.slots()["master_control.tau"].start
    torque = signals(asked)[:, start]
    assert (np.diff(torque[:-1]).nonzero()[0] % 5 == 4).all()
    assert slow.shape == (asked.ticks + 1, asked.n_signals)


@pytest.mark.parametrize("asked", [2e-3, 4e-3, 0.01])
def test_a_period_that_does_not_fit_is_refused(asked: float) -> None:
    with pytest.raises(CosimError, match=r"clock 'clock', 0\.005 s, is not a multiple of the step"):
        signals(plan(clocked_document(P, asked)))
