"""Several instances stepped at once: the same bits, statuses and messages as one by one."""

from __future__ import annotations

import ctypes as c
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.models import planar2r, teleoperation

ARM = planar2r.model()
H = 1e-3
OK, DISCARD, ERROR = 0, 2, 3
NUMBER = st.floats(-20.0, 20.0)
SETTINGS = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(params=["2.0", "3.0"])
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def together(drivers: list[Any], t: float, h: float) -> list[int]:
    """The function beyond FMI: the status of each."""
    d = drivers[0]
    steps = getattr(d.library, f"fmi{d.version[0]}_steps")
    steps.argtypes = (c.c_void_p, c.c_size_t, c.c_double, c.c_double, c.c_void_p)
    steps.restype = None
    status = (c.c_int * len(drivers))(*([77] * len(drivers)))
    handles = (c.c_void_p * len(drivers))(*(d.handle for d in drivers))
    steps(handles, len(drivers), t, h, status)
    return list(status)


@st.composite
def arms(draw: st.DrawFn) -> list[dict[str, list[float]]]:
    """Values of some arms, most of them of one kind; some will leave the range of numbers."""
    gravity, contact = draw(st.booleans()), draw(st.sampled_from([0.0, 0.0, 0.0, 2.0]))
    found = []
    for _ in range(draw(st.integers(1, 9))):
        other = draw(st.sampled_from([False] * 6 + [True]))
        level = gravity == other
        far = draw(st.sampled_from([1.0] * 12 + [1e4, 1e6]))
        found.append({
            "theta_g": [0.0, 0.0] if level else [draw(NUMBER), draw(NUMBER)],
            "contact": [contact],
            "substeps": [draw(st.sampled_from([1.0, 1.0, 1.0, 3.0]))],
            "q": [draw(NUMBER), draw(NUMBER) * far],
            "dq": [draw(NUMBER), draw(NUMBER)],
            "k_p": [abs(draw(NUMBER)), 5.0], "k_d": [0.5, abs(draw(NUMBER))],
            "q_w": [draw(NUMBER), -1.0], "k_w": [abs(draw(NUMBER)), 300.0], "b_w": [2.0, 0.5],
            "grip": [draw(st.floats(0.0, 1.0))], "tau": [draw(NUMBER), draw(NUMBER)],
            "tau_ext": [draw(NUMBER), 0.0], "q_h": [draw(NUMBER), 0.0],
        })  # fmt: skip
    return found


@SETTINGS
@given(values=arms())
def test_arms_step_at_once_as_they_do_alone(drive: Any, version: str, values: list[Any]) -> None:
    alone, at_once = ([drive(ARM, version) for _ in values] for _ in range(2))
    try:
        for some in (alone, at_once):
            for d, found in zip(some, values, strict=True):
                for name, value in found.items():
                    assert d.set(name, value) == OK
                d.go_to("step")
        for k in range(3):
            one = [d.step(k * H, H) for d in alone]
            assert together(at_once, k * H, H) == one
            assert [d.outputs() for d in at_once] == [d.outputs() for d in alone]
            assert [d.log.take() for d in at_once] == [d.log.take() for d in alone]
    finally:
        for d in (*alone, *at_once):
            d.free()


@pytest.mark.parametrize("wrong", ["time", "input", "mode"])
def test_what_one_of_them_is_refused_the_others_are_not(
    drive: Any, version: str, wrong: str
) -> None:
    some = [drive(ARM, version) for _ in range(6)]
    for i, d in enumerate(some):
        d.set("dq", [1.0, float(i)])
        d.go_to("terminated" if wrong == "mode" and i == 2 else "step")
    if wrong == "time":
        assert some[2].step(0.0, H) == OK
    if wrong == "input":
        some[2].set("tau", [0.0, float("nan")])
    before = [d.outputs() for d in some]
    expected = DISCARD if wrong == "input" else ERROR
    assert together(some, 0.0, H) == [OK, OK, expected, OK, OK, OK]
    after = [d.outputs() for d in some]
    assert [a != b for a, b in zip(after, before, strict=True)] == [i != 2 for i in range(6)]
    assert [len(d.log.take()) for d in some] == [int(i == 2) for i in range(6)]


def test_only_models_that_can_say_so(drive: Any, version: str) -> None:
    lanes = drive(ARM, version).library.kernel_lanes
    assert lanes() == 4
    assert drive(teleoperation.model(2), version).library.kernel_lanes() == 1
