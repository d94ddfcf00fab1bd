"""The guard: whatever comes in, what goes out is finite and within its limits."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from bridge.drives.model import DEFAULTS, VALUES, DriveSpec
from bridge.native import safety as native
from bridge.native.safety import GuardBit, Why
from bridge.safety.limits import GuardSpec, TorqueGuard, explain, explain_guard, names
from cosim.base.errors import ScenarioError

H, TAU = 1e-3, (10.0, 4.0)
SPEC = GuardSpec(
    tau_max=TAU, rate_max=500.0, q_low=-1.0, q_high=1.0, dq_max=3.0, power_max=12.0,
    q_jump=0.1, brake=2.0,
)  # fmt: skip
anything = arrays(np.float64, 2, elements=st.floats(width=64))
near = arrays(np.float64, 2, elements=st.floats(-20, 20))
ticks = st.lists(
    st.tuples(anything | near, anything | near, anything | near, st.floats() | st.just(1.0)),
    max_size=12,
)


def one(spec: GuardSpec, tau: float, q: float = 0.0, dq: float = 0.0) -> tuple[float, GuardBit]:
    out, bits = spec.build(1, H).apply([tau], [q], [dq])
    return float(out[0]), bits


# --- whatever comes in -----------------------------------------------------------------------


@given(ticks=ticks)
def test_nothing_that_comes_in_gets_more_than_tau_max_out(
    ticks: list[tuple[np.ndarray, ...]],
) -> None:
    guard = SPEC.build(2, H)
    for tau, q, dq, scale in ticks:
        out, bits = guard.apply(tau, q, dq, float(scale))
        assert np.isfinite(out).all()
        assert (np.abs(out) <= TAU).all()
        refused = ~(np.isfinite(tau) & np.isfinite(q) & np.isfinite(dq))
        assert (out[refused] == 0).all()
        assert bool(bits & GuardBit.FINITE) == refused.any()


@given(ticks=ticks, brake=st.floats(0, 1e308), rate=st.floats(0, inf), power=st.floats(0, inf))
def test_without_a_limit_of_the_torque_it_is_still_finite(
    ticks: list[tuple[np.ndarray, ...]], brake: float, rate: float, power: float
) -> None:
    limits = replace(SPEC, tau_max=None, brake=brake, rate_max=rate, power_max=power)
    guard = limits.build(2, H)
    for tau, q, dq, scale in ticks:
        assert np.isfinite(guard.apply(tau, q, dq, float(scale))[0]).all()


@given(
    limits=arrays(np.float64, (7, 2), elements=st.floats()),
    ticks=ticks,
    brake=st.floats(),
    h=st.floats(),
    last=anything,
)
def test_limits_and_states_that_are_no_numbers_let_no_more_through(
    limits: np.ndarray,
    ticks: list[tuple[np.ndarray, ...]],
    brake: float,
    h: float,
    last: np.ndarray,
) -> None:
    """A struct overwritten by accident: C alone, without the checks of its construction."""
    guard = SPEC.build(2, H)
    for name, values in zip(guard.limits, limits, strict=True):
        if name != "tau_max":
            setattr(guard.struct, name, values.ctypes.data)
    guard.struct.brake, guard.struct.h = brake, h
    guard.last_tau[:], guard.last_q[:] = last, last
    for tau, q, dq, scale in ticks:
        out, _ = guard.apply(tau, q, dq, float(scale))
        assert np.isfinite(out).all()
        assert (np.abs(out) <= TAU).all()


@pytest.mark.parametrize("bad", [nan, -1.0, -inf])
def test_a_torque_limit_that_is_no_limit_lets_nothing_through(bad: float) -> None:
    guard = GuardSpec(tau_max=1.0).build(1, H)
    guard.limits["tau_max"][0] = bad  # type: ignore[index]
    assert guard.apply([5.0], [0.0], [0.0])[0][0] == 0.0


@given(tau=near, q=arrays(np.float64, 2, elements=st.floats(-1, 1)))
def test_what_is_within_all_limits_passes_to_the_last_bit(tau: np.ndarray, q: np.ndarray) -> None:
    out, bits = GuardSpec(tau_max=20.0, q_low=-1.0, q_high=1.0, dq_max=1.0).build(2, H).apply(
        tau, q, np.zeros(2)
    )  # fmt: skip
    assert np.array_equal(out, tau)
    assert bits == 0


# --- each guard trips ------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_finite(bad: float) -> None:
    """Torque, position or velocity: only the joint concerned loses its torque."""
    for place in range(3):
        guard = GuardSpec().build(2, H)
        given = [np.array([1.0, 2.0]), np.zeros(2), np.zeros(2)]
        given[place][0] = bad
        out, bits = guard.apply(*given)
        assert out.tolist() == [0.0, 2.0]
        assert bits == GuardBit.FINITE
        assert guard.why() == Why.GUARD


def test_torque() -> None:
    assert one(GuardSpec(tau_max=5.0), 7.0) == (5.0, GuardBit.TORQUE)
    assert one(GuardSpec(tau_max="5 N.m"), -7.0) == (-5.0, GuardBit.TORQUE)


def test_rate() -> None:
    """Counted from 0; 500 N.m/s is 0.5 N.m a tick."""
    guard = GuardSpec(rate_max=500.0).build(1, H)
    seen = [guard.apply([1.25], None, None) for _ in range(4)]
    assert [out[0] for out, _ in seen] == [0.5, 1.0, 1.25, 1.25]
    assert [bits for _, bits in seen] == [GuardBit.RATE, GuardBit.RATE, 0, 0]


@pytest.mark.parametrize(
    ("q", "dq", "tau", "expected"),
    [
        (1.1, 0.5, 3.0, -1.0),  # outwards: taken away; moving outwards: braked by 2 * 0.5
        (1.1, 0.5, -3.0, -4.0),  # inwards: stays, and braked
        (1.1, -0.5, -3.0, -3.0),  # returning: not braked
        (1.1, -0.5, 3.0, 0.0),
        (-1.1, -0.5, -3.0, 1.0),
        (-1.1, 0.5, -3.0, 0.0),
    ],
)
def test_position(q: float, dq: float, tau: float, expected: float) -> None:
    spec = GuardSpec(q_low=-1.0, q_high=1.0, brake=2.0)
    assert one(spec, tau, q, dq) == (expected, GuardBit.POSITION)


@pytest.mark.parametrize("q", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("dq", [-5.0, 0.0, 5.0])
def test_between_its_limits_a_joint_is_not_braked(q: float, dq: float) -> None:
    guard = GuardSpec(q_low=-1.0, q_high=1.0, brake=2.0).build(1, H)
    torques, bits = guard.apply([3.0], [q], [dq])
    assert (torques.tolist(), bits) == ([3.0], 0)


def test_the_brake_keeps_to_the_torque_limit_and_does_not_enter_the_rate() -> None:
    guard = replace(SPEC, tau_max=5.0, dq_max=None, q_jump=None).build(1, H)
    assert guard.apply([0.0], [1.5], [100.0])[0][0] == -5.0
    assert guard.apply([0.0], [1.5], [-1.0])[0][0] == 0.0


def test_velocity() -> None:
    """What accelerates goes at once, what brakes stays."""
    spec = GuardSpec(dq_max=3.0)
    assert one(spec, 2.0, dq=3.1) == (0.0, GuardBit.VELOCITY)
    assert one(spec, -2.0, dq=3.1) == (-2.0, GuardBit.VELOCITY)
    assert one(spec, -2.0, dq=-3.1) == (0.0, GuardBit.VELOCITY)
    assert one(spec, 2.0, dq=3.0) == (2.0, 0)


def test_power() -> None:
    spec = GuardSpec(power_max=6.0)
    assert one(spec, 4.0, dq=2.0) == (3.0, GuardBit.POWER)
    assert one(spec, -4.0, dq=-2.0) == (-3.0, GuardBit.POWER)
    assert one(spec, -4.0, dq=2.0) == (-4.0, 0)
    assert one(spec, 3.0, dq=2.0) == (3.0, 0)


def test_jump() -> None:
    """The joint has no torque in the tick of the jump; the first position is none."""
    guard = GuardSpec(q_jump=0.1).build(2, H)
    positions = [[5.0, 0.0], [5.05, 0.0], [5.2, 0.0], [5.2, 0.0]]
    seen = [guard.apply([1.0, 2.0], q, [0.0, 0.0]) for q in positions]
    assert [out.tolist() for out, _ in seen] == [[1, 2], [1, 2], [0, 2], [1, 2]]
    assert [bits for _, bits in seen] == [0, 0, GuardBit.JUMP, 0]
    assert guard.trips()["jump"] == 1


def test_a_jump_is_told_once_wherever_it_leads() -> None:
    guard = GuardSpec(q_jump=0.1).build(1, H)
    bits = [guard.apply([1.0], [q], [0.0])[1] for q in (0.0, 1e3, 1e3, -5.0, -5.0)]
    assert bits == [0, GuardBit.JUMP, 0, GuardBit.JUMP, 0]


@pytest.mark.parametrize("last", [nan, inf, -inf])
def test_a_rate_without_a_number_to_count_from_counts_from_zero(last: float) -> None:
    guard = GuardSpec(tau_max=9.0, rate_max=500.0).build(1, H)
    guard.last_tau[0] = last
    assert guard.apply([5.0], None, None)[0][0] == 0.5


def test_a_jump_is_seen_across_a_position_that_was_no_number() -> None:
    guard = GuardSpec(q_jump=0.1).build(1, H)
    bits = [guard.apply([1.0], [q], [0.0])[1] for q in (0.0, nan, 3.0)]
    assert bits == [0, GuardBit.FINITE, GuardBit.JUMP]


def test_what_was_taken_away_comes_back_at_the_rate() -> None:
    guard = GuardSpec(rate_max=500.0, dq_max=3.0).build(1, H)
    out = [guard.apply([1.0], [0.0], [dq])[0][0] for dq in (0.0, 0.0, 3.1, 0.0, 0.0)]
    assert out == [0.5, 1.0, 0.0, 0.5, 1.0]


def test_a_ramp_down_is_not_rate_limited_but_the_controller_behind_it_is() -> None:
    guard = GuardSpec(rate_max=500.0).build(1, H)
    for _ in range(4):
        guard.apply([2.0], None, None)
    down = [guard.apply([2.0], None, None, scale)[0][0] for scale in (0.5, 0.25)]
    assert down == [1.0, 0.5]
    assert guard.apply([-2.0], None, None, 0.25)[0][0] == 0.25 * 1.5
    assert guard.apply([9.0], None, None, 0.0) == (0.0, 0)  # and no rate is told
    assert guard.apply([2.0], None, None)[0][0] == 0.5  # from 0 again


def test_which_bits_stop_the_node() -> None:
    guard = GuardSpec(tau_max=1.0, q_jump=0.1, stops=("torque", "jump")).build(1, H)
    guard.apply([2.0], [0.0], [0.0])
    assert guard.why() == Why.GUARD
    guard.apply([0.5], [1.0], [0.0])
    assert guard.why() == Why.JUMP
    guard.apply([nan], [1.0], [0.0])
    assert guard.why() == 0


# --- construction ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (GuardSpec(tau_max=nan), r"node\.guard\.tau_max\[0\]: is NaN"),
        (GuardSpec(tau_max=(1.0, nan)), r"tau_max\[1\]: is NaN"),
        (GuardSpec(tau_max=-1.0), r"tau_max: is \[-1.0, -1.0\] N.m, expected 0 or more"),
        (GuardSpec(rate_max=(1.0, 2.0, 3.0)), r"rate_max: has 3 values, expected 1 or 2"),
        (GuardSpec(q_low=1.0, q_high=1.0), "expected low < high"),
        (GuardSpec(dq_max="3 rad"), r"dq_max\[0\]: \[rad\] cannot feed"),
        (GuardSpec(power_max="3"), "has no unit"),
        (GuardSpec(q_jump=-0.1), "q_jump"),
        (GuardSpec(brake=inf), "brake: is inf"),
        (GuardSpec(stops=("speed",)), r"stops: is 'speed', expected finite, torque"),
    ],
)
def test_limits_that_cannot_be_are_refused(spec: GuardSpec, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        spec.build(2, H, "node.guard")


def test_a_guard_without_joints_or_period_is_refused() -> None:
    for joints, h in ((0, H), (1, 0.0), (1, nan)):
        with pytest.raises(ScenarioError):
            GuardSpec().build(joints, h)
    with pytest.raises(ScenarioError, match=r"shape is \(3,\), expected \(2,\)"):
        GuardSpec().build(2, H).apply(np.zeros(3), None, None)


def test_reasons_in_words() -> None:
    assert explain(0) == "nothing"
    assert explain(Why.ESTOP | Why.SYNC) == "emergency stop; SYNC is missing"
    assert explain(1 << 20) == "unknown bits 0x100000"
    assert explain_guard(GuardBit.TORQUE | GuardBit.RATE) == "torque limit; rate limit"
    assert names(Why.COMMAND | Why.JUMP) == ("command", "jump")
    assert "unknown" not in explain(sum(Why)) + explain_guard(sum(GuardBit))


def test_a_guard_keeps_what_it_points_to() -> None:
    assert isinstance(SPEC.build(2, H), TorqueGuard)
    guards = [GuardSpec(tau_max=float(n)).build(2, H) for n in range(50)]
    assert [guard.apply([99.0, 99.0], None, None)[0][0] for guard in guards] == list(range(50))


def test_a_guard_and_a_drive_say_nothing_that_their_structs_in_c_have_not() -> None:
    where = {"port", "q", "dq"}
    guard = {name for name, *_ in native.Guard._fields_}
    assert set(GuardSpec.__struct_fields__) - where <= guard
    drive = {name for name, *_ in native.DriveStruct._fields_}
    assert set(VALUES) <= drive
    assert set(DriveSpec.__struct_fields__) - where - {"profile", "max_age"} == set(VALUES)
    assert all(getattr(DEFAULTS, name) is not None for name in VALUES if name != "tau_max")


def test_a_part_of_an_arm_has_the_limits_of_its_joints() -> None:
    spec = GuardSpec(tau_max=(1.0, 2.0, 3.0), dq_max=4.0, stops=("torque",)).part(1, 2)
    assert (spec.tau_max, spec.dq_max, spec.stops) == ((2.0, 3.0), 4.0, ("torque",))
    assert DriveSpec(tau_max=(1.0, 2.0, 3.0)).part(0, 1).tau_max == (1.0,)


def test_a_drive_has_what_is_said_then_what_its_profile_says() -> None:
    said = DriveSpec(port="u", lag=1.0, watchdog=0.0).over(DriveSpec(lag=2.0, tau_max=3.0))
    assert (said.port, said.lag, said.watchdog, said.tau_max) == ("u", 1.0, 0.0, 3.0)
    assert said.over(DEFAULTS).damping == 0.0
