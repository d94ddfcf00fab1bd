"""Clocked variables of an FMU that insists on the rules of FMI 3.0.2 (2.2.8, 2.3.5)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

from cosim.base.errors import CosimError
from cosim.fmi import FmuOptions
from tests.cosim.fmi.exporter import clocked3, export, outputs, plan_of, run

STEPS = 10  # of 0.1 s
EARLY = 'canReturnEarlyAfterIntermediateUpdate="true"'
FAST, SLOW, BELL, ECHO = 1, 2, 3, 4
OUTPUTS = {"y_fast": 20, "y_slow": 21, "y_bell": 22, "heard": 23, "y_both": 24}
OF = {20: {FAST}, 21: {SLOW}, 22: {BELL}, 23: {BELL}, 24: {FAST, SLOW}}
#: Inputs at every step, and what each says who sees it.
FED = {
    "u_fast": np.arange(STEPS, dtype=float),
    "u_slow": 100.0 + np.arange(STEPS),
    "u_bell": 1000.0 + np.arange(STEPS),
}


@pytest.fixture(scope="module")
def clocked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(clocked3(), tmp_path_factory.mktemp("fmu") / "clocked3.fmu")


@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("kind", ["continuous", "sampled"])
@pytest.mark.parametrize("period", [1, 2, 3])
def test_outputs_hold_what_they_were_when_their_clock_ticked(
    clocked, kind, isolate, period
) -> None:
    """Clocks count steps of the FMU, of `period` ticks each; a continuous one is late in them."""
    plan = plan_of(
        clocked, STEPS * period, 0.1 / period, kind=kind, options=FmuOptions(isolate=isolate),
        period=period,
    )  # fmt: skip
    fed = {name: np.repeat(values, period) for name, values in FED.items()}
    found = {name: values[::period] for name, values in outputs(plan, fed).items()}
    steps = range(STEPS)
    assert found["y_fast"] == [-1.0, *(sum(range(k + 1)) for k in steps)]
    slow = [sum(100.0 + i for i in range(1, k + 1, 3)) or -1.0 for k in steps]
    assert found["y_slow"] == [-1.0, *slow]
    assert found["y_echo"] == [-1.0] * 4 + [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert found["echo"] == [0.0] * 4 + [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert found["y_both"] == pytest.approx([-1.0, *(0.1 * k for k in steps)])
    assert found["time"][1:] == pytest.approx([0.1 * (k + 1) for k in steps])


@pytest.mark.parametrize("flags", ["", EARLY])
def test_a_clock_that_the_fmu_ticks_is_heard_in_its_events(tmp_path: Path, flags: str) -> None:
    """At 0, in the Event Mode after initialization, and then every 0.25 s."""
    found = outputs(plan_of(export(clocked3(flags=flags), tmp_path / "x.fmu"), STEPS), FED)
    assert found["y_bell"] == [1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0, 4.0, 4.0, 5.0]
    heard = [0.0, 0.0, 0.0, 1002.0, 1002.0, 1004.0, 1004.0, 1004.0, 1007.0, 1007.0, 1009.0]
    assert found["heard"] == heard
    assert found["bell"] == found["y_bell"]


@pytest.mark.parametrize("name", ["u_fast", "u_bell"])
def test_an_input_that_the_fmu_refuses_stops_the_run(clocked: Path, name: str) -> None:
    """Whether its clock ticks from outside or is one that the FMU ticks: both are asked for."""
    too_large = np.where(np.arange(STEPS) < 4, 0.0, 1e7)
    with pytest.raises(CosimError, match=r"returned error \(this input is too large\) at tick 4"):
        run(plan_of(clocked, STEPS), {**FED, name: too_large})


@pytest.mark.parametrize("kind", ["fixed", "tunable"])
@pytest.mark.parametrize("isolate", [False, True])
def test_an_interval_that_is_not_written_is_asked_for(tmp_path, clocked, kind, isolate) -> None:
    silent = re.sub(r'="constant" [^/]*/>', f'="{kind}"/>', clocked3())
    assert "intervalDecimal" not in silent and kind in silent
    path = export(silent, tmp_path / "x.fmu")
    found = outputs(plan_of(path, STEPS, options=FmuOptions(isolate=isolate)), FED)
    assert found == outputs(plan_of(clocked, STEPS), FED)


@pytest.mark.parametrize("kind", ["fixed", "tunable"])
@pytest.mark.parametrize("isolate", [False, True])
def test_an_interval_is_set_like_a_parameter(tmp_path, kind, isolate) -> None:
    """Where it is the importer's to choose: every second step then takes its input."""
    path = export(clocked3().replace('="constant"', f'="{kind}"', 1), tmp_path / "x.fmu")
    options = FmuOptions(isolate=isolate)
    found = outputs(plan_of(path, STEPS, values={"fast": (0.2,)}, options=options), FED)
    assert found["y_fast"] == [-1.0, *(sum(range(0, k + 1, 2)) for k in range(STEPS))]
    with pytest.raises(CosimError, match="no such interval"):
        run(plan_of(path, 1, values={"fast": (0.25,)}))


def test_fmpy_sees_the_same_values_in_event_mode(clocked: Path) -> None:
    found, expected = outputs(plan_of(clocked, STEPS), FED), by_fmpy(clocked)
    assert {name: found[name] for name in expected} == expected


def by_fmpy(path: Path) -> dict[str, list[float]]:
    """The same run by FMPy's calls, written as the standard's state machine reads."""
    description = read_model_description(str(path), validate=False)
    fmu = FMU3Slave(
        guid=description.guid, unzipDirectory=extract(str(path)), modelIdentifier="clocked3"
    )
    fmu.instantiate(eventModeUsed=True)
    fmu.enterInitializationMode()
    now = {name: fmu.getFloat64([r])[0] for name, r in OUTPUTS.items()}
    now |= {"y_echo": float(fmu.getInt32([40])[0])}
    fmu.exitInitializationMode()
    event(fmu, now, set(), {})
    now["time"] = fmu.getFloat64([30])[0]
    found = {name: [value] for name, value in now.items()}
    for k in range(STEPS):
        u = {FAST: FED["u_fast"][k], SLOW: FED["u_slow"][k], BELL: FED["u_bell"][k]}
        fmu.enterEventMode()
        event(fmu, now, {FAST, SLOW} if k % 3 == 1 else {FAST}, u)
        happened, *_ = fmu.doStep(k * 0.1, 0.1)
        if happened:
            fmu.enterEventMode()
            event(fmu, now, set(), u)
        now["time"] = fmu.getFloat64([30])[0]
        for name, value in now.items():
            found[name].append(value)
    fmu.terminate()
    fmu.freeInstance()
    return found


def event(fmu: FMU3Slave, now: dict[str, float], ticks: set[int], u: dict[int, float]) -> None:
    """One Event Mode: instants until nothing changes, `ticks` in the first."""
    again, active = True, set(ticks)
    for clock in ticks:
        fmu.setClock([clock], [True])
    while again:
        for clock in active:
            fmu.setFloat64([9 + clock], [u[clock]])
        if fmu.getClock([BELL])[0]:
            active.add(BELL)
            if u:
                fmu.setFloat64([12], [u[BELL]])
        if FAST in active and fmu.getClock([ECHO])[0]:
            now["y_echo"] = float(fmu.getInt32([40])[0])
        for name, reference in OUTPUTS.items():
            if OF[reference] & active:
                now[name] = fmu.getFloat64([reference])[0]
        again, *_ = fmu.updateDiscreteStates()
        active.clear()
    fmu.enterStepMode()


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ('<Float64 name="y" valueReference="50" causality="output" variability="discrete" '
         'clocks="99"/>', "'y' belongs to a clock of value reference 99; expected that of"),
        ('<Clock name="a" valueReference="50" causality="output" '
         'intervalVariability="triggered" clocks="51"/><Clock name="b" valueReference="51" '
         'causality="output" intervalVariability="triggered" clocks="50"/>',
         "'a' belongs to a clock of value reference 51; .* no loop of clocks"),
    ],
)  # fmt: skip
def test_what_belongs_to_no_clock_is_refused(tmp_path: Path, variables: str, message: str) -> None:
    with pytest.raises(CosimError, match=message):
        run(plan_of(export(clocked3(variables), tmp_path / "x.fmu"), 1))


def test_a_binary_that_cannot_tell_its_clocks_is_refused(tmp_path: Path) -> None:
    lacking = clocked3().replace('"clocked3"', '"events3"')
    with pytest.raises(CosimError, match="the binary lacks fmi3Get"):
        run(plan_of(export(lacking, tmp_path / "x.fmu"), 1))
