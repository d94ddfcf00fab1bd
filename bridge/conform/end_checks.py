"""Rules about the end of a run, and about a participant that is started again."""

from __future__ import annotations

from bridge.conform.cast import EpochFields
from bridge.conform.checks import (
    TOLERANCE,
    BrokenRuleError,
    Check,
    CheckScene,
    expect_stop,
    needs_epoch,
    needs_program,
    nominal_ns,
    seconds_since,
    state_text,
    torque_messages,
    torque_values,
)
from bridge.conform.hearing import Heard, HeardFrame
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import OBEYS, ParticipantStage
from bridge.native.enums import NMT_STOP, LifeState, Why
from cosim.base.clock import monotonic_ns, sleep

#: s from joining to the end of the run, and s of silence that are looked at.
LEFT, SILENCE = 2.0, 0.5
#: s within which a participant has to join.
JOINS = 4.0


def _stops(stage: ParticipantStage) -> str:
    mark = len(stage.hearing)
    stage.command(NMT_STOP)
    stop = expect_stop(stage, mark, OBEYS, Why.COMMAND, "STOP")
    beat = stage.wait_beat(stage.seconds("ramp") + OBEYS, LifeState.INACTIVE, since=mark)
    if beat is None:
        raise BrokenRuleError(f"{state_text(stage)} after the ramp of STOP, expected INACTIVE")
    sleep(0.1)
    stage.stopped = True
    for name in torque_messages(stage):
        last = _last_sample(stage, name, mark)
        if last is None or any(torque_values(stage, last)):
            raise BrokenRuleError(f"the last torque is {last.text() if last else 'none'}")
    return f"{stop.text()}, then {beat.text()}"


def _last_sample(stage: ParticipantStage, name: str, mark: int) -> HeardFrame | None:
    found = [f for f in stage.hearing.since(mark, Heard.SAMPLE) if f.name == name and f.values]
    return found[-1] if found else None


def _silent_after_stop(stage: ParticipantStage) -> str:
    if not stage.stopped:
        stage.make_active()
        _stops(stage)
    return _no_torque(stage, "STOP")


def _no_torque(stage: ParticipantStage, what: str) -> str:
    """For `SILENCE` nothing comes that could move a motor."""
    mark = len(stage.hearing)
    sleep(SILENCE)
    heard = stage.hearing.since(mark)
    for f in heard:
        if f.state in (LifeState.ACTIVE, LifeState.STOPPING) and f.kind is Heard.HEARTBEAT:
            raise BrokenRuleError(f"{f.text()} tells {f.state_name} after {what}")
        if f.kind is Heard.SAMPLE and any(torque_values(stage, f)):
            raise BrokenRuleError(f"torque after {what}: {f.text()}")
        told = f.kind is Heard.SAMPLE and stage.hearing.tells_state(f.name)
        if told and f.state is LifeState.ACTIVE:
            raise BrokenRuleError(f"{f.text()} tells ACTIVE after {what}")
    return f"{len(heard)} frames in {SILENCE:g} s, none with torque"


# ---- another life -----------------------------------------------------------------------------


def _join(stage: ParticipantStage) -> HeardFrame:
    """A new life joins a run that ends `LEFT` s later; its first ACTIVE heartbeat."""
    needs_program(stage)
    needs_epoch(stage)
    stage.end_life()
    stage.begin()
    mark = len(stage.hearing)
    left = min(LEFT + 1.0, stage.run_end * 0.8)
    t0_ns = monotonic_ns() - round((stage.run_end - left) * 1e9)
    stage.begin_run(t0_ns)
    stage.cast.silent = False
    began = monotonic_ns()
    while seconds_since(began) < min(JOINS, left):
        sleep(0.1)
        stage.cast.epoch(EpochFields(t0_ns))
        found = stage.hearing.wait(
            lambda f: f.kind is Heard.HEARTBEAT and f.state is LifeState.ACTIVE, mark, 0.01
        )
        if found is not None:
            return found
    raise BrokenRuleError(
        f"{state_text(stage)} {seconds_since(began):.1f} s after the first EPOCH of a running run"
    )


def _rejoins(stage: ParticipantStage) -> str:
    mark = len(stage.hearing)
    beat = _join(stage)
    sleep(0.2)
    t0 = stage.cast.t0_ns or 0
    for f in stage.hearing.since(mark, Heard.SAMPLE):
        if f.values and not stage.hearing.is_preview(f) and f.index > stage.runs[-1][0]:
            at = nominal_ns(stage, f, t0)
            if at is not None and abs(f.t_ns - at) > 0.25e9:
                raise BrokenRuleError(
                    f"{f.text()} has a time stamp {(f.t_ns - at) * 1e-9:.2f} s from its arrival"
                )
    return f"{beat.text()} at t = {stage.now_s:.1f} s of the run"


def _boots(stage: ParticipantStage) -> str:
    """Heartbeats of two lives differ in boots; in one life they are equal."""
    needs_program(stage)
    while len(stage.lives) < 2:
        stage.end_life()
        stage.begin()
    found = []
    ends = [*stage.lives[1:], len(stage.hearing)]
    for begin, end in zip(stage.lives, ends, strict=True):
        beats = [f for f in stage.hearing.since(begin, Heard.HEARTBEAT) if f.index < end]
        said = {int(f.values[2]) for f in beats if f.values}
        if len(said) > 1:
            raise BrokenRuleError(f"boots {', '.join(map(str, sorted(said)))} in one life")
        found += sorted(said)
    if len(set(found)) < len(found):
        raise BrokenRuleError(f"boots {', '.join(map(str, found))} of {len(found)} lives")
    return f"boots {', '.join(map(str, found))} of {len(found)} lives"


def _near_end(stage: ParticipantStage) -> int:
    """The participant is ACTIVE, less than `LEFT` before the end; number of a frame before it."""
    beat = stage.hearing.latest_beat()
    left = stage.run_end - stage.now_s
    active = beat is not None and beat.state is LifeState.ACTIVE and stage.program.running
    if not active or not 0.3 < left < LEFT + 1.0:
        _join(stage)
    return len(stage.hearing)


def _finishes(stage: ParticipantStage) -> str:
    mark = _near_end(stage)
    t0, since = stage.cast.t0_ns or 0, monotonic_ns()
    beat = stage.wait_beat(
        stage.run_end - stage.now_s + OBEYS, LifeState.FINISHED, LifeState.FAULT, since=mark
    )
    if beat is None or beat.state is not LifeState.FINISHED:
        raise BrokenRuleError(f"{state_text(stage)} at the end of the run, expected FINISHED")
    late = (beat.t_ns - t0) * 1e-9 - stage.run_end
    slack = 2 * stage.slot + stage.seconds("phase") + 0.1 + stage.late(since)
    if not -2 * stage.slot - TOLERANCE <= late <= slack:
        raise BrokenRuleError(f"FINISHED {late * 1e3:.0f} ms after the end of the run")
    sleep(0.05)
    for name in torque_messages(stage):
        last = _last_sample(stage, name, mark)
        if last is None or any(torque_values(stage, last)):
            raise BrokenRuleError(f"the last torque is {last.text() if last else 'none'}")
    for carried in stage.system.messages.values():
        if carried.node == stage.node and carried.encoding.message.time >= 0:
            _judge_last(stage, carried.name, mark, t0)
    return f"{beat.text()} {late * 1e3:+.0f} ms from the end"


def _judge_last(stage: ParticipantStage, name: str, mark: int, t0: int) -> None:
    """The last sample of a message is that of the last slot, or one of torque 0 after it."""
    last = _last_sample(stage, name, mark)
    at = None if last is None else nominal_ns(stage, last, t0)
    if last is None or at is None:
        raise BrokenRuleError(f"no sample of {name} at the end of the run")
    period = stage.system.messages[name].period_ns * 1e-9
    left = stage.run_end - (at - t0) * 1e-9 + stage.seconds("phase")
    if not -stage.slot - 1e-4 <= left <= period + stage.slot + 1e-4:
        raise BrokenRuleError(
            f"the last sample is {last.text()}, {left * 1e3:.1f} ms before the end of the run"
        )


def _silent_after_end(stage: ParticipantStage) -> str:
    beat = stage.hearing.latest_beat()
    if beat is None or beat.state is not LifeState.FINISHED:
        mark = _near_end(stage)
        finished = stage.wait_beat(
            stage.run_end - stage.now_s + OBEYS, LifeState.FINISHED, since=mark
        )
        if finished is None:
            raise BrokenRuleError(f"{state_text(stage)} at the end of the run")
    sleep(0.1)
    mark = len(stage.hearing)
    came = _no_torque(stage, "the end")
    found = stage.hearing.since(mark, Heard.SAMPLE)
    samples = [f for f in found if not (f.values and stage.hearing.is_preview(f))]  # of a new life
    if samples:
        raise BrokenRuleError(f"{len(samples)} samples after the end, such as {samples[0].text()}")
    return came


def _rule(number: str, title: str, clause: str, expected: str) -> ConformityRule:
    return ConformityRule(number, title, clause, expected)


END_CHECKS = (
    Check(
        _rule("C-70", "STOP", "safety.md#1-life-cycle-of-a-node",
              "STOP leads through the ramp to INACTIVE; the last torque is 0."),
        CheckScene.ENDING, _stops),
    Check(
        _rule("C-71", "silence after STOP", "safety.md#1-life-cycle-of-a-node",
              "After the ramp of STOP no torque comes, and no frame has the state ACTIVE."),
        CheckScene.OTHER_LIFE, _silent_after_stop),
    Check(
        _rule("C-73", "rejoining", "rehearsal.md#rejoining",
              "A participant that is started again joins the running run by its EPOCH; its stamps "
              "and sample numbers continue from there."),
        CheckScene.OTHER_LIFE, _rejoins),
    Check(
        _rule("C-74", "FINISHED", "safety.md#1-life-cycle-of-a-node",
              "After the last slot of the run a participant is FINISHED; its last torque is 0."),
        CheckScene.OTHER_LIFE, _finishes),
    Check(
        _rule("C-75", "silence after the end", "safety.md#1-life-cycle-of-a-node",
              "After FINISHED no sample comes."),
        CheckScene.OTHER_LIFE, _silent_after_end),
    Check(
        _rule("C-76", "boots", "can.md#messages",
              "All heartbeats of a life have the same boots, and each life has others."),
        CheckScene.OTHER_LIFE, _boots),
)  # fmt: skip
