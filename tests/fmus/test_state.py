"""Saved states: exact, portable between FMI versions, refused when damaged; no leak, no sharing."""

from __future__ import annotations

import ctypes
import gc
from ctypes import byref, c_double, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.build.archive import shipped_models
from fmus.model import Model
from fmus.models import operator, planar2r, teleoperation

OK, ERROR = 0, 3
VERSIONS = ("2.0", "3.0")
ARM = planar2r.model()
CONTROLLER = teleoperation.model(2)
BOTH = [(model, version) for model in shipped_models() for version in VERSIONS]


def run(d: Any, first: int, count: int, seed: int = 5) -> np.ndarray:
    """Step `d` from tick `first` with inputs that depend on the tick only; all outputs."""
    rows = []
    for k in range(first, first + count):
        rng = np.random.default_rng([seed, k])
        for port in d.model.inputs():
            assert d.set(port.name, rng.uniform(-1, 1, port.size)) == OK
        assert d.step(k * d.model.step, d.model.step) == OK
        rows.append(d.outputs())
    return np.array(rows)


@pytest.mark.parametrize(("model", "version"), BOTH, ids=lambda x: getattr(x, "identifier", x))
def test_a_run_continues_exactly_from_a_saved_state(drive: Any, model: Model, version: str) -> None:
    d = drive(model, version)
    d.go_to("step")
    run(d, 0, 50)
    state = d.save()
    expected = run(d, 50, 50)
    assert d.restore(state) == OK
    assert (run(d, 50, 50) == expected).all()
    other = drive(model, version)
    status, copy = other.deserialize(d.serialize(state))
    assert status == OK
    assert other.restore(copy) == OK
    assert (run(other, 50, 50) == expected).all()


@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
@pytest.mark.parametrize(("source", "target"), [("2.0", "3.0"), ("3.0", "2.0")])
def test_a_state_serialised_by_one_version_is_read_by_the_other(
    drive: Any, model: Model, source: str, target: str
) -> None:
    a, b = drive(model, source), drive(model, target)
    a.go_to("step")
    run(a, 0, 20)
    status, state = b.deserialize(a.serialize(a.save()))
    assert status == OK
    assert b.restore(state) == OK
    assert (run(a, 20, 20) == run(b, 20, 20)).all()


def test_a_failed_step_of_fmi2_may_be_taken_again_in_fmi3(drive: Any) -> None:
    a, b = drive(ARM, "2.0"), drive(ARM, "3.0")
    a.go_to("failed")
    _, state = b.deserialize(a.serialize(a.save()))
    assert b.restore(state) == OK
    assert b.set("tau", [0.0, 0.0]) == OK
    assert b.step(0.0, 1e-3) == OK


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("mode", ["instantiated", "initialization", "step", "terminated"])
def test_a_state_brings_its_mode_along(drive: Any, version: str, mode: str) -> None:
    a, b = drive(ARM, version), drive(ARM, version)
    a.go_to(mode)
    status, state = b.deserialize(a.serialize(a.save()))
    assert status == OK
    assert b.restore(state) == OK
    assert b.serialize(b.save()) == a.serialize(a.save())
    assert b.step(0.0, 1e-3) == (OK if mode == "step" else ERROR)


@pytest.mark.parametrize("version", VERSIONS)
def test_start_stop_and_time_are_part_of_the_state(drive: Any, version: str) -> None:
    a, b = drive(ARM, version), drive(ARM, version)
    assert a.enter(1.0, 1.002) == OK
    assert a.leave() == OK
    assert a.step(1.0, 1e-3) == OK
    b.restore(a.save())
    assert b.step(1.001, 1e-3) == OK
    assert b.step(1.002, 1e-3) == ERROR
    assert "stop time" in b.log.take()[-1][2]


# --- damage ----------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_state_is_refused(drive: Any, version: str, data: Any) -> None:
    d = drive(CONTROLLER, version)
    d.go_to("step")
    good = d.serialize(d.save())
    place = data.draw(st.integers(0, 8 * len(good) - 1))
    bad = bytearray(good)
    bad[place // 8] ^= 1 << place % 8
    status, state = d.deserialize(bytes(bad))
    assert status == ERROR
    assert state.value is None
    assert "state" in d.log.take()[-1][2]
    assert d.serialize(d.save()) == good
    d.free()


@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_no_state_is_refused_with_a_reason(drive: Any, version: str) -> None:
    d = drive(CONTROLLER, version)
    d.go_to("step")
    good = d.serialize(d.save())
    other = drive(operator.model(), version)
    other.go_to("step")
    for data, words in [
        (b"", "0 bytes"),
        (good[:40], "40 bytes"),
        (good[:-1], f"{len(good) - 1} bytes"),
        (good + b"\0", f"{len(good) + 1} bytes"),
        (b"x" * len(good), "no state"),
        (good[:8] + b"\x02" + good[9:], "format 2"),
        (other.serialize(other.save()), "another model than teleoperation_n2"),
        (good[:-4] + b"\0\0\0\0", "CRC-32"),
    ]:
        status, _ = d.deserialize(data)
        assert status == ERROR
        assert words in d.log.take()[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_the_layout_is_little_endian_and_documented(drive: Any, version: str) -> None:
    d = drive(operator.model(), version)
    d.go_to("step")
    d.set("q", [1.5, -2.0])
    data = d.serialize(d.save())
    count = sum(v.size for v in operator.model().variables) + 1
    assert data[:8] == b"cosimFMU"
    assert len(data) == 48 + 8 * count + 4
    assert np.frombuffer(data, "<u4", 2, 8).tolist() == [1, count]
    assert np.frombuffer(data, "<f8", 2, 48).tolist() == [1.5, -2.0]


@pytest.mark.parametrize("version", VERSIONS)
def test_pointers_that_are_no_state_are_refused(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    suffix = d.suffix()
    rubbish = (c_double * 100)()
    for pointer in (c_void_p(None), c_void_p(ctypes.addressof(rubbish))):
        assert d(f"Set{suffix}", pointer) == ERROR
        assert "state" in d.log.take()[-1][2]
        assert d(f"Serialized{suffix}Size", pointer, byref(ctypes.c_size_t())) == ERROR
    assert d(f"Get{suffix}", c_void_p(None)) == ERROR
    assert d(f"Free{suffix}", c_void_p(None)) == ERROR
    state = d.save()
    assert d(f"Serialized{suffix}Size", state, c_void_p(None)) == ERROR
    assert d(f"Serialize{suffix}", state, (c_double * 4)(), ctypes.c_size_t(32)) == ERROR
    assert "room for 32 bytes" in d.log.take()[-1][2]
    assert d.free_state(state) == OK
    assert state.value is None
    assert d.free_state(state) == OK  # freeing nothing


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_is_saved_over_an_older_one(drive: Any, version: str) -> None:
    d = drive(ARM, version)
    d.go_to("step")
    state = d.save()
    address, old = state.value, d.serialize(state)
    run(d, 0, 3)
    assert d(f"Get{d.suffix()}", byref(state)) == OK
    assert state.value == address
    assert d.serialize(state) != old


# --- many instances --------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "version"), BOTH, ids=lambda x: getattr(x, "identifier", x))
def test_interleaved_instances_are_independent(drive: Any, model: Model, version: str) -> None:
    alone = []
    for seed in (1, 2, 3):
        d = drive(model, version)
        d.go_to("step")
        alone.append(run(d, 0, 30, seed))
    together = [drive(model, version) for _ in alone]
    for d in together:
        d.go_to("step")
    rows: list[list[np.ndarray]] = [[], [], []]
    for k in range(30):
        for n, d in enumerate(together):
            rows[n].append(run(d, k, 1, n + 1)[0])
    for n, expected in enumerate(alone):
        assert (np.array(rows[n]) == expected).all()


STATM = Path("/proc/self/statm")


def resident() -> int:
    """Pages of this process that are in memory."""
    return int(STATM.read_text().split()[1])


@pytest.mark.slow
@pytest.mark.skipif(not STATM.exists(), reason="only Linux says how much memory is in use")
@pytest.mark.parametrize("version", VERSIONS)
def test_hundreds_of_instances_come_and_go_without_a_trace(drive: Any, version: str) -> None:
    def cycle() -> None:
        d = drive(ARM, version)
        d.go_to("step")
        state = d.save()
        status, copy = d.deserialize(d.serialize(state))
        assert status == OK
        assert d.step(0.0, 1e-3) == OK
        assert d.free_state(state) == d.free_state(copy) == OK
        d.free()

    for _ in range(100):
        cycle()
    gc.collect()
    before = resident()
    for _ in range(400):
        cycle()
    gc.collect()
    assert resident() - before < 40  # pages; an instance or two states each would be 80
