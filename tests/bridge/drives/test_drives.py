"""The emulated drive: torque as it acts, states, watchdog, resolution."""

from __future__ import annotations

from math import exp, expm1, inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from bridge.drives.model import Drive, DriveSpec
from bridge.native.safety import DriveRequest, DriveState
from cosim.base.errors import ScenarioError

H, MS = 1e-3, 1_000_000
SPEC = DriveSpec(tau_max=10.0, watchdog="5 ms", damping=0.5)


def enabled(spec: DriveSpec = SPEC, joints: int = 1) -> Drive:
    drive = spec.build(joints, H)
    assert drive.request(DriveRequest.POWER_ON, 0) == DriveState.READY
    assert drive.request(DriveRequest.ENABLE, 0) == DriveState.ENABLED
    return drive


# --- torque ----------------------------------------------------------------------------------


def test_without_lag_the_command_acts_at_once_within_its_limit() -> None:
    drive = enabled(joints=2)
    assert drive.step([3.0, -99.0], True, [0, 0], 0).tolist() == [3.0, -10.0]


@given(lag=st.floats(1e-5, 10), command=st.floats(-10, 10), before=st.floats(-10, 10))
def test_the_current_loop_is_exact_and_what_acts_is_its_mean(
    lag: float, command: float, before: float
) -> None:
    """tau(t) = command + (before - command) exp(-t / lag): its end, and its mean over h."""
    drive = enabled(replace(SPEC, lag=lag))
    drive.tau[0] = before
    torque = drive.step([command], True, [0.0], 0)[0]
    end = command + (before - command) * exp(-H / lag)
    mean = command + (before - command) * -expm1(-H / lag) * lag / H
    assert np.isclose(drive.tau[0], end, rtol=1e-13, atol=1e-13)
    assert np.isclose(torque, mean, rtol=1e-12, atol=1e-12)


@given(x=st.floats(1e-6, 50))
def test_the_exponential_is_as_good_as_that_of_libm(x: float) -> None:
    drive = enabled(replace(SPEC, lag=H / x))
    drive.step([1.0], True, [0.0], 0)
    assert np.isclose(drive.tau[0], -expm1(-H / drive.struct.lag), rtol=1e-15, atol=2.3e-16)


def test_nothing_of_the_torque_outlives_a_disable() -> None:
    drive = enabled(replace(SPEC, lag=5e-3))
    drive.step([4.0], True, [0.0], 0)
    assert drive.tau[0] > 0
    drive.request(DriveRequest.DISABLE, 0)
    drive.request(DriveRequest.ENABLE, 0)
    assert drive.step([0.0], True, [0.0], 0)[0] == 0.0


def test_ten_steps_are_one_step_of_ten_times_the_length() -> None:
    """The exponential property: what only an exact discretisation has."""
    fine, coarse = (
        enabled(replace(SPEC, lag=5e-3)),
        DriveSpec(lag=5e-3, watchdog=0).build(1, 10 * H),
    )
    coarse.request(DriveRequest.POWER_ON, 0)
    coarse.request(DriveRequest.ENABLE, 0)
    acted = [fine.step([4.0], True, [0.0], k * MS)[0] for k in range(10)]
    assert np.isclose(np.mean(acted), coarse.step([4.0], True, [0.0], 0)[0], rtol=1e-13)
    assert np.isclose(fine.tau[0], coarse.tau[0], rtol=1e-13)


@given(
    commands=st.lists(st.floats(), max_size=8), dq=st.floats(), lag=st.floats(0, 1),
    lsb=st.floats(0, 1),
)  # fmt: skip
def test_no_command_gets_more_than_tau_max_out(
    commands: list[float], dq: float, lag: float, lsb: float
) -> None:
    drive = enabled(replace(SPEC, lag=lag, tau_lsb=lsb))
    for k, command in enumerate(commands):
        torque = drive.step([command], True, [dq], k * MS)
        assert np.abs(torque[0]) <= 10.0
        if not np.isfinite(command):
            assert drive.state == DriveState.FAULT


# --- states ----------------------------------------------------------------------------------


def test_every_request_in_every_state() -> None:
    """OFF -ON-> READY -ENABLE-> ENABLED -DISABLE-> READY; FAULT -CLEAR-> READY; any -OFF-> OFF; and
    with power any -TRIP-> FAULT.
    """
    allowed = {
        (DriveState.OFF, DriveRequest.POWER_ON): DriveState.READY,
        (DriveState.READY, DriveRequest.ENABLE): DriveState.ENABLED,
        (DriveState.ENABLED, DriveRequest.DISABLE): DriveState.READY,
        (DriveState.FAULT, DriveRequest.CLEAR): DriveState.READY,
        (DriveState.READY, DriveRequest.TRIP): DriveState.FAULT,
        (DriveState.ENABLED, DriveRequest.TRIP): DriveState.FAULT,
    }
    drive = SPEC.build(1, H)
    for state in DriveState:
        for request in DriveRequest:
            drive.struct.state = state
            off = request == DriveRequest.POWER_OFF
            expected = DriveState.OFF if off else allowed.get((state, request), state)
            assert drive.request(request, 0) == expected


@pytest.mark.parametrize("state", [DriveState.OFF, DriveState.READY])
def test_a_drive_that_is_not_enabled_gives_no_torque(state: DriveState) -> None:
    drive = SPEC.build(1, H)
    drive.struct.state = state
    assert drive.step([3.0], True, [2.0], 0)[0] == 0.0


def test_the_watchdog_latches_a_fault_that_damps() -> None:
    drive = enabled()
    assert drive.step([3.0], True, [1.0], MS)[0] == 3.0
    held = [drive.step([3.0], False, [1.0], k * MS)[0] for k in range(2, 7)]
    assert held == [3.0] * 5  # held until 5 ms have passed
    assert drive.step([3.0], False, [1.0], 7 * MS)[0] == -0.5
    assert drive.state == DriveState.FAULT
    assert drive.step([3.0], True, [2.0], 8 * MS)[0] == -1.0  # commands again: still a fault
    assert drive.request(DriveRequest.ENABLE, 9 * MS) == DriveState.FAULT
    assert drive.request(DriveRequest.CLEAR, 9 * MS) == DriveState.READY
    assert drive.request(DriveRequest.ENABLE, 9 * MS) == DriveState.ENABLED
    assert drive.step([3.0], True, [1.0], 10 * MS)[0] == 3.0
    assert drive.struct.faults == 1


def test_without_damping_a_fault_freewheels_and_damping_keeps_to_the_limit() -> None:
    for damping, dq, expected in (
        (0.0, 1.0, 0.0),
        (0.0, nan, 0.0),
        (0.5, 99.0, -10.0),
        (0.5, nan, 0),
    ):
        drive = enabled(replace(SPEC, damping=damping))
        assert drive.step([nan], True, [dq], 0)[0] == expected
        assert drive.state == DriveState.FAULT


# --- resolution ------------------------------------------------------------------------------


@given(q=st.floats(-1e3, 1e3), dq=st.floats(-1e3, 1e3), lsb=st.floats(1e-6, 1e-1))
def test_encoders_say_multiples_of_their_resolution(q: float, dq: float, lsb: float) -> None:
    seen_q, seen_dq = replace(SPEC, q_lsb=lsb, dq_lsb=2 * lsb).build(1, H).measure([q], [dq])
    assert seen_q[0] == np.rint(q / lsb) * lsb
    assert seen_dq[0] == np.rint(dq / (2 * lsb)) * (2 * lsb)


def test_without_resolution_and_beyond_numbers_it_says_what_is() -> None:
    drive = SPEC.build(3, H)
    assert drive.measure([0.1, 2.0, 3.0], [0.1, 0.2, 0.3])[0].tolist() == [0.1, 2.0, 3.0]
    coarse = replace(SPEC, q_lsb=0.5).build(3, H)
    assert np.array_equal(coarse.measure([nan, inf, 1e300], [0, 0, 0])[0], [nan, inf, 1e300], True)


def test_the_torque_has_the_resolution_of_the_current_loop() -> None:
    assert enabled(replace(SPEC, tau_lsb=0.25)).step([1.1], True, [0.0], 0)[0] == 1.0


# --- construction ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (DriveSpec(lag=-1.0), r"slave\.drive\.lag: is -1 s, expected 0 or more"),
        (DriveSpec(q_lsb="1 s"), r"q_lsb: \[s\] cannot feed \[rad\]"),
        (DriveSpec(tau_max=(1.0,)), "tau_max: has 1 values, expected 1 or 2"),
        (DriveSpec(tau_max=nan), "is NaN"),
        (DriveSpec(damping=inf), "damping: is inf"),
        (DriveSpec(watchdog=-1.0), r"watchdog\.timeout"),
    ],
)
def test_drives_that_cannot_be_are_refused(spec: DriveSpec, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        spec.build(2, H, "slave.drive")
    for joints, h in ((0, H), (1, nan)):
        with pytest.raises(ScenarioError):
            SPEC.build(joints, h)
