"""Steps and log of an instance: what is discarded or refused says so in a sentence."""

from __future__ import annotations

import ctypes
from ctypes import c_bool, c_double, c_size_t, c_void_p
from math import inf, nan
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.models import operator, planar2r, teleoperation

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


# --- steps -----------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_an_input_that_is_no_number_is_discarded(drive: Any, version: str, bad: float) -> None:
    d = drive(CONTROLLER, version)
    d.go_to("step")
    before = d.outputs()
    assert d.set("xi_in", [0.0, 0.0, bad, 0.0]) == OK
    assert d.step(0.0, 5e-3) == DISCARD
    ((status, category, text),) = d.log.take()
    assert (status, category) == (DISCARD, "logStatusDiscard")
    assert "xi_in[1,0]" in text
    assert d.outputs() == before


def test_fmi3_goes_on_after_a_discarded_step(drive: Any) -> None:
    d = drive(CONTROLLER, "3.0")
    d.go_to("step")
    d.set("q", [nan, 0.0])
    assert d.step(0.0, 5e-3) == DISCARD
    assert d.last.value == 0.0
    d.set("q", [0.0, 0.0])
    assert d.step(0.0, 5e-3) == OK
    assert d.last.value == 5e-3
    assert not (d.event.value or d.terminate.value or d.early.value)


def test_fmi2_goes_back_after_a_discarded_step(drive: Any) -> None:
    d = drive(CONTROLLER, "2.0")
    d.go_to("step")
    assert d.step(0.0, 5e-3) == OK
    state = d.save()
    d.set("q", [nan, 0.0])
    assert d.step(5e-3, 5e-3) == DISCARD
    last = c_double()
    assert d("GetRealStatus", 2, ctypes.byref(last)) == OK
    assert last.value == 5e-3
    assert d.step(5e-3, 5e-3) == ERROR
    assert d.restore(state) == OK
    assert d.step(5e-3, 5e-3) == OK


def test_a_diverging_arm_is_discarded(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    d.set("tau", [1e300, 1e300])
    assert d.step(0.0, 1.0) == DISCARD
    assert "left the range of numbers" in d.log.take()[-1][2]
    assert d.get("q") == [0.0, 0.0]


@pytest.mark.parametrize("h", [0.0, -1e-3, nan, inf])
def test_a_step_must_be_positive(drive: Any, version: str, h: float) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    assert d.step(0.0, h) == ERROR
    refused(d, "communication step")


@pytest.mark.parametrize("t", [1e-3, -1e-3, nan])
def test_the_communication_point_must_be_where_the_last_step_ended(
    drive: Any, version: str, t: float
) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    assert d.step(t, 1e-2) == ERROR
    refused(d, "communication point", "expected 0 s")


def test_rounded_communication_points_are_taken(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    t = 0.0
    for k in range(1000):
        assert d.step(t if k % 2 else k * 1e-3, 1e-3) == OK
        t += 1e-3


def test_nothing_is_calculated_after_the_stop_time(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    assert d.enter(0.0, 0.3) == OK
    assert d.leave() == OK
    for k in range(3):
        assert d.step(k * 0.1, 0.1) == OK  # 0.1 + 0.2 > 0.3, by rounding
    assert d.step(0.3, 0.1) == ERROR
    refused(d, "stop time")


def test_fmi3_wants_somewhere_to_answer(drive: Any) -> None:
    d = drive(ARM, "3.0")
    d.go_to("step")
    assert d("DoStep", 0.0, 1e-3, c_bool(True), NONE, NONE, NONE, NONE) == ERROR
    refused(d, "null")


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    h=st.floats(allow_nan=True, allow_infinity=True),
    t=st.floats(allow_nan=True, allow_infinity=True),
    tau=st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=2),
)
def test_any_step_is_ok_discarded_or_refused_and_state_stays_finite(
    drive: Any, h: float, t: float, tau: list[float]
) -> None:
    d = drive(ARM, "3.0")
    d.go_to("step")
    d.set("tau", tau)
    assert d.step(t, h) in (OK, DISCARD, ERROR)
    assert d.step(0.0, h) in (OK, DISCARD, ERROR)
    assert all(abs(x) < inf for x in d.outputs())
    d.free()


# --- log -------------------------------------------------------------------------------------


def test_events_are_logged_when_asked_for(drive: Any, version: str) -> None:
    quiet, loud = drive(ARM, version), drive(ARM, version, logging=True)
    for d in (quiet, loud):
        assert d.enter() == OK
        assert d.leave() == OK
    assert quiet.log.take() == []
    said = loud.log.take()
    assert {(status, category) for status, category, _ in said} == {(OK, "logEvents")}
    assert len(said) == 2


def test_categories_are_switched_one_by_one(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    on = c_bool(True) if version == "3.0" else 1
    names = (ctypes.c_char_p * 1)(b"logEvents")
    assert d("SetDebugLogging", on, c_size_t(1), names) == OK
    assert d.enter() == OK
    assert d.leave() == OK
    assert [category for _, category, _ in d.log.take()] == ["logEvents"]
    names = (ctypes.c_char_p * 1)(b"logWeather")
    assert d("SetDebugLogging", on, c_size_t(1), names) == ERROR
    refused(d, "logWeather")
    assert d("SetDebugLogging", on, c_size_t(1), NONE) == ERROR
    refused(d, "categories is null")


def test_a_percent_sign_in_a_message_is_text(drive: Any) -> None:
    d = drive(operator.model(), "2.0", guid="%s%n%d")
    assert d.handle is None
    refused(d, "'%s%n%d'")


def test_the_log_names_the_instance_in_fmi2(drive: Any) -> None:
    d = drive(ARM, "2.0", name=b"slave")
    d("Terminate")
    assert d.log.entries[0].name == b"slave"
