"""The judges of calls are judged: a good sequence has no violation, each wrong one has its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cosim.fmi.exporter import clocked3, exchange2, exchange3, export, strict2, strict3
from tests.fmi.described import Described, described
from tests.fmi.machine2 import violations as violations2
from tests.fmi.machine3 import violations as violations3
from tests.fmi.watch import Call

STEP2 = "DoStep currentCommunicationPoint={} communicationStepSize=0.1"
UPDATED = (
    "UpdateDiscreteStates discreteStatesNeedUpdate=0 terminateSimulation=0 nextEventTimeDefined=0 "
    "nextEventTime=0"
)
NEW = UPDATED.replace("UpdateDiscreteStates discreteStatesNeedUpdate", "NewDiscreteStates "
                      "newDiscreteStatesNeeded")  # fmt: skip
COMPLETED = "CompletedIntegratorStep enterEventMode=0 terminateSimulation=0"

GOOD = {
    "2 co-simulation": [
        "Instantiate fmuType=1", "SetupExperiment startTime=0", "SetReal vr=1,2",
        "EnterInitializationMode", "SetReal vr=0", "GetReal vr=4", "ExitInitializationMode",
        "GetReal vr=1", "SetReal vr=0,5", STEP2.format(0.0), "GetReal vr=4", STEP2.format(0.1),
        "Terminate", "GetReal vr=4", "FreeInstance",
    ],
    "2 model exchange": [
        "Instantiate fmuType=0", "SetupExperiment startTime=0", "SetInteger vr=20",
        "EnterInitializationMode", "SetReal vr=4", "GetReal vr=0,2", "ExitInitializationMode",
        NEW.replace("Needed=0", "Needed=1"), NEW, "EnterContinuousTimeMode", "SetTime time=0.5",
        "SetContinuousStates", "GetDerivatives", "GetEventIndicators", "SetReal vr=4", COMPLETED,
        "EnterEventMode", "SetInteger vr=23", NEW, "EnterContinuousTimeMode", "SetTime time=0.6",
        "Terminate", "FreeInstance",
    ],
    "3 co-simulation": [
        "InstantiateCoSimulation eventModeUsed=0", "SetFloat64 valueReferences=0,1",
        "EnterInitializationMode startTime=0", "SetFloat64 valueReferences=0",
        "GetFloat64 valueReferences=4", "ExitInitializationMode",
        "SetFloat64 valueReferences=0,5", STEP2.format(0.0), "GetFloat64 valueReferences=4",
        "Terminate", "FreeInstance",
    ],
    "3 events": [
        "InstantiateCoSimulation eventModeUsed=1", "EnterInitializationMode startTime=0",
        "ExitInitializationMode", "SetClock valueReferences=1 values=1",
        "SetFloat64 valueReferences=10", "GetFloat64 valueReferences=20", UPDATED, "EnterStepMode",
        STEP2.format(0.0) + " eventHandlingNeeded=1 earlyReturn=1 lastSuccessfulTime=0.05",
        "EnterEventMode", "GetClock valueReferences=3 values=1", "GetFloat64 valueReferences=22",
        UPDATED, "EnterStepMode", STEP2.format(0.05), "Terminate", "FreeInstance",
    ],
    "3 model exchange": [
        "InstantiateModelExchange", "EnterInitializationMode startTime=0",
        "GetNominalsOfContinuousStates", "ExitInitializationMode", UPDATED,
        "EnterContinuousTimeMode", "SetTime time=0.1", "SetContinuousStates",
        "GetContinuousStateDerivatives", COMPLETED, "EnterEventMode", UPDATED,
        "EnterContinuousTimeMode", "Terminate", "FreeInstance",
    ],
    "3 scheduled execution": [
        "InstantiateScheduledExecution", "EnterInitializationMode startTime=0",
        "ExitInitializationMode", "SetFloat64 valueReferences=0",
        "ActivateModelPartition clockReference=1 activationTime=0", "GetFloat64 valueReferences=4",
        "ActivateModelPartition clockReference=1 activationTime=0.1", "Terminate", "FreeInstance",
    ],
}  # fmt: skip

#: A good sequence, what is replaced in it (line, by what), and what is said then.
WRONG = [
    ("2 co-simulation", (1, None), "SetupExperiment was not called"),
    ("2 co-simulation", (1, "SetupExperiment startTime=0\nSetupExperiment startTime=0"), "twice"),
    ("2 co-simulation", (2, "SetReal vr=0"), "u may not be set in Instantiated"),
    ("2 co-simulation", (2, "GetReal vr=4"), "not allowed in Instantiated"),
    ("2 co-simulation", (5, "GetReal vr=1"), "gain may not be read in Initialization Mode"),
    ("2 co-simulation", (8, "SetReal vr=1"), "gain may not be set in stepComplete"),
    ("2 co-simulation", (10, "SetReal vr=0\nGetReal vr=4"), "without a step between"),
    ("2 co-simulation", (11, STEP2.format(0.2)), "where the step before ended"),
    ("2 co-simulation", (11, STEP2.format(0.1).replace("Size=0.1", "Size=0")), "not positive"),
    ("2 co-simulation", (12, None), "not terminated before"),
    ("2 co-simulation", (14, None), "was not freed"),
    ("2 co-simulation", (9, STEP2.format(0.0) + " status=4"), "after fatal"),
    ("2 co-simulation", (9, STEP2.format(0.0) + " status=3"), "DoStep"),
    ("2 co-simulation", (9, STEP2.format(0.0) + " status=2"), "not allowed in stepFailed"),
    ("2 co-simulation", (9, STEP2.format(0.0) + " status=5"), "not allowed in stepInProgress"),
    ("2 co-simulation", (7, "GetFMUstate saved=1"), "cannot get and set its state"),
    ("2 co-simulation", (7, "SetRealInputDerivatives"), "cannot interpolate"),
    ("2 co-simulation", (7, "GetDirectionalDerivative"), "no directional derivatives"),
    ("2 co-simulation", (7, "EnterEventMode"), "not allowed in stepComplete"),
    ("2 model exchange", (8, None), "the event iteration has not ended"),
    ("2 model exchange", (8, NEW.replace("Simulation=0", "Simulation=1")), "asked to end"),
    ("2 model exchange", (9, None), "SetContinuousStates{}: not allowed in Event Mode"),
    ("2 model exchange", (14, "SetInteger vr=23"), "gear may not be set in Continuous-Time Mode"),
    ("2 model exchange", (20, "SetTime time=0.4"), "goes back behind the event"),
    ("2 model exchange", (18, NEW.replace("Defined=0", "Defined=1").replace("Time=0", "Time=0.55")),
     "goes over the time event"),
    ("2 model exchange", (16, None), "NewDiscreteStates"),
    ("3 co-simulation", (1, "SetFloat64 valueReferences=4"), "y may not be set in Instantiated"),
    ("3 co-simulation", (6, "SetFloat64 valueReferences=1"), "gain may not be set in Step Mode"),
    ("3 co-simulation", (6, "EnterEventMode"), "event mode is not used"),
    ("3 co-simulation", (8, "SetFloat64 valueReferences=0\nGetFloat64 valueReferences=4"),
     "without a step between"),
    ("3 co-simulation", (8, "GetFloat64 valueReferences=77"), "Float64 77 is no variable"),
    ("3 co-simulation", (9, None), "not terminated before"),
    ("3 co-simulation", (7, STEP2.format(0.0) + " status=2"), None),
    ("3 co-simulation", (7, STEP2.format(0.0) + " status=4"), "after fatal"),
    ("3 co-simulation", (7, STEP2.format(0.0) + " terminateSimulation=1\n" + STEP2.format(0.1)),
     "asked to end"),
    ("3 events", (3, None), "u_fast may not be set in Event Mode"),
    ("3 events", (3, "SetClock valueReferences=3 values=1"), "3 is no input clock"),
    ("3 events", (6, None), "the event iteration has not ended"),
    ("3 events", (7, None), "DoStep"),
    ("3 events", (10, None), "none of its clocks is active"),
    ("3 events", (14, STEP2.format(0.1)), "where the step before ended"),
    ("3 events", (9, "Terminate"), "not allowed in Terminated"),
    ("3 events", (4, "SetClock valueReferences=1 values=0\nSetFloat64 valueReferences=10"),
     "u_fast may not be set"),
    ("3 events", (12, None), "the event iteration has not ended"),
    ("3 model exchange", (2, "DoStep currentCommunicationPoint=0 communicationStepSize=1"),
     "not allowed in Initialization Mode"),
    ("3 model exchange", (5, "EnterStepMode"), "for CoSimulation only"),
    ("3 model exchange", (9, "SetClock valueReferences=1 values=1"), "not allowed in Continuous"),
    ("3 scheduled execution", (6, "ActivateModelPartition clockReference=1 activationTime=0"),
     "not later than that before"),
    ("3 scheduled execution", (6, "SetFloat64 valueReferences=0\nGetFloat64 valueReferences=4"),
     "without a step between"),
    ("3 scheduled execution", (6, UPDATED), "not for scheduled execution"),
]  # fmt: skip


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Described]:
    folder = tmp_path_factory.mktemp("machines")
    fmus = {
        "2 co-simulation": strict2(), "2 model exchange": exchange2(), "3 co-simulation": strict3(),
        "3 events": clocked3(), "3 model exchange": exchange3(), "3 scheduled execution": strict3(),
    }  # fmt: skip
    return {
        name: described(export(text, folder / f"{i}.fmu"))
        for i, (name, text) in enumerate(fmus.items())
    }


def parsed(lines: list[str]) -> Iterator[Call]:
    """Calls as they are written above: name, then arguments; those with a comma are lists."""
    for line in "\n".join(lines).splitlines():
        name, *given = line.split()
        pairs = dict(part.split("=") for part in given)
        status = int(pairs.pop("status", 0))
        lists = ("vr", "valueReferences", "values")
        said = {
            k: [int(x) for x in v.split(",")] if k in lists else float(v) for k, v in pairs.items()
        }
        yield Call(name, 1, 0, status, said)


def judged(name: str, lines: list[str], known: dict[str, Described]) -> list[str]:
    judge = violations2 if name.startswith("2") else violations3
    return judge(list(parsed(lines)), known[name])


@pytest.mark.parametrize("name", GOOD)
def test_a_good_sequence_is_found_good(known: dict[str, Described], name: str) -> None:
    assert judged(name, GOOD[name], known) == []


@pytest.mark.parametrize(("name", "change", "said"), WRONG)
def test_a_wrong_call_is_named(
    known: dict[str, Described], name: str, change: tuple[int, str | None], said: str | None
) -> None:
    at, by = change
    lines = [*GOOD[name][:at], *([] if by is None else [by]), *GOOD[name][at + 1 :]]
    found = judged(name, lines, known)
    assert (said is None) == (not found)
    assert said is None or any(said in sentence for sentence in found), found


SAVING = [
    *GOOD["2 co-simulation"][:9], "GetFMUstate saved=7", STEP2.format(0.0), "SetFMUstate saved=7",
    *GOOD["2 co-simulation"][9:],
]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("", "", None),
        ("SetFMUstate saved=7", "SetFMUstate saved=8", "a state that was not saved"),
        ("SetFMUstate saved=7", "GetVersion", "where the step before ended"),
        (STEP2.format(0.0) + "\n", STEP2.format(0.0) + " status=2\n", None),
        ("SetFMUstate", STEP2.format(0.1) + " noSetFMUStatePriorToCurrentPoint=1\nSetFMUstate",
         "no state before 0.1 was to be set"),
    ],
)  # fmt: skip
def test_steps_done_again_from_a_state(
    tmp_path: Path, old: str, new: str, said: str | None
) -> None:
    known = described(export(strict2('canGetAndSetFMUstate="true"'), tmp_path / "x.fmu"))
    lines = "\n".join(SAVING).replace(old, new, 1) if old else "\n".join(SAVING)
    found = violations2(list(parsed([lines])), known)
    assert (said is None) == (not found)
    assert said is None or said in found[0]


def test_every_function_of_the_standard_is_judged() -> None:
    from tests.fmi import machine2, machine3
    from tests.fmi.watch import functions

    for version, machine in (("2", machine2), ("3", machine3)):
        names = {name.removeprefix(f"fmi{version}") for name in functions(version)}
        made = {name for name in names if name.startswith("Instantiate")}
        assert names - made == set(machine.ALLOWED)


def test_a_call_within_a_callback_is_for_what_was_asked_for(known: dict[str, Described]) -> None:
    lines = GOOD["3 co-simulation"]
    made = "InstantiateCoSimulation eventModeUsed=0"
    calls = list(parsed([made, *lines[1:]]))
    inner = Call("GetFloat64", 1, 1, 0, {"valueReferences": [4]})
    found = violations3([*calls[:7], inner, *calls[7:]], known["3 co-simulation"])
    assert len(found) == 1 and "not among the intermediate variables" in found[0]
    calls[0].said["requiredIntermediateVariables"] = [4]
    assert violations3([*calls[:7], inner, *calls[7:]], known["3 co-simulation"]) == []


def test_a_call_of_an_instance_that_nobody_made_is_named(tmp_path: Path) -> None:
    known = described(export(strict2(), tmp_path / "x.fmu"))
    assert violations2([Call("DoStep", 5, 0, 0, {})], known) == [
        "call 0, DoStep{}: of an instance that does not exist"
    ]
