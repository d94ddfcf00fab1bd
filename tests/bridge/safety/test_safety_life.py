"""Life cycle, watchdogs and peers: causes of a stop, and conditions of the next start."""

from __future__ import annotations

import ctypes as c
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native import safety as native
from bridge.native.safety import Command, LifeState, LifeStruct, Peer, WatchdogStruct, Why
from bridge.safety.limits import LifeSpec, PeerSpec, WatchdogSpec, step
from cosim.base.errors import ScenarioError

NOT_YET = Why.PEER | Why.STALE | Why.WATCHDOG | Why.OVERRUN | Why.SYNC | Why.APART
AT_ONCE = [why for why in Why if why not in NOT_YET and why != Why.COMMAND]
MS = 1_000_000


def tick(life: LifeStruct, command: Command = Command.NONE, now: int = 0) -> LifeState:
    life.commands, life.now = command, life.now | now
    return step(life)


def inactive(ramp_ticks: int = 4) -> LifeStruct:
    return LifeStruct(state=LifeState.INACTIVE, ramp_ticks=ramp_ticks)


def active(ramp_ticks: int = 4) -> LifeStruct:
    life = inactive(ramp_ticks)
    tick(life, Command.ARM)
    assert tick(life, Command.START) == LifeState.ACTIVE
    return life


def test_start_needs_arming() -> None:
    life = inactive()
    assert tick(life, Command.START) == LifeState.INACTIVE
    assert life.refused == Why.COMMAND
    assert tick(life, Command.ARM) == LifeState.INACTIVE
    assert (life.armed, life.refused, life.scale) == (1, 0, 0.0)
    assert tick(life, Command.START) == LifeState.ACTIVE
    assert (life.refused, life.scale) == (0, 1.0)


@pytest.mark.parametrize("why", [why for why in Why if why != Why.COMMAND])
def test_any_reason_ramps_the_torque_down_and_latches(why: Why) -> None:
    life = active()
    scales = []
    states = [tick(life, now=why)]
    while life.state == LifeState.STOPPING:
        scales.append(life.scale)
        states.append(tick(life))
    assert scales == [0.75, 0.5, 0.25]
    assert life.scale == 0.0
    assert states == [LifeState.STOPPING] * 3 + [LifeState.FAULT]
    for command in (Command.ARM, Command.START, Command.STOP):
        assert tick(life, command) == LifeState.FAULT
        assert life.reasons == why
    assert tick(life, Command.RESET) == LifeState.INACTIVE
    assert (life.reasons, life.armed) == (0, 0)
    assert tick(life, Command.START) == LifeState.INACTIVE  # armed anew, not merely reset
    assert tick(life, Command.ARM) == LifeState.INACTIVE
    assert tick(life, Command.START) == LifeState.ACTIVE


def test_a_stop_by_command_ends_inactive_and_latched() -> None:
    life = active(ramp_ticks=2)
    assert tick(life, Command.STOP) == LifeState.STOPPING
    assert tick(life) == LifeState.INACTIVE
    assert life.reasons == Why.COMMAND
    tick(life, Command.ARM)
    assert (life.refused, life.armed) == (Why.COMMAND, 0)
    tick(life, Command.RESET)
    tick(life, Command.ARM)
    assert life.armed


def test_a_reason_that_comes_during_a_stop_makes_it_a_fault_and_does_not_restart_the_ramp() -> None:
    life = active()
    tick(life, Command.STOP)
    assert tick(life, Command.RESET, now=Why.SYNC) == LifeState.STOPPING
    assert life.scale == 0.5
    tick(life)
    assert tick(life) == LifeState.FAULT
    assert life.reasons == Why.COMMAND | Why.SYNC


@pytest.mark.parametrize("ramp", [0, 1, -3])
def test_without_a_ramp_the_torque_goes_at_once(ramp: int) -> None:
    life = active(ramp_ticks=ramp)
    assert tick(life, now=Why.ESTOP) == LifeState.FAULT
    assert life.scale == 0.0


@pytest.mark.parametrize("why", list(NOT_YET))
def test_what_is_not_there_yet_refuses_to_arm_or_start_and_is_not_latched(why: Why) -> None:
    life = inactive()
    for command in (Command.NONE, Command.ARM, Command.START):
        assert tick(life, command, now=why) == LifeState.INACTIVE
        assert (life.reasons, life.armed) == (0, 0)
    assert life.refused == why
    tick(life, Command.ARM)
    assert tick(life, Command.START, now=why) == LifeState.FAULT  # armed: everybody was there
    assert life.reasons == why


@pytest.mark.parametrize("why", AT_ONCE)
def test_other_reasons_latch_before_the_start_too(why: Why) -> None:
    life = inactive()
    assert tick(life, now=why) == LifeState.FAULT
    assert tick(life, Command.RESET, now=why) == LifeState.FAULT  # still so
    assert life.reasons == why
    assert tick(life, Command.RESET) == LifeState.INACTIVE


@pytest.mark.parametrize("command", [Command.STOP, Command.RESET])
def test_stop_and_reset_disarm(command: Command) -> None:
    life = inactive()
    tick(life, Command.ARM)
    tick(life, command)
    assert not life.armed
    assert life.reasons == 0


def test_a_ramp_overwritten_by_accident_starts_no_higher_than_full() -> None:
    life = active()
    tick(life, Command.STOP)
    life.ramp = 1000
    tick(life)
    assert life.scale == 0.75


@pytest.mark.parametrize("state", [LifeState.UNCONFIGURED, LifeState.FINISHED])
def test_what_is_not_configured_or_finished_does_not_start(state: LifeState) -> None:
    life = LifeStruct(state=state, ramp_ticks=3)
    for command in Command:
        assert tick(life, command) == state
        assert life.scale == 0.0
        assert life.refused or command in (Command.NONE, Command.STOP)


@given(
    ticks=st.lists(
        st.tuples(st.integers(-1, 6), st.just(0) | st.sampled_from([int(w) for w in Why])),
        max_size=40,
    ),
    ramp=st.integers(-2, 5),
)
def test_whatever_is_commanded(ticks: list[tuple[int, int]], ramp: int) -> None:
    """Torque only when started since it was armed, never with a reason; down without a jump up."""
    life, seen = inactive(ramp), []
    for command, now in ticks:
        before = LifeState(life.state), bool(life.armed), life.reasons
        life.commands, life.now = command, now
        state = step(life)
        assert (life.commands, life.now) == (0, 0)
        assert 0.0 <= life.scale <= 1.0
        assert (life.scale == 1.0) == (state == LifeState.ACTIVE)
        assert not (state == LifeState.ACTIVE and life.reasons)
        if state == LifeState.ACTIVE and before[0] != LifeState.ACTIVE:
            assert (before, command, now) == ((LifeState.INACTIVE, True, 0), Command.START, 0)
        if command != Command.RESET:
            assert life.reasons & before[2] == before[2]
        if state == LifeState.FAULT:
            assert life.reasons
        seen.append(life.scale)
    assert all(b <= a or b == 1.0 for a, b in pairwise(seen))


@given(
    numbers=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=5, max_size=5),
    why=st.integers(0, 99),
)
def test_a_struct_overwritten_by_accident_gives_no_torque_above_full(
    numbers: list[int], why: int
) -> None:
    state, armed, command, ramp_ticks, ramp = numbers
    life = LifeStruct(state, armed, why, 0, command, ramp_ticks, ramp, 0, 5.0)
    after = step(life)
    assert 0.0 <= life.scale <= 1.0
    if state not in list(LifeState):
        assert after == LifeState.FAULT
        assert life.reasons & Why.COMPONENT


@pytest.mark.parametrize(("ramp", "h", "ticks"), [(0.1, 5e-3, 20), ("3 ms", 1e-3, 3), (0, 1e-3, 0),
                                                  ("2.5 ms", 1e-3, 3)])  # fmt: skip
def test_the_ramp_in_ticks(ramp: float | str, h: float, ticks: int) -> None:
    life = LifeSpec(ramp).build(h)
    assert (life.ramp_ticks, life.state) == (ticks, LifeState.UNCONFIGURED)


def test_specs_that_cannot_be_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"life\.ramp: is -1 s"):
        LifeSpec(-1.0).build(1e-3)
    with pytest.raises(ScenarioError, match=r"tau\.timeout: .* cannot feed"):
        WatchdogSpec("5 rad").build(0, "tau")
    with pytest.raises(ScenarioError, match="at least 1 us"):
        WatchdogSpec("5 ns").build(0)
    with pytest.raises(ScenarioError, match="required peer"):
        PeerSpec(2, timeout=0).build(0)


# --- watchdogs -------------------------------------------------------------------------------


def expired(watchdog: WatchdogStruct, now_ns: int) -> bool:
    return bool(native.functions().watchdog_check(c.byref(watchdog), now_ns))


def test_a_watchdog_expires_after_its_time_and_stays_so() -> None:
    lib = native.functions()
    dog = WatchdogSpec("5 ms").build(10 * MS)
    assert not expired(dog, 15 * MS)
    lib.watchdog_feed(c.byref(dog), 15 * MS)
    assert not expired(dog, 20 * MS)
    assert expired(dog, 20 * MS + 1)
    lib.watchdog_feed(c.byref(dog), 21 * MS)
    assert expired(dog, 21 * MS)
    assert dog.trips == 1
    lib.watchdog_reset(c.byref(dog), 30 * MS)
    assert not expired(dog, 35 * MS)
    assert expired(dog, 36 * MS)
    assert dog.trips == 2


def test_a_watchdog_that_is_off_never_expires_and_food_of_the_past_does_not_count() -> None:
    assert not expired(WatchdogSpec().build(0), 10**18)
    dog = WatchdogSpec("5 ms").build(10 * MS)
    native.functions().watchdog_feed(c.byref(dog), 1 * MS)
    assert dog.last_ns == 10 * MS


# --- peers -----------------------------------------------------------------------------------


def beat(peer: Peer, state: LifeState, now_ns: int, boots: int = 1) -> Why:
    return Why(native.functions().peer_heartbeat(c.byref(peer), state, boots, now_ns))


def check(peer: Peer, now_ns: int) -> Why:
    return Why(native.functions().peer_check(c.byref(peer), now_ns))


def test_a_peer_is_lost_when_silent_and_there_when_heard_again() -> None:
    peer = PeerSpec(2, "50 ms").build(0)
    assert check(peer, 50 * MS) == 0
    assert check(peer, 51 * MS) == Why.PEER
    assert beat(peer, LifeState.INACTIVE, 60 * MS) == 0
    assert check(peer, 61 * MS) == 0
    assert peer.heartbeat.trips == 1


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (LifeState.INACTIVE, 0),
        (LifeState.ACTIVE, 0),
        (LifeState.STOPPING, Why.PEER),
        (LifeState.FAULT, Why.PEER),
        (LifeState.FINISHED, 0),
    ],
)
def test_a_peer_that_stops_stops_those_who_require_it(state: LifeState, expected: int) -> None:
    for required in (True, False):
        peer = PeerSpec(2, "50 ms", required=required).build(0)
        beat(peer, state, MS)
        assert check(peer, 2 * MS) == (expected if required else 0)


@pytest.mark.parametrize("state", list(LifeState))
def test_only_a_fault_of_who_takes_torques_means_that_drives_are_off(state: LifeState) -> None:
    peer = PeerSpec(2, "50 ms").build(0)
    peer.takes = 1
    beat(peer, state, MS)
    assert bool(check(peer, 2 * MS) & Why.DRIVE) == (state == LifeState.FAULT)


def test_a_peer_that_has_finished_may_be_silent() -> None:
    peer = PeerSpec(2, "50 ms").build(0)
    beat(peer, LifeState.FINISHED, MS)
    assert check(peer, 999 * MS) == 0


@pytest.mark.parametrize("state", list(LifeState))
@pytest.mark.parametrize("required", [True, False])
def test_another_number_of_boots_is_a_restart_whatever_the_peer_did(
    state: LifeState, required: bool
) -> None:
    """Also of one that had not yet left its first state, UNCONFIGURED."""
    peer = PeerSpec(2, "50 ms", required=required).build(0)
    assert beat(peer, state, MS, boots=7) == beat(peer, state, 2 * MS, boots=7) == 0
    assert beat(peer, LifeState.ACTIVE, 3 * MS, boots=8) == (Why.PEER if required else 0)


def test_a_restart_is_noticed_once() -> None:
    peer = PeerSpec(2).build(0)
    assert beat(peer, LifeState.ACTIVE, MS, boots=7) == 0  # the first is no restart
    assert beat(peer, LifeState.INACTIVE, 2 * MS, boots=8) == Why.PEER
    assert beat(peer, LifeState.INACTIVE, 3 * MS, boots=8) == 0
