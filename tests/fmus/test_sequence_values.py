"""Instances, values and the start: what is refused says so in a sentence."""

from __future__ import annotations

import ctypes
from ctypes import c_bool, c_double, c_int, c_size_t, c_uint32, c_void_p
from math import inf, nan
from typing import Any

import pytest

from fmus.build.source import token
from fmus.models import planar2r, teleoperation

OK, DISCARD, ERROR = 0, 2, 3
ARM = planar2r.model()
CONTROLLER = teleoperation.model(2)
VERSIONS = ("2.0", "3.0")
NONE = c_void_p(None)


@pytest.fixture(params=VERSIONS)
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def real(version: str) -> str:
    return "Real" if version == "2.0" else "Float64"


def refused(d: Any, *words: str) -> None:
    """The last thing logged is an error that has all these words."""
    status, category, text = d.log.take()[-1]
    assert (status, category) == (ERROR, "logStatusError")
    for word in words:
        assert word in text, text


# --- instantiation ---------------------------------------------------------------------------


def test_another_token_is_refused(drive: Any, version: str) -> None:
    d = drive(ARM, version, guid="{00000000-0000-0000-0000-000000000000}")
    assert d.handle is None
    refused(d, "{00000000-0000-0000-0000-000000000000}", token(ARM))


@pytest.mark.parametrize("name", [b"", None])
def test_an_instance_without_a_name_is_refused(drive: Any, version: str, name: Any) -> None:
    d = drive(ARM, version, name=name)
    assert d.handle is None
    refused(d, "instance name")


def test_without_a_logger_nothing_is_said(drive: Any, version: str) -> None:
    d = drive(ARM, version, listening=False)
    assert d("DoStep", 0.0, 0.0, 0, NONE, NONE, NONE, NONE) == ERROR
    assert drive(ARM, version, listening=False, guid="other").handle is None


def test_other_kinds_of_instance_are_refused(drive: Any, listener: ctypes.CDLL) -> None:
    d = drive(ARM, "3.0")
    log = c_void_p(ctypes.addressof(d.log))
    listen = ctypes.cast(listener.listen3, c_void_p)
    guid, no = token(ARM).encode(), c_bool(False)
    make = d.library.fmi3InstantiateModelExchange
    assert not make(b"it", guid, None, no, no, log, listen)
    refused(d, "fmi3InstantiateModelExchange", "co-simulation")
    make = d.library.fmi3InstantiateScheduledExecution
    assert not make(b"it", guid, None, no, no, log, listen, NONE, NONE, NONE)
    refused(d, "fmi3InstantiateScheduledExecution", "co-simulation")
    make = d.library.fmi3InstantiateCoSimulation
    none = [NONE, c_size_t(0)]
    assert not make(b"it", guid, None, no, no, c_bool(True), no, *none, log, listen, NONE)
    refused(d, "event mode")
    d2 = drive(ARM, "2.0")
    make = d2.library.fmi2Instantiate
    assert not make(b"it", 0, guid, None, ctypes.byref(d2._callbacks), 0, 0)
    refused(d2, "fmi2Instantiate", "co-simulation")
    assert not make(b"it", 1, guid, None, NONE, 0, 0)


def test_versions_are_named(drive: Any) -> None:
    library = drive(ARM, "2.0").library
    for name, said in (
        ("fmi2GetVersion", b"2.0"),
        ("fmi2GetTypesPlatform", b"default"),
        ("fmi3GetVersion", b"3.0"),
    ):
        function = getattr(library, name)
        function.restype = ctypes.c_char_p
        assert function() == said


# --- values ----------------------------------------------------------------------------------


def test_an_unknown_reference_is_refused(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    time = sum(v.size for v in ARM.variables) if version == "2.0" else len(ARM.variables)
    value = (c_double * 1)()
    assert d.access(f"Get{real(version)}", [time], value) == OK
    for reference in (time + 1, 2**32 - 1):
        for verb in ("Get", "Set"):
            assert d.access(f"{verb}{real(version)}", [reference], value) == ERROR
            refused(d, f"no value reference {reference}")


def test_a_wrong_type_is_refused(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("initialization")
    integer = "Integer" if version == "2.0" else "Int32"
    for verb in ("Get", "Set"):
        assert (
            d.access(f"{verb}{real(version)}", d.references("substeps"), (c_double * 1)()) == ERROR
        )
        refused(d, "substeps", f"type {integer}")
        size = len(d.references("q")) if version == "2.0" else 2
        assert d.access(f"{verb}{integer}", d.references("q"), (c_int * size)()) == ERROR
        refused(d, "q", f"type {real(version)}")
        assert d.access(f"{verb}Boolean", d.references("substeps"), (c_int * 1)()) == ERROR
        refused(d, "substeps", f"type {integer}")


def test_null_pointers_are_refused(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    one, value = (c_uint32 * 1)(0), (c_double * 1)()
    count = [] if version == "2.0" else [c_size_t(1)]
    for verb in ("Get", "Set"):
        function = f"{verb}{real(version)}"
        assert d(function, NONE, c_size_t(1), value, *count) == ERROR
        refused(d, "is null")
        assert d(function, one, c_size_t(1), NONE, *count) == ERROR
        refused(d, "is null")
        zero = [] if version == "2.0" else [c_size_t(0)]
        assert d(function, NONE, c_size_t(0), NONE, *zero) == OK


def test_the_number_of_values_must_fit(drive: Any) -> None:
    d = drive(CONTROLLER, "3.0")
    d.go_to("step")
    for size in (0, 3, 5):
        assert d.access("SetFloat64", d.references("xi_in"), (c_double * 8)(), size) == ERROR
        refused(d, f"nValues is {size}, expected 4")
        assert d.access("GetFloat64", d.references("xi_in"), (c_double * 8)(), size) == ERROR
        refused(d, f"nValues is {size}, expected 4")
    assert d.set("xi_in", [1.0, 2.0, 3.0, 4.0]) == OK
    assert d.get("xi_in") == [1.0, 2.0, 3.0, 4.0]


def test_a_refused_set_sets_nothing(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    references = [*d.references("tau"), *d.references("theta")]
    size = 5
    assert d.access(f"Set{real(version)}", references, (c_double * size)(*[9.0] * size)) == ERROR
    refused(d, "theta", "fixed parameter")
    assert d.get("tau") == [0.0, 0.0]


def test_what_cannot_be_set_says_why(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    assert d.set("tau_h", [1.0, 1.0]) == ERROR
    refused(d, "tau_h", "calculated")
    d.go_to("step")
    assert d.set("q", [1.0, 1.0]) == ERROR
    refused(d, "q", "start value")
    assert d.set("substeps", [2]) == ERROR
    refused(d, "substeps", "fixed parameter")


def test_outputs_follow_inputs_and_parameters_in_initialization(drive: Any, version: str) -> None:
    d = drive(CONTROLLER, version)
    d.go_to("initialization")
    assert d.get("xi") == [0.0, 0.0]
    d.set("q", [1.0, 2.0])
    assert d.get("xi") == [0.5, 1.0]
    d.set("alpha", [3.0])
    d.set("dq", [10.0, 20.0])
    assert d.get("xi") == [13.0, 26.0]
    d.leave()
    d.set("q", [0.0, 0.0])
    assert d.get("xi") == [13.0, 26.0]  # held until the step
    assert d.step(0.0, 5e-3) == OK
    assert d.get("xi") == [10.0, 20.0]


def test_time_is_a_variable(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    assert d.enter(start=2.0) == OK
    assert d.leave() == OK
    reference = sum(v.size for v in ARM.variables) if version == "2.0" else len(ARM.variables)
    value = (c_double * 1)()
    for k in range(3):
        assert d.access(f"Get{real(version)}", [reference], value) == OK
        assert value[0] == 2.0 + k * 0.5
        assert d.step(2.0 + k * 0.5, 0.5) == OK
    assert d.access(f"Set{real(version)}", [reference], value) == ERROR


# --- the start -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("theta", [1.0, 2.0, 1.0], ["theta", "positive definite"]),
        ("theta", [3.0, nan, 1.0], ["theta[1]", "nan", "finite"]),
        ("k_p", [0.0, -1.0], ["k_p[1]", "-1", "between 0 and inf"]),
        ("substeps", [0], ["substeps", "between 1 and inf"]),
        ("q", [inf, 0.0], ["q[0]", "inf"]),
        ("tau", [0.0, nan], ["tau[1]", "nan"]),
    ],
)
def test_values_that_cannot_be_are_refused_at_the_start_and_may_be_mended(
    drive: Any, version: str, name: str, values: list[float], words: list[str]
) -> None:
    d = drive(ARM, version)
    d.go_to("initialization")
    good = d.get(name)
    assert d.set(name, values) == OK
    assert d.leave() == ERROR
    refused(d, *words)
    assert d.set(name, good) == OK
    assert d.leave() == OK


def test_times_that_cannot_be_are_refused(drive: Any, version: str) -> None:
    for start, stop, word in (
        (nan, None, "start time"),
        (1.0, 0.5, "stop time"),
        (0.0, nan, "stop"),
    ):
        d = drive(ARM, version)
        assert d.enter(start, stop) == ERROR
        refused(d, word)
