"""Several instances stepped at once: the same bits, statuses and messages as one by one."""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.model import Model, Variable, clocked, exchanged
from fmus.models import (
    abdessameud2014,
    arm,
    arm_abdessameud2014,
    arm_teleoperation,
    chopra,
    nuno_adaptive,
    planar2r,
    pointmass,
    teleoperation,
    wang2014,
    xi,
)

ARM = planar2r.model()
MODELS = [
    ARM,
    teleoperation.model(4),
    teleoperation.model(1, gravity=1),
    teleoperation.model(0),
    pointmass.model(),
    arm.model(joints=4),
    arm_teleoperation.model(joints=3, neighbours=2),
    wang2014.model(neighbours=2),
    nuno_adaptive.model(),
    chopra.model(),
    abdessameud2014.model(),
    arm_abdessameud2014.model(joints=2),
]
H = 1e-3
OK, DISCARD, ERROR = 0, 2, 3
SETTINGS = settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
#: Values that an arm cannot have if they are drawn one by one.
FORM = ("rotation", "inertia")
Drive = Callable[..., Any]


@pytest.fixture(params=["2.0", "3.0"])
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def advance(drivers: list[Any], times: list[float], h: float) -> list[tuple[int, int]]:
    """The function beyond FMI: status and number of steps of each."""
    d, n = drivers[0], len(drivers)
    call = getattr(d.library, f"fmi{d.version[0]}_advance")
    call.argtypes = (
        *(c.c_void_p, c.c_size_t, c.c_void_p, c.c_size_t, c.c_double, c.c_void_p, c.c_void_p),
    )
    call.restype = None
    status, made = (c.c_int * n)(*([77] * n)), (c.c_size_t * n)(*([77] * n))
    handles = (c.c_void_p * n)(*(d.handle for d in drivers))
    call(handles, n, (c.c_double * len(times))(*times), len(times), h, status, made)
    return list(zip(status, made, strict=True))


def alone(d: Any, times: list[float], h: float) -> tuple[int, int]:
    """The same steps by doStep."""
    for made, t in enumerate(times):
        status = d.step(t, h)
        if status != OK:
            return status, made
    return OK, len(times)


@contextmanager
def instances(drive: Drive, model: Model, version: str, n: int) -> Iterator[list[Any]]:
    some = [drive(model, version) for _ in range(n)]
    try:
        yield some
    finally:
        for d in some:
            d.free()


def everything(d: Any) -> bytes:
    """All values of an instance and its time, hidden ones as well."""
    state = d.save()
    try:
        found: bytes = d.serialize(state)
        return found
    finally:
        d.free_state(state)


class Drawn:
    """Random values of a model's variables, in their ranges."""

    def __init__(self, model: Model, seed: int) -> None:
        self.model, self.random = model, np.random.default_rng(seed)
        self.usual = {v.name: self._integers(v) for v in model.variables if v.type != "real"}

    def _integers(self, v: Variable) -> list[int]:
        low, high = v.minimum or 0.0, 3.0 if v.maximum is None else v.maximum
        return [int(x) for x in self.random.integers(int(low), int(high) + 1, v.size)]

    def start(self, share: float) -> dict[str, Any]:
        """Values before the start, of a share of the variables: most integers as all instances
        have them, and the form of an arm as it is.
        """
        values: dict[str, Any] = {}
        for v in self.model.variables:
            if v.type != "real":
                values[v.name] = self._integers(v) if self._rarely(20) else self.usual[v.name]
            elif (v.causality == "parameter" or v.settable) and v.name not in FORM:
                near = np.asarray(v.starts).clip(-4.0, 4.0) * self.random.uniform(0.0, 2.0, v.size)
                near += self.random.uniform(-1.0, 1.0, v.size) * self._rarely(2)
                if self.random.uniform() < share:
                    values[v.name] = near.clip(v.minimum, v.maximum)
        return values

    def inputs(self) -> dict[str, Any]:
        """All inputs; few are large or no number."""
        values: dict[str, Any] = {}
        for v in self.model.variables:
            if v.causality == "input":
                size = self.random.choice([1.0, 20.0, 1e7, np.nan], p=[0.65, 0.34, 0.005, 0.005])
                values[v.name] = self.random.uniform(-1.0, 1.0, v.size) * size
        return values

    def _rarely(self, once_in: int) -> bool:
        return bool(self.random.integers(once_in) == 0)


def begin(both: tuple[Any, Any], drawn: Drawn) -> None:
    """Start two instances with the same values, if need be after some that cannot be."""
    late = H if drawn.random.integers(20) == 0 else 0.0
    for attempt in range(5):
        values = drawn.start(0.5**attempt)
        found = []
        for d in both:
            given = [d.set(name, value) for name, value in values.items()]
            found.append((given, d.enter(late), d.leave(), d.log.take()))
        assert found[0] == found[1]
        if found[0][2] == OK:
            return
        for d in both:
            assert d("Reset") == OK
    for d in both:
        d.go_to("step")


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.identifier)
@SETTINGS
@given(n=st.integers(1, 19), seed=st.integers(0, 2**32))
def test_instances_step_at_once_as_they_do_alone(
    drive: Drive, version: str, model: Model, n: int, seed: int
) -> None:
    drawn = Drawn(model, seed)
    with (
        instances(drive, model, version, n) as some,
        instances(drive, model, version, n) as at_once,
    ):
        for both in zip(some, at_once, strict=True):
            begin(both, drawn)
        tick = 0
        for steps in drawn.random.choice([1, 1, 2, 5], 4).tolist():
            for both in zip(some, at_once, strict=True):
                for name, value in drawn.inputs().items():
                    assert len({d.set(name, value) for d in both}) == 1
            times = [k * H for k in range(tick, tick + steps)]
            tick += steps
            expected = [alone(d, times, H) for d in some]
            assert advance(at_once, times, H) == expected
            assert [everything(d) for d in at_once] == [everything(d) for d in some]
            assert [d.log.take() for d in at_once] == [d.log.take() for d in some]


@pytest.mark.parametrize("wrong", ["time", "input", "mode"])
def test_what_one_of_them_is_refused_the_others_are_not(
    drive: Drive, version: str, wrong: str
) -> None:
    with instances(drive, ARM, version, 6) as some:
        for i, d in enumerate(some):
            d.set("dq", [1.0, float(i)])
            d.go_to("terminated" if wrong == "mode" and i == 2 else "step")
        if wrong == "time":
            assert some[2].step(0.0, H) == OK
        if wrong == "input":
            some[2].set("tau", [0.0, float("nan")])
        before = [d.outputs() for d in some]
        expected = DISCARD if wrong == "input" else ERROR
        found = [(OK, 1)] * 6
        found[2] = expected, 0
        assert advance(some, [0.0], H) == found
        after = [d.outputs() for d in some]
        assert [a != b for a, b in zip(after, before, strict=True)] == [i != 2 for i in range(6)]
        assert [len(d.log.take()) for d in some] == [int(i == 2) for i in range(6)]


@pytest.mark.parametrize("wrong", ["stop", "time"])
def test_a_step_that_may_not_be_asked_for_ends_them(drive: Drive, version: str, wrong: str) -> None:
    """After the stop time of one, or not where the last one ended, for all."""
    times = [0.0, H, 2 * H, (2 if wrong == "time" else 3) * H, 4 * H]
    with instances(drive, ARM, version, 9) as some:
        for i, d in enumerate(some):
            d.set("dq", [1.0, float(i)])
            d.enter(0.0, 3 * H if wrong == "stop" and i == 1 else None)
            d.leave()
        late = (ERROR, 3)
        assert advance(some, times, H) == [
            late if wrong == "time" or i == 1 else (OK, 5) for i in range(9)
        ]
        assert [len(d.log.take()) for d in some] == [wrong == "time" or i == 1 for i in range(9)]


def test_only_models_that_can_say_so(drive: Drive, version: str) -> None:
    with instances(drive, ARM, version, 1) as (arm,):
        assert arm.library.kernel_lanes() in (4, 8)
    with instances(drive, xi.model(), version, 2) as some:
        assert some[0].library.kernel_lanes() == 1
        for d in some:
            d.go_to("step")
        assert advance(some, [0.0, H], H) == [(OK, 2)] * 2
    assert not exchanged(ARM).lanes
    assert not clocked(teleoperation.model(1), H).lanes
