"""Rules about the start, the life cycle and emergency stops."""

from __future__ import annotations

from itertools import pairwise

from bridge.conform.cast import EpochFields, copy_of
from bridge.conform.checks import (
    OF_A_SLOW_MACHINE,
    STOPPED,
    TOLERANCE,
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    VoidAttemptError,
    expect_active,
    expect_stop,
    nominal_ns,
    reason_text,
    settle,
    state_text,
    torque_messages,
    torque_values,
)
from bridge.conform.hearing import Heard, HeardFrame, has_status
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import LEAD, OBEYS, ParticipantStage
from bridge.deployment.carried import Carried
from bridge.native.enums import (
    NMT_ARM,
    NMT_RESET,
    NMT_START,
    NMT_STOP,
    LifeState,
    Status,
    Why,
)
from bridge.native.epoch import SIGNALS as EPOCH_SIGNALS
from bridge.native.frame import Flags, Frame
from cosim.base.clock import monotonic_ns, realtime_offset_ns, sleep

#: s: ESTOP is passed on so often, every 10 ms.
PASSED_ON, EVERY = 10, 0.01


# ---- before the start -------------------------------------------------------------------------


def _waits(stage: ParticipantStage) -> str:
    """Everything that has come since the program was started, peers being silent."""
    sleep(0.4)
    frames = stage.hearing.since(stage.lives[-1])
    beats = [f for f in frames if f.kind is Heard.HEARTBEAT]
    wrong = [f for f in beats if f.state is not LifeState.INACTIVE or f.armed or f.reasons]
    wrong = [f for f in wrong if f.state is not LifeState.UNCONFIGURED]
    if not beats or wrong:
        raise BrokenRuleError(f"{wrong[0].text()}" if wrong else "no heartbeat")
    told = [f for f in frames if f.kind is Heard.SAMPLE and stage.hearing.tells_state(f.name)]
    for f in told:
        if f.state not in (LifeState.INACTIVE, LifeState.UNCONFIGURED):
            raise BrokenRuleError(f"{f.text()} tells {f.state_name}")
        if any(torque_values(stage, f)):
            raise BrokenRuleError(f"a preview with torque: {f.text()}")
        carried = stage.system.messages[f.name]
        if f.counter != 0 or f.t_us != carried.offset_ns // 1000:
            raise BrokenRuleError(
                f"a preview with counter {f.counter} and stamp {f.t_us} us, expected sample 0"
            )
    sent = {m.name for m in stage.hearing.known(Heard.SAMPLE).values()}
    lacking = {n for n in sent if stage.hearing.tells_state(n)} - {f.name for f in told}
    if lacking:
        raise BrokenRuleError(f"no preview of {', '.join(sorted(lacking))} in 0.4 s")
    return f"{len(beats)} heartbeats INACTIVE, {len(told)} previews of sample 0 without torque"


def _start_alone(stage: ParticipantStage) -> str:
    """EPOCH and START while all peers are silent."""
    needs = bool(stage.spec.requires) or bool(stage.watched())
    if not needs:
        raise InapplicableRuleError("the participant needs no peer and no input")
    mark, t0_ns = len(stage.hearing), monotonic_ns() + round(0.4e9)
    stage.cast.epoch(EpochFields(t0_ns))
    stage.command(NMT_START)
    started = stage.hearing.wait(lambda f: f.state is LifeState.ACTIVE, mark, 0.4 + 0.35)
    if started is not None:
        raise BrokenRuleError(f"it started without its peers: {started.text()}")
    return f"{_still_waits(stage)} 0.35 s after t = 0"


def _start_of_others(stage: ParticipantStage) -> str:
    """START for another node, START of another length, and a command that does not exist."""
    stage.cast.silent = False
    sleep(0.2)
    mark, other = len(stage.hearing), stage.number % 31 + 1
    stage.cast.command(NMT_ARM, other)
    stage.cast.epoch(EpochFields(monotonic_ns() + round(0.15e9)))
    stage.cast.command(NMT_START, other)
    stage.cast.command(77, 0)
    for frame in _nmt_of_other_length(stage, NMT_START):
        stage.cast.send(*frame)
    started = stage.hearing.wait(
        lambda f: f.state is LifeState.ACTIVE or f.armed, mark, 0.15 + 0.35
    )
    if started is not None:
        raise BrokenRuleError(f"it obeyed a command that is not for it: {started.text()}")
    return f"{_still_waits(stage)}, not armed, 0.35 s after their t = 0"


def _still_waits(stage: ParticipantStage) -> str:
    """The state, which is INACTIVE."""
    beat = stage.wait_beat(0.5)
    if beat is None or beat.state is LifeState.INACTIVE:
        return state_text(stage)
    text = f"{beat.text()} tells {beat.state_name} for {reason_text(beat.reasons)}"
    if beat.reasons & OF_A_SLOW_MACHINE:
        raise VoidAttemptError(text)
    raise BrokenRuleError(text)


def _nmt_of_other_length(stage: ParticipantStage, command: int) -> list[tuple[str, Frame]]:
    """NMT frames for this participant that are a byte shorter and longer; CAN only."""
    found = []
    for bus, service in stage.cast.services.items():
        if service.nmt is not None and stage.system.deployment.buses[bus].kind == "can":
            for data in (bytes([command]), bytes([command, stage.number, 0])):
                found.append((bus, Frame.of(int(service.nmt.message.id), data, 0)))
    return found


def _arms(stage: ParticipantStage) -> str:
    stage.cast.silent = False
    sleep(0.2)
    stage.command(NMT_ARM)
    armed = stage.hearing.wait(lambda f: f.armed, len(stage.hearing), OBEYS)
    if armed is None or armed.state is not LifeState.INACTIVE:
        raise BrokenRuleError(f"ARM with all peers there: {state_text(stage)}, not armed")
    stage.command(NMT_STOP)
    mark = len(stage.hearing)
    beat = stage.hearing.wait(
        lambda f: f.kind is Heard.HEARTBEAT and bool(f.values) and not f.armed, mark, OBEYS
    )
    if beat is None or beat.state is not LifeState.INACTIVE:
        raise BrokenRuleError(f"STOP did not disarm: {state_text(stage)}")
    return f"{armed.text()} armed, {beat.text()} disarmed"


def _estop_before(stage: ParticipantStage) -> str:
    _needs_estop(stage)
    mark = len(stage.hearing)
    stage.cast.estop()
    beat = stage.wait_beat(OBEYS, LifeState.FAULT, since=mark)
    if beat is None or not beat.reasons & Why.ESTOP:
        raise BrokenRuleError(f"ESTOP before the start: {state_text(stage)}")
    sleep(0.15)
    stage.command(NMT_RESET)
    after = stage.wait_beat(OBEYS, LifeState.INACTIVE)
    if after is None or after.reasons:
        raise BrokenRuleError(f"RESET after it: {state_text(stage)}")
    return f"{beat.text()} FAULT, after RESET {after.text()}"


def _needs_estop(stage: ParticipantStage) -> None:
    if not any(s.estop for s in stage.cast.services.values()):
        raise InapplicableRuleError("no bus of the participant has the service ESTOP")


def _starts(stage: ParticipantStage) -> str:
    """The first samples of the run, by the t = 0 of EPOCH."""
    since = monotonic_ns()
    if not any(s.nmt for s in stage.cast.services.values()):
        raise InapplicableRuleError("no bus of the participant has the service NMT")
    mark, t0_ns = len(stage.hearing), stage.start()
    beat = stage.hearing.wait(lambda f: f.state is LifeState.ACTIVE, mark, LEAD + OBEYS)
    if beat is None:
        raise BrokenRuleError(f"{state_text(stage)} {OBEYS:g} s after the t = 0 of EPOCH")
    return _first_samples(stage, mark, t0_ns, since)


def _first_samples(stage: ParticipantStage, mark: int, t0_ns: int, since: int) -> str:
    """Sample 0 comes at t = 0 and the phase."""
    period = max((m.period_ns for m in _own(stage)), default=0)
    sleep((4 * period + 1e8) * 1e-9)
    if not _own(stage):
        return "ACTIVE; it sends no message"
    came = []
    for carried in _own(stage):
        found = [
            f for f in stage.hearing.since(mark, Heard.SAMPLE)
            if f.name == carried.name and f.result == 0 and not stage.hearing.is_preview(f)
        ]  # fmt: skip
        if not found:
            raise BrokenRuleError(f"no sample of {carried.name} after t = 0")
        first = found[0]
        if carried.encoding.message.e2e and first.counter != 0:
            raise BrokenRuleError(f"the first sample is {first.text()}, expected counter 0")
        away = (first.t_ns - t0_ns - carried.offset_ns) * 1e-9
        slack = TOLERANCE + stage.late(since)
        if not -0.002 - slack / 4 <= away <= slack + stage.slot:
            raise BrokenRuleError(
                f"sample 0 of {carried.name} came {away * 1e3:.1f} ms after its time by EPOCH"
            )
        came.append(f"{carried.name} {away * 1e3:+.1f} ms")
    return f"sample 0 from its time by EPOCH: {', '.join(came)}"


def _own(stage: ParticipantStage) -> list[Carried]:
    return [m for m in stage.system.messages.values() if m.node == stage.node and not m.forward]


# ---- in the run -------------------------------------------------------------------------------


def _says_active(stage: ParticipantStage) -> str:
    mark = len(stage.hearing)
    sleep(0.3)
    count = 0
    for f in stage.hearing.since(mark):
        told = f.kind is Heard.SAMPLE and stage.hearing.tells_state(f.name)
        if f.kind is not Heard.HEARTBEAT and not told:
            continue
        count += 1
        armed = f.armed if f.kind is Heard.HEARTBEAT else has_status(f, Status.DEADMAN)
        if f.state is not LifeState.ACTIVE or not armed or f.reasons:
            raise BrokenRuleError(f"{f.text()}: {f.state_name}, armed {armed}")
    if not count:
        raise BrokenRuleError("it sends nothing")
    return f"{count} frames say ACTIVE and armed"


def _answers_peer(stage: ParticipantStage) -> str:
    """A peer waits for a start: EPOCH comes, DATE before it on CAN."""
    if not any(s.epoch for s in stage.cast.services.values()):
        raise InapplicableRuleError("no bus of the participant has the service EPOCH")
    if not stage.cast.peers:
        raise InapplicableRuleError("the participant has no peer")
    peers = [p for p in stage.cast.peers.values() if p.name not in stage.spec.requires]
    peer = (peers or list(stage.cast.peers.values()))[0]
    mark = len(stage.hearing)
    with stage.cast.lock:
        peer.state = LifeState.INACTIVE
    sleep(0.5)
    with stage.cast.lock:
        peer.state = None
    heard = stage.hearing.since(mark, Heard.EPOCH)
    said = [f for f in heard if f.values and f.values[1] != 0]
    if not said:
        raise BrokenRuleError(f"no EPOCH in 0.5 s in which {peer.name} waits for a start")
    origin = (stage.cast.t0_ns or 0) + realtime_offset_ns()
    for f in said:
        off_us = (f.values[3] - origin / 1e3 + 2**32 * 10) % (2**33 * 10) - 2**32 * 10
        if abs(off_us) > 5000:
            raise BrokenRuleError(f"{f.text()} has a t = 0 that is {off_us / 1e3:.1f} ms off")
    for bus in {f.bus for f in said}:
        times = [f.t_ns for f in said if f.bus == bus]
        apart = min((b - a for a, b in pairwise(times)), default=10**9)
        if apart < 0.05e9:
            raise BrokenRuleError(f"EPOCHs on {bus} {apart * 1e-6:.0f} ms apart, expected 100 ms")
    _dates(heard)
    return f"{said[0].text()}, {len(said)} of them in 0.5 s"


def _dates(heard: list[HeardFrame]) -> None:
    """A DATE comes before each EPOCH that has no identity."""
    for bus in {f.bus for f in heard}:
        frames = [f for f in heard if f.bus == bus and f.values]
        for before, f in pairwise([None, *frames]):
            if f is None or len(f.values) > len(EPOCH_SIGNALS) or f.values[1] == 0:
                continue
            if before is None or before.values[1] != 0:
                raise BrokenRuleError(f"{f.text()} without a DATE before it")


def _commands_of_others(stage: ParticipantStage) -> str:
    other = stage.number % 31 + 1
    mark = len(stage.hearing)
    stage.cast.command(NMT_STOP, other)
    stage.cast.command(NMT_RESET, other)
    stage.cast.command(99, stage.number)
    for frame in _nmt_of_other_length(stage, NMT_STOP):
        stage.cast.send(*frame)
    return expect_active(stage, mark, 0.25, "commands for another node, or unknown")


def _latches(stage: ParticipantStage) -> str:
    """FAULT stays, its reasons too; START and ARM are refused; RESET only disarms."""
    _stop_it(stage)
    fault = stage.wait_beat(stage.seconds("ramp") + OBEYS, LifeState.FAULT)
    if fault is None:
        raise BrokenRuleError(f"{state_text(stage)} after the ramp of an emergency stop")
    mark = len(stage.hearing)
    stage.command(NMT_ARM)
    stage.command(NMT_START)
    sleep(0.25)
    for f in stage.hearing.since(mark, Heard.HEARTBEAT):
        if f.state is not LifeState.FAULT or not f.reasons & Why.ESTOP or f.armed:
            raise BrokenRuleError(f"{f.text()} after ARM and START in FAULT")
    return f"{fault.text()} until RESET"


def _resets(stage: ParticipantStage) -> str:
    _stop_it(stage)
    if stage.wait_beat(stage.seconds("ramp") + OBEYS, LifeState.FAULT) is None:
        raise BrokenRuleError(f"{state_text(stage)} after the ramp of an emergency stop")
    stage.command(NMT_RESET)
    beat = stage.wait_beat(OBEYS, LifeState.INACTIVE)
    if beat is None or beat.armed or beat.reasons:
        raise BrokenRuleError(f"after RESET: {beat.text() if beat else state_text(stage)}")
    mark = len(stage.hearing)
    stage.command(NMT_START)
    started = stage.hearing.wait(
        lambda f: f.kind is Heard.HEARTBEAT and f.state is LifeState.ACTIVE, mark, 0.25
    )
    if started is not None:
        raise BrokenRuleError(f"it started without ARM: {started.text()}")
    settle(stage)
    stage.command(NMT_ARM)
    settle(stage)
    stage.command(NMT_START)
    if stage.wait_beat(OBEYS, LifeState.ACTIVE) is None:
        raise BrokenRuleError(f"{state_text(stage)} after RESET, ARM, START")
    return f"{beat.text()} after RESET; ACTIVE after ARM and START only"


# ---- emergency stop ---------------------------------------------------------------------------


def _stop_it(stage: ParticipantStage) -> None:
    """Raise any stop that latches: an emergency stop."""
    _needs_estop(stage)
    mark = len(stage.hearing)
    stage.cast.estop()
    expect_stop(stage, mark, OBEYS, Why.ESTOP, "ESTOP")


def _within_a_slot(stage: ParticipantStage) -> str:
    _needs_estop(stage)
    came = list[str]()
    for bus in [b for b, s in stage.cast.services.items() if s.estop]:
        if came:
            stage.make_active()
        since = monotonic_ns()
        mark = len(stage.hearing)
        stage.cast.estop([bus])
        sent_ns = monotonic_ns()
        stop = expect_stop(stage, mark, OBEYS, Why.ESTOP, f"ESTOP on {bus}")
        came.append(f"on {bus} {_reaction(stage, mark, sent_ns, since, stop.first):.1f} ms")
    return f"first frame that tells STOPPING, by its nominal time: {', '.join(came)}"


def _reaction(
    stage: ParticipantStage, mark: int, sent_ns: int, since: int, first: HeardFrame
) -> float:
    """Time from ESTOP to the nominal time of the last sample that did not know of it, ms."""
    late = stage.late(since)
    told = [f for f in stage.hearing.since(mark, Heard.SAMPLE) if stage.hearing.tells_state(f.name)]
    t0 = stage.cast.t0_ns or 0
    ignorant = [sent_ns]
    for f in told:
        at = nominal_ns(stage, f, t0)
        if f.state is LifeState.ACTIVE and at is not None:
            ignorant.append(at)
        elif f.state in STOPPED and not has_status(f, Status.ESTOP):
            raise BrokenRuleError(f"{f.text()} stops without the bit of an emergency stop")
    if not told:  # its heartbeats alone tell
        took = (first.t_ns - sent_ns) * 1e-9
        limit = stage.seconds("heartbeat") + stage.slot + TOLERANCE + late
    else:
        took = (max(ignorant) - sent_ns) * 1e-9
        limit = stage.slot + 0.005 + late
    if took > limit:
        raise BrokenRuleError(
            f"a sample {took * 1e3:.1f} ms after ESTOP still tells ACTIVE, expected at most "
            f"{limit * 1e3:.1f} ms (a slot of {stage.slot * 1e3:g} ms, 5 ms, and the kit's own)"
        )
    return took * 1e3


def _any_estop(stage: ParticipantStage) -> str:
    _needs_estop(stage)
    frames = _estop_frames(stage)
    if not frames:
        raise InapplicableRuleError("no CAN bus of the participant has the service ESTOP")
    came = list[str]()
    for text, bus, frame in frames:
        if came:
            stage.make_active()
        mark = len(stage.hearing)
        stage.cast.send(bus, frame)
        expect_stop(stage, mark, 0.3 + 4 * stage.slot, Why.ESTOP, f"ESTOP {text}")
        came.append(text)
    return f"stops for ESTOP {', '.join(came)}"


def _estop_frames(stage: ParticipantStage) -> list[tuple[str, str, Frame]]:
    found = []
    for bus, service in stage.cast.services.items():
        spec = stage.system.deployment.buses[bus]
        if service.estop is None or spec.kind != "can":
            continue
        number = int(service.estop.message.id)
        found += [
            ("without data", bus, Frame.of(number, b"", 0)),
            ("of 8 bytes", bus, Frame.of(number, bytes([0xFF] * 8), 0)),
        ]
        if spec.fd:
            flags = int(Flags.FD | Flags.BRS)
            found.append(("in CAN FD", bus, Frame.of(number, bytes(12), flags)))
        break
    return found


def _no_estop(stage: ParticipantStage) -> str:
    """A remote frame, a 29-bit identifier; on Zenoh a wrong CRC."""
    _needs_estop(stage)
    mark = len(stage.hearing)
    for bus, service in stage.cast.services.items():
        if service.estop is None:
            continue
        number = int(service.estop.message.id)
        if stage.system.deployment.buses[bus].kind == "can":
            remote = Frame.of(number, b"", int(Flags.REMOTE))
            stage.cast.send(bus, remote)
            stage.cast.send(bus, Frame.of(number, bytes(5), int(Flags.EXTENDED)))
        else:
            from bridge.can.codec import Codec
            from bridge.native.message import Header

            assert isinstance(service.estop, Codec)
            good = service.estop.frame([0, 2], Header())
            data = bytearray(good.payload)
            data[-1] ^= 1
            stage.cast.send(bus, copy_of(good, bytes(data)))
    return expect_active(stage, mark, 0.25, "frames that are no emergency stop")


def _passes_on(stage: ParticipantStage) -> str:
    _needs_estop(stage)
    mark = len(stage.hearing)
    stage.cast.estop()
    expect_stop(stage, mark, OBEYS, Why.ESTOP, "ESTOP")
    sleep(PASSED_ON * max(EVERY, stage.slot) + 0.25)
    came = []
    for bus, service in stage.cast.services.items():
        if service.estop is None:
            continue
        times = [f.t_ns for f in stage.hearing.since(mark, Heard.ESTOP) if f.bus == bus]
        if len(times) != PASSED_ON:
            raise BrokenRuleError(f"{len(times)} ESTOP frames on {bus}, expected {PASSED_ON}")
        came.append(f"{len(times)} on {bus} in {(times[-1] - times[0]) * 1e-6:.0f} ms")
    return ", ".join(came)


def _ramps(stage: ParticipantStage) -> str:
    """Torque falls to 0 within the ramp, state STOPPING until then, FAULT from then on."""
    names = torque_messages(stage)
    if not names:
        raise InapplicableRuleError("the participant sends no torque")
    since, mark = monotonic_ns(), len(stage.hearing)
    stage.cast.estop()
    expect_stop(stage, mark, OBEYS, Why.ESTOP, "ESTOP")
    ramp = stage.seconds("ramp")
    sleep(ramp + 0.25)
    came = []
    for name in names:
        found = [f for f in stage.hearing.since(mark, Heard.SAMPLE) if f.name == name]
        came.append(_judge_ramp(stage, found, ramp, since))
    return "; ".join(came)


def _judge_ramp(stage: ParticipantStage, found: list[HeardFrame], ramp: float, since: int) -> str:
    if not found:
        raise BrokenRuleError("no sample with torque after ESTOP")
    name, t0 = found[0].name, stage.cast.t0_ns or 0
    states = [f.state for f in found if f.state is not LifeState.ACTIVE]
    if stage.hearing.tells_state(name):
        if LifeState.STOPPING not in states and ramp > stage.slot:
            raise BrokenRuleError(f"no sample of {name} tells STOPPING")
        stopping = [f for f in found if f.state is LifeState.STOPPING]
        after = [f for f in found if f.state is LifeState.FAULT]
    else:
        stopping, after = [f for f in found if any(torque_values(stage, f))], found[-2:]
    if not after or any(any(torque_values(stage, f)) for f in after):
        raise BrokenRuleError(f"torque after the ramp of {name}: {(after or found)[-1].text()}")
    if not stopping:
        return f"{name}: no ramp"
    times = [nominal_ns(stage, f, t0) or f.t_ns for f in stopping]
    took = (times[-1] - times[0]) * 1e-9
    period = stage.system.messages[name].period_ns * 1e-9
    late = stage.late(since)
    slack = 2 * stage.slot + period + (0.0 if stage.hearing.tells_state(name) else late + 0.02)
    if not ramp - slack - period <= took <= ramp + slack:
        raise BrokenRuleError(
            f"the ramp of {name} takes {took * 1e3:.0f} ms, expected {ramp * 1e3:.0f} ms"
        )
    sizes = [max(map(abs, torque_values(stage, f)), default=0.0) for f in stopping]
    for at, size in zip(times, sizes, strict=True):
        share = max(0.0, 1.0 - (at - times[0]) * 1e-9 / ramp) + 2 * slack / ramp
        if size > 1.2 * max(sizes[0], 1e-6) * min(1.0, share) + 1e-3:
            raise BrokenRuleError(
                f"torque of {size:.3g} {(at - times[0]) * 1e-6:.0f} ms into the ramp of {name}, "
                f"which began with {sizes[0]:.3g}"
            )
    return f"{name}: {sizes[0]:.3g} to 0 in {took * 1e3:.0f} ms"


def _rule(number: str, title: str, clause: str, expected: str) -> ConformityRule:
    return ConformityRule(number, title, clause, expected)


LIFE_CHECKS = (
    Check(
        _rule("C-10", "waiting", "safety.md#1-life-cycle-of-a-node",
              "Before its start a participant sends heartbeats (INACTIVE, not armed, no reason) "
              "and previews: sample 0, with torque 0."),
        CheckScene.WAITING, _waits),
    Check(
        _rule("C-11", "START without peers", "safety.md#1-life-cycle-of-a-node",
              "START is refused as long as a required peer or an input is missing."),
        CheckScene.WAITING, _start_alone),
    Check(
        _rule("C-12", "commands of others", "can.md#messages",
              "Before the start, commands to another node, unknown ones and NMT of another length "
              "change nothing."),
        CheckScene.WAITING, _start_of_others),
    Check(
        _rule("C-13", "ARM and STOP", "safety.md#1-life-cycle-of-a-node",
              "ARM arms a participant that has all it needs; STOP disarms it."),
        CheckScene.WAITING, _arms),
    Check(
        _rule("C-14", "ESTOP before the start", "safety.md#1-life-cycle-of-a-node",
              "ESTOP before the start leads to FAULT (estop); RESET leads back to INACTIVE."),
        CheckScene.WAITING, _estop_before),
    Check(
        _rule("C-15", "START at t = 0 of EPOCH", "rehearsal.md#running-a-single-node",
              "The run begins with sample 0 at the date in the EPOCH that came before START."),
        CheckScene.WAITING, _starts),
    Check(
        _rule("C-16", "EPOCH for a waiting peer", "rehearsal.md#rejoining",
              "A running participant answers the heartbeat of a waiting peer with the EPOCH of its "
              "run, at most every 100 ms; on CAN a DATE comes before each."),
        CheckScene.ACTIVE, _answers_peer),
    Check(
        _rule("C-20", "ACTIVE and armed", "can.md#messages",
              "In the run all heartbeats and samples say ACTIVE and armed, without a reason."),
        CheckScene.ACTIVE, _says_active),
    Check(
        _rule("C-21", "latched reasons", "safety.md#1-life-cycle-of-a-node",
              "FAULT and its reasons stay until RESET; ARM and START are refused in it."),
        CheckScene.ACTIVE, _latches),
    Check(
        _rule("C-22", "RESET, ARM, START", "safety.md#1-life-cycle-of-a-node",
              "RESET leads to INACTIVE, disarmed and without reasons; only ARM and START together "
              "lead to ACTIVE again."),
        CheckScene.ACTIVE, _resets),
    Check(
        _rule("C-23", "commands of others in the run", "can.md#messages",
              "In the run, commands to another node, unknown ones and NMT of another length change "
              "nothing."),
        CheckScene.ACTIVE, _commands_of_others),
    Check(
        _rule("C-30", "emergency stop within a slot", "safety.md#1-life-cycle-of-a-node",
              "The first slot after an ESTOP on any of its buses is STOPPING, with status bit 4 "
              "and the reason estop."),
        CheckScene.ACTIVE, _within_a_slot),
    Check(
        _rule("C-31", "ESTOP of any form", "can.md#messages",
              "A data frame with the identifier of ESTOP stops, whatever its length, data and "
              "format."),
        CheckScene.ACTIVE, _any_estop),
    Check(
        _rule("C-32", "no ESTOP", "can.md#messages",
              "A remote frame, a 29-bit identifier, and on Zenoh a wrong CRC are no emergency "
              "stop."),
        CheckScene.ACTIVE, _no_estop),
    Check(
        _rule("C-33", "ESTOP is passed on", "safety.md#1-life-cycle-of-a-node",
              "A participant that received ESTOP sends it ten times on all its buses."),
        CheckScene.ACTIVE, _passes_on),
    Check(
        _rule("C-34", "ramp", "safety.md#1-life-cycle-of-a-node",
              "The torque falls linearly to 0 within `ramp` in STOPPING, and is 0 in FAULT."),
        CheckScene.ACTIVE, _ramps),
)  # fmt: skip
