"""Which calls are allowed when: the tables of FMI 2.0.5 (4.2.4) and FMI 3.0.2 (2.3, 4.2.1)."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import byref, c_bool, c_double, c_int, c_size_t, c_uint32, c_void_p
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.models import planar2r, teleoperation

OK, DISCARD, ERROR = 0, 2, 3
INST, INIT, STEP, FAILED, END = "instantiated", "initialization", "step", "failed", "terminated"
ANY2 = (INST, INIT, STEP, FAILED, END)
ANY3 = (INST, INIT, STEP, END)

ARM = planar2r.model()
CONTROLLER = teleoperation.model(2)


def _state(d: Any, call: Callable[[c_void_p], int]) -> int:
    """Call with a state saved before; saving is allowed always."""
    state = d.save()
    status = call(state)
    if state.value:
        d.free_state(state)
    return status


def _serialize(d: Any, state: c_void_p) -> int:
    return d(f"Serialize{d.suffix()}", state, (c_int * 200)(), c_size_t(800))


def _deserialize(d: Any, state: c_void_p) -> int:
    status, made = d.deserialize(d.serialize(state))
    d.free_state(made)
    return status


COMMON: dict[str, Callable[[Any], int]] = {
    "SetDebugLogging": lambda d: d("SetDebugLogging", 0, c_size_t(0), None),
    "ExitInitializationMode": lambda d: d("ExitInitializationMode"),
    "Terminate": lambda d: d("Terminate"),
    "Reset": lambda d: d("Reset"),
    "DoStep": lambda d: d.step(0.0, 1e-3),
    "GetState": lambda d: _state(d, lambda s: OK),
    "SetState": lambda d: _state(d, d.restore),
    "FreeState": lambda d: _state(d, d.free_state),
    "SerializeState": lambda d: _state(d, lambda s: _serialize(d, s)),
    "DeserializeState": lambda d: _state(d, lambda s: _deserialize(d, s)),
    "SetInput": lambda d: d.set("tau", [1.0, 2.0]),
    "SetParameter": lambda d: d.set("theta", [3.34, 1.2, 0.97]),
    "SetStart": lambda d: d.set("q", [0.1, 0.2]),
}


def _get(suffix: str, name: str, kind: Any, size: int) -> Callable[[Any], int]:
    return lambda d: d.access(f"Get{suffix}", d.references(name), (kind * size)())


CALLS2 = COMMON | {
    "SetupExperiment": lambda d: d("SetupExperiment", 0, 0.0, 0.0, 0, 0.0),
    "EnterInitializationMode": lambda d: d("EnterInitializationMode"),
    "Get": _get("Real", "q", c_double, 2),
    "GetInteger": _get("Integer", "substeps", c_int, 1),
    "SetInteger": lambda d: d.set("substeps", [2]),
    "GetRealStatus": lambda d: d("GetRealStatus", 2, byref(c_double())),
    "GetBooleanStatus": lambda d: d("GetBooleanStatus", 3, byref(c_int())),
}
TABLE2 = {
    "SetDebugLogging": ANY2,
    "SetupExperiment": (INST,),
    "EnterInitializationMode": (INST,),
    "ExitInitializationMode": (INIT,),
    "Terminate": (STEP, FAILED),
    "Reset": ANY2,
    "Get": (INIT, STEP, FAILED, END),
    "GetInteger": (INIT, STEP, FAILED, END),
    "SetInput": (INST, INIT, STEP),
    "SetParameter": (INST, INIT),
    "SetInteger": (INST, INIT),
    "SetStart": (INST, INIT),
    "GetState": ANY2,
    "SetState": ANY2,
    "FreeState": ANY2,
    "SerializeState": ANY2,
    "DeserializeState": ANY2,
    "DoStep": (STEP,),
    "GetRealStatus": (STEP, FAILED, END),
    "GetBooleanStatus": (STEP, FAILED, END),
}

CALLS3 = COMMON | {
    "EnterInitializationMode": lambda d: d.enter(),
    "Get": _get("Float64", "q", c_double, 2),
    "GetInt32": _get("Int32", "substeps", c_int, 1),
    "SetInt32": lambda d: d.set("substeps", [2]),
}
TABLE3 = {
    "SetDebugLogging": ANY3,
    "EnterInitializationMode": (INST,),
    "ExitInitializationMode": (INIT,),
    "Terminate": (STEP,),
    "Reset": ANY3,
    "Get": (INIT, STEP, END),
    "GetInt32": (INIT, STEP, END),
    "SetInput": (INST, INIT, STEP),
    "SetParameter": (INST, INIT),
    "SetInt32": (INST, INIT),
    "SetStart": (INST, INIT),
    "GetState": ANY3,
    "SetState": ANY3,
    "FreeState": ANY3,
    "SerializeState": ANY3,
    "DeserializeState": ANY3,
    "DoStep": (STEP,),
}
VERSIONS = {"2.0": (CALLS2, TABLE2, ANY2), "3.0": (CALLS3, TABLE3, ANY3)}
EVERY = [
    (v, name, mode) for v, (calls, _, modes) in VERSIONS.items() for name in calls for mode in modes
]


@pytest.mark.parametrize(("version", "name", "mode"), EVERY)
def test_a_call_is_allowed_where_the_table_says(
    drive: Any, version: str, name: str, mode: str
) -> None:
    calls, table, _ = VERSIONS[version]
    d = drive(ARM, version)
    d.go_to(mode)
    status = calls[name](d)
    said = d.log.take()
    if mode in table[name]:
        assert (status, said) == (OK, [])
    else:
        assert status == ERROR
        assert [(s, c) for s, c, _ in said] == [(ERROR, "logStatusError")]
        assert said[0][2].startswith(f"fmi{version[0]}")
    d.free()


@pytest.mark.parametrize(("version", "mode"), [(v, m) for v in VERSIONS for m in VERSIONS[v][2]])
def test_a_refused_call_leaves_everything_as_it_was(drive: Any, version: str, mode: str) -> None:
    calls, table, _ = VERSIONS[version]
    d = drive(ARM, version)
    d.go_to(mode)
    before = d.serialize(d.save())
    for name in calls:
        if mode not in table[name]:
            calls[name](d)
    assert d.serialize(d.save()) == before


AFTER = {
    "EnterInitializationMode": INIT,
    "ExitInitializationMode": STEP,
    "Terminate": END,
    "Reset": INST,
}


@pytest.mark.parametrize("version", VERSIONS)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_sequences_follow_the_table(drive: Any, version: str, data: Any) -> None:
    calls, table, _ = VERSIONS[version]
    names = data.draw(st.lists(st.sampled_from(sorted(set(calls) - {"DoStep"})), max_size=40))
    d, mode = drive(ARM, version), INST
    for name in names:
        status = calls[name](d)
        assert status == (OK if mode in table[name] else ERROR), (name, mode, d.log.take())
        mode = AFTER.get(name, mode) if status == OK else mode
    d.free()


# --- functions of other kinds of FMU ---------------------------------------------------------

NONE = c_void_p(None)
NOT_THERE2 = {
    "GetDirectionalDerivative": [NONE, c_size_t(0), NONE, c_size_t(0), NONE, NONE],
    "SetRealInputDerivatives": [NONE, c_size_t(0), NONE, NONE],
    "GetRealOutputDerivatives": [NONE, c_size_t(0), NONE, NONE],
    "CancelStep": [],
    "GetStatus": [0, NONE],
    "GetIntegerStatus": [0, NONE],
    "GetStringStatus": [1, NONE],
    "EnterEventMode": [],
    "NewDiscreteStates": [NONE],
    "EnterContinuousTimeMode": [],
    "CompletedIntegratorStep": [0, NONE, NONE],
    "SetTime": [0.0],
    "SetContinuousStates": [NONE, c_size_t(0)],
    "GetDerivatives": [NONE, c_size_t(0)],
    "GetEventIndicators": [NONE, c_size_t(0)],
    "GetContinuousStates": [NONE, c_size_t(0)],
    "GetNominalsOfContinuousStates": [NONE, c_size_t(0)],
}
_CLOCKS = [NONE, c_size_t(0), NONE, NONE]
_DERIVATIVE = [NONE, c_size_t(0), NONE, c_size_t(0), NONE, c_size_t(0), NONE, c_size_t(0)]
NOT_THERE3 = {
    "GetNumberOfVariableDependencies": [c_uint32(0), NONE],
    "GetVariableDependencies": [c_uint32(0), NONE, NONE, NONE, NONE, c_size_t(0)],
    "GetDirectionalDerivative": _DERIVATIVE,
    "GetAdjointDerivative": _DERIVATIVE,
    "GetOutputDerivatives": [NONE, c_size_t(0), NONE, NONE, c_size_t(0)],
    "EnterConfigurationMode": [],
    "ExitConfigurationMode": [],
    "EnterEventMode": [],
    "EnterStepMode": [],
    "EvaluateDiscreteStates": [],
    "UpdateDiscreteStates": [NONE, NONE, NONE, NONE, NONE, NONE],
    "GetIntervalDecimal": _CLOCKS,
    "GetIntervalFraction": [*_CLOCKS, NONE],
    "GetShiftDecimal": _CLOCKS[:3],
    "GetShiftFraction": _CLOCKS,
    "SetIntervalDecimal": _CLOCKS[:3],
    "SetIntervalFraction": _CLOCKS,
    "SetShiftDecimal": _CLOCKS[:3],
    "SetShiftFraction": _CLOCKS,
    "EnterContinuousTimeMode": [],
    "CompletedIntegratorStep": [c_bool(False), NONE, NONE],
    "SetTime": [0.0],
    "SetContinuousStates": [NONE, c_size_t(0)],
    "GetContinuousStateDerivatives": [NONE, c_size_t(0)],
    "GetEventIndicators": [NONE, c_size_t(0)],
    "GetContinuousStates": [NONE, c_size_t(0)],
    "GetNominalsOfContinuousStates": [NONE, c_size_t(0)],
    "GetNumberOfEventIndicators": [NONE],
    "GetNumberOfContinuousStates": [NONE],
    "ActivateModelPartition": [c_uint32(0), 0.0],
}
NOT_THERE = {"2.0": NOT_THERE2, "3.0": NOT_THERE3}


@pytest.mark.parametrize(("version", "name"), [(v, n) for v in NOT_THERE for n in NOT_THERE[v]])
def test_what_the_fmu_is_not_for_is_refused_in_every_mode(
    drive: Any, version: str, name: str
) -> None:
    for mode in VERSIONS[version][2]:
        d = drive(ARM, version)
        d.go_to(mode)
        assert d(name, *NOT_THERE[version][name]) == ERROR
        (entry,) = d.log.take()
        assert entry[:2] == (ERROR, "logStatusError")
        assert entry[2].startswith(f"fmi{version[0]}{name}: ")
        d.free()


@pytest.mark.parametrize("version", VERSIONS)
def test_no_instance_is_an_error_not_a_crash(drive: Any, version: str) -> None:
    calls, _, _ = VERSIONS[version]
    d = drive(ARM, version)
    handle, d.handle = d.handle, None
    skipped = ("GetState", "SetState", "FreeState", "SerializeState", "DeserializeState")
    for name in sorted(set(calls) - set(skipped)):
        assert calls[name](d) == ERROR, name
    for name, arguments in NOT_THERE[version].items():
        assert d(name, *arguments) == ERROR, name
    suffix = d.suffix()
    for verb in ("Get", "Set", "Free"):
        assert d(f"{verb}{suffix}", NONE) == ERROR
    assert d(f"Serialized{suffix}Size", NONE, NONE) == ERROR
    assert d(f"Serialize{suffix}", NONE, NONE, c_size_t(0)) == ERROR
    d.free()  # allowed by the standard: nothing happens
    d.handle = handle
    d.free()


def test_types_without_variables_take_nothing(drive: Any) -> None:
    d = drive(ARM, "3.0")
    d.go_to(STEP)
    types = ["Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "String"]
    for name in types:
        for verb in ("Get", "Set"):
            assert d(f"{verb}{name}", NONE, c_size_t(0), NONE, c_size_t(0)) == OK
            assert d(f"{verb}{name}", NONE, c_size_t(1), NONE, c_size_t(1)) == ERROR
            assert f"no variable of type {name}" in d.log.take()[-1][2]
    for verb in ("Get", "Set"):
        assert d(f"{verb}Binary", NONE, c_size_t(0), NONE, NONE, c_size_t(0)) == OK
        assert d(f"{verb}Clock", NONE, c_size_t(1), NONE) == ERROR
    d = drive(ARM, "2.0")
    d.go_to(STEP)
    for verb in ("Get", "Set"):
        assert d(f"{verb}String", NONE, c_size_t(0), NONE) == OK
        assert d(f"{verb}String", NONE, c_size_t(1), NONE) == ERROR
        assert "no variable of type String" in d.log.take()[-1][2]
