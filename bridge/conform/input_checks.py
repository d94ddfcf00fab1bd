"""Rules about what a participant receives: what it must refuse, and what must not disturb it.

A refused frame does not feed the input. So a rule sends nothing but forged frames of a message for
longer than its time-out, and the participant has to stop as if nothing came.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from bridge.conform.cast import MessageRole, Sample, Tamper, copy_of
from bridge.conform.checks import (
    TOLERANCE,
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    VoidAttemptError,
    expect_active,
    expect_stop,
    nominal_ns,
)
from bridge.conform.hearing import Heard
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import ParticipantStage, Watched
from bridge.deployment import ranges
from bridge.native.enums import E2EProfile, Why
from bridge.native.frame import Flags, Frame
from bridge.native.message import protect
from cosim.base.clock import monotonic_ns, sleep

#: Samples that C-60 sends backwards before it begins anew.
BACKWARDS = 64
_CAN_ONLY = "the message is on Zenoh, which has no frame formats"


def watched(stage: ParticipantStage) -> Watched:
    """The message with the shortest time-out. Raises InapplicableRuleError if there is none."""
    found = stage.watched()
    if not found:
        raise InapplicableRuleError(
            "no input of this participant stops it within 2.5 s; "
            'expected `stop` of an input, or --set deploy.silence="0.5 s" here and there'
        )
    return found[0]


def is_can(stage: ParticipantStage, message: str) -> bool:
    """True if a message is on a CAN bus."""
    return stage.system.deployment.buses[stage.system.messages[message].bus].kind == "can"


def profile_of(stage: ParticipantStage, message: str) -> E2EProfile:
    """The protection of a message."""
    return E2EProfile(stage.system.messages[message].encoding.message.e2e)


@contextmanager
def tampered(stage: ParticipantStage, message: str, tamper: Tamper | None) -> Iterator[MessageRole]:
    """Let samples of a message pass `tamper`; None: let it be silent."""
    role = stage.cast.messages[message]
    with stage.cast.lock:
        role.tamper, role.sends = tamper, tamper is not None
    try:
        yield role
    finally:
        with stage.cast.lock:
            role.tamper, role.sends = None, True


def refused(
    tamper: Callable[[ParticipantStage, str], Tamper], what: str
) -> Callable[[ParticipantStage], str]:
    """A judge: with nothing but frames that `tamper` makes, the input becomes stale."""

    def judge(stage: ParticipantStage) -> str:
        found = watched(stage)
        with tampered(stage, found.message, tamper(stage, found.message)) as role:
            mark = len(stage.hearing)
            limit = found.timeout + 4 * stage.slot + 0.25
            stop = expect_stop(stage, mark, limit, found.why, f"{what} of {found.message} only")
            took = (stop.first.t_ns - role.last_ns) * 1e-9
        if took < found.timeout / 2:
            raise VoidAttemptError(f"{stop.text()}, before the time-out")
        return f"{stop.text()}, {took * 1e3:.0f} ms after the last valid frame"

    return judge


def accepted(
    tamper: Callable[[ParticipantStage, str], Tamper], what: str
) -> Callable[[ParticipantStage], str]:
    """A judge: with what `tamper` makes, the participant stays ACTIVE for three time-outs."""

    def judge(stage: ParticipantStage) -> str:
        found = watched(stage)
        with tampered(stage, found.message, tamper(stage, found.message)):
            mark = len(stage.hearing)
            return expect_active(
                stage, mark, 3 * found.timeout, f"{what} among frames of {found.message}"
            )

    return judge


# ---- silence ----------------------------------------------------------------------------------


def _silence(stage: ParticipantStage) -> str:
    """Each watched message in turn is silent."""
    watched(stage)
    came = list[str]()
    for found in stage.watched():
        if came:
            stage.make_active()
        came.append(_one_silent(stage, found))
    return "; ".join(came)


def _one_silent(stage: ParticipantStage, found: Watched) -> str:
    since = monotonic_ns()
    with tampered(stage, found.message, None) as role:
        mark = len(stage.hearing)
        limit = found.timeout + 4 * stage.slot + 0.3
        stop = expect_stop(stage, mark, limit, found.why, f"silence of {found.message}")
        t0 = stage.cast.t0_ns or 0
        at = nominal_ns(stage, stop.first, t0) if stop.first.kind is Heard.SAMPLE else None
        took = ((stop.first.t_ns if at is None else at) - role.last_ns) * 1e-9
    period = role.carried.period_ns * 1e-9
    slack = 2 * stage.slot + TOLERANCE + stage.late(since)
    beat = 0.0 if at is not None else stage.seconds("heartbeat")
    if not found.timeout - period - slack <= took <= found.timeout + period + slack + beat:
        raise BrokenRuleError(
            f"it stopped {took * 1e3:.0f} ms after the last frame of {found.message}; its time-out "
            f"is {found.timeout * 1e3:g} ms, tolerance {1e3 * slack:.0f} ms"
        )
    return f"{found.message}: stopped after {took * 1e3:.0f} ms of {found.timeout * 1e3:g} ms"


def _short_silence(stage: ParticipantStage) -> str:
    found = watched(stage)
    role = stage.cast.messages[found.message]
    every = max(1, int(0.5 * found.timeout * 1e9 / role.carried.period_ns))
    if every < 2:
        raise InapplicableRuleError(f"the time-out of {found.message} is below two periods")

    def gaps(sample: Sample) -> Sequence[Frame]:
        return [sample.frame()] if sample.number % every == 0 else []

    with tampered(stage, found.message, gaps):
        return expect_active(
            stage, len(stage.hearing), 3 * found.timeout, f"one frame of {every}: {found.message}"
        )


# ---- frames that must be refused --------------------------------------------------------------


def _flip(sample: Sample, place: int, bit: int) -> Frame:
    frame = sample.frame()
    data = bytearray(frame.payload)
    data[place % len(data)] ^= 1 << bit
    return copy_of(frame, bytes(data))


def _wrong_crc(stage: ParticipantStage, message: str) -> Tamper:
    profile = profile_of(stage, message)
    _needs_protection(profile)
    where, size = {E2EProfile.P04: (8, 4), E2EProfile.P05: (0, 2)}.get(profile, (0, 1))
    return lambda s: [_flip(s, where + s.number % size, s.number // size % 8)]


def _needs_protection(profile: E2EProfile) -> None:
    if profile is E2EProfile.NONE:
        raise InapplicableRuleError("the message is not protected")


def _wrong_data_id(stage: ParticipantStage, message: str) -> Tamper:
    """The frame of another message: valid bytes, with the data ID of another identifier."""
    profile = profile_of(stage, message)
    _needs_protection(profile)
    ids = bytearray(stage.system.messages[message].encoding.message.data_ids)
    other = bytes((b ^ 0x5A) for b in ids)

    def tamper(sample: Sample) -> Sequence[Frame]:
        frame = sample.frame()
        counter = sample.number
        return [copy_of(frame, protect(profile, other, counter, frame.payload))]

    return tamper


def _flipped_bit(stage: ParticipantStage, message: str) -> Tamper:
    """One bit of the payload behind the CRC, another one each time."""
    _needs_protection(profile_of(stage, message))
    length = int(stage.system.messages[message].encoding.message.length)
    skip = {E2EProfile.P04: 12, E2EProfile.P05: 2}.get(profile_of(stage, message), 1)
    return lambda s: [_flip(s, skip + 5 * s.number % (length - skip), 3 * s.number % 8)]


def _other_length(stage: ParticipantStage, message: str) -> Tamper:
    """Longer and shorter by turns, with a CRC that is right for the length."""
    encoding = stage.system.messages[message].encoding.message
    profile, ids, length = profile_of(stage, message), bytes(encoding.data_ids), encoding.length
    if encoding.flags & Flags.FD:
        sizes = (4, 8, 12, 16, 20, 24, 32, 48, 64)
        shorter, longer = [s for s in sizes if s < length], [s for s in sizes if s > length]
        near = [*shorter[-1:], *longer[:1]]
    elif is_can(stage, message):
        near = [length - 1, length - 2]
    else:
        near = [length - 8, length + 8]

    def tamper(sample: Sample) -> Sequence[Frame]:
        frame = sample.frame()
        size = near[sample.number % len(near)]
        data = (frame.payload + bytes(64))[:size]
        return [copy_of(frame, protect(profile, ids, sample.number, data))]

    return tamper


def _other_format(stage: ParticipantStage, message: str) -> Tamper:
    """A classic frame in place of CAN FD, or the other way round."""
    if not is_can(stage, message):
        raise InapplicableRuleError(_CAN_ONLY)
    bus = stage.system.deployment.buses[stage.system.messages[message].bus]
    fd = bool(stage.system.messages[message].encoding.message.flags & Flags.FD)
    if not fd and not bus.fd:
        raise InapplicableRuleError("the bus carries classic frames only")

    def tamper(sample: Sample) -> Sequence[Frame]:
        frame = sample.frame()
        if fd:
            flags = int(frame.flags) & ~int(Flags.FD | Flags.BRS)
            return [copy_of(frame, frame.payload[:8], flags=flags)]
        return [copy_of(frame, flags=int(frame.flags) | int(Flags.FD | Flags.BRS))]

    return tamper


def _other_identifier(stage: ParticipantStage, message: str) -> Tamper:
    """The same bytes with a 29-bit identifier, and as a remote frame of the right identifier."""
    if not is_can(stage, message):
        raise InapplicableRuleError(_CAN_ONLY)

    def tamper(sample: Sample) -> Sequence[Frame]:
        frame = sample.frame()
        if sample.number % 2 and not frame.flags & Flags.FD:
            return [copy_of(frame, flags=int(frame.flags | Flags.REMOTE))]
        return [copy_of(frame, flags=int(frame.flags) | int(Flags.EXTENDED))]

    return tamper


def _invalid(stage: ParticipantStage, message: str) -> Tamper:
    """One value is NaN or infinite: the invalid code, or not finite on Zenoh."""

    def tamper(sample: Sample) -> Sequence[Frame]:
        values = sample.values.copy()
        values[sample.number % len(values)] = (np.nan, np.inf, -np.inf)[sample.number % 3]
        return [sample.frame(values=values)]

    signals = stage.cast.messages[message].carried.encoding
    if not all(getattr(s, "invalid", None) is not None for s in getattr(signals, "signals", ())):
        raise InapplicableRuleError("a signal of the message has no invalid code")
    return tamper


def _out_of_range(stage: ParticipantStage, message: str) -> Tamper:
    carried = stage.system.messages[message]
    limits = ranges.limits(stage.system, stage.node, carried)
    signals = getattr(carried.encoding, "signals", ())
    beyond: list[tuple[int, float]] = []
    for i, limit in enumerate(limits):
        signal = signals[i]
        raw = [signal.scale * r + signal.offset for r in signal.raw_range]
        for edge, most, way in ((limit.high, max(raw), 1.0), (limit.low, min(raw), -1.0)):
            value = edge + way * max(1.0, abs(edge) * 0.01)
            if np.isfinite(edge) and way * (most - value) >= 0:
                beyond.append((i, value))
    if not beyond:
        raise InapplicableRuleError("no value of the message has a range that it can leave")

    def tamper(sample: Sample) -> Sequence[Frame]:
        i, value = beyond[sample.number % len(beyond)]
        values = sample.values.copy()
        values[i] = value
        return [sample.frame(values=values)]

    return tamper


def _repeated(stage: ParticipantStage, message: str) -> Tamper:
    """The first frame over and over."""
    kept: list[Frame] = []

    def tamper(sample: Sample) -> Sequence[Frame]:
        kept[:] = kept or [sample.frame()]
        return [copy_of(kept[0])]

    return tamper


def _needs_stamp(stage: ParticipantStage, message: str) -> None:
    if stage.system.messages[message].encoding.message.time < 0:
        raise InapplicableRuleError("without a time stamp an old counter may be a new one")


def _older(stage: ParticipantStage, message: str) -> Tamper:
    """Samples that were sent before the last one, backwards."""
    _needs_stamp(stage, message)
    while stage.cast.messages[message].number < 2 * BACKWARDS:  # there are so many
        sleep(stage.slot)
    first: list[int] = []

    def tamper(sample: Sample) -> Sequence[Frame]:
        first[:] = first or [sample.number - 1]
        back = first[0] - 1 - (sample.number - first[0]) % BACKWARDS
        return [sample.frame(number=max(0, back))]

    return tamper


def _ahead(stage: ParticipantStage, message: str) -> Tamper:
    """Samples that are a second ahead of their time, and do not follow each other: a sender whose
    clock is ahead would be accepted with its third frame.
    """
    encoding = stage.system.messages[message].encoding.message
    if encoding.time < 0:
        raise InapplicableRuleError("the message has no time stamp")
    if encoding.header[encoding.time].length < 32:
        raise InapplicableRuleError("a time stamp of 16 bits does not tell a second ahead")

    def tamper(sample: Sample) -> Sequence[Frame]:
        ahead = round(1e9 / sample.carried.period_ns) + 7 * (sample.number % 5)
        return [sample.frame(number=sample.number + ahead)]

    return tamper


def _forged_counter(stage: ParticipantStage, message: str) -> Tamper:
    """Counters as they are due, or nearly, but with a stamp of the past."""
    _needs_stamp(stage, message)
    encoding = stage.system.messages[message].encoding.message
    if encoding.header[encoding.time].length < 32:
        raise InapplicableRuleError("a time stamp of 16 bits of the past may be one that is due")
    if profile_of(stage, message) is E2EProfile.NONE:
        raise InapplicableRuleError("the message has no counter")
    first: list[int] = []

    def tamper(sample: Sample) -> Sequence[Frame]:
        first[:] = first or [sample.number]
        jump = (0, 2, 1, 3)[sample.number % 4]  # they do not follow each other
        return [sample.frame(number=max(0, first[0] - 2), counter=sample.number + jump)]

    return tamper


# ---- what must not disturb --------------------------------------------------------------------


def _beside(
    forge: Callable[[ParticipantStage, str], Tamper],
) -> Callable[[ParticipantStage, str], Tamper]:
    """Valid frames, each with a forged one before or behind it."""

    def make(stage: ParticipantStage, message: str) -> Tamper:
        forged = forge(stage, message)

        def tamper(sample: Sample) -> Sequence[Frame]:
            both = [sample.frame(), *forged(sample)]
            return both if sample.number % 2 else both[::-1]

        return tamper

    return make


def _single_forged(stage: ParticipantStage, message: str) -> Tamper:
    """Valid frames, and at their beginning one that is ahead by four time-outs: it must not lock
    the sender out.
    """
    found = next(w for w in stage.watched() if w.message == message)
    ahead = int(4 * found.timeout * 1e9 / stage.system.messages[message].period_ns) + 1
    first: list[int] = []

    def tamper(sample: Sample) -> Sequence[Frame]:
        forged = [] if first else [sample.frame(number=sample.number + ahead)]
        first[:] = [sample.number]
        return [sample.frame(), *forged]

    return tamper


def _foreign(stage: ParticipantStage, message: str) -> Tamper:
    """Frames that belong to no message."""
    can = is_can(stage, message)
    taken = {m.encoding.message.id for m in stage.system.messages.values()}

    def tamper(sample: Sample) -> Sequence[Frame]:
        frame = sample.frame()
        free = 0x600 + sample.number % 16 if can else 0x4000 + sample.number % 4
        if free in taken:
            return [frame]
        short = Frame.of(free, bytes(range(8)), 0)
        return [copy_of(frame, id=free), frame, *([short] if can else [])]

    return tamper


def _restarted_counter(stage: ParticipantStage, message: str) -> Tamper:
    """The counter of the sender starts again at 0, and its time stamps continue."""
    if profile_of(stage, message) is E2EProfile.NONE:
        raise InapplicableRuleError("the message has no counter")
    return lambda sample: [sample.frame(counter=sample.number + 5)]


def _late_frames(stage: ParticipantStage, message: str) -> Tamper:
    """Each frame comes a third of the time-out late, in order, with its own number."""
    found = next(w for w in stage.watched() if w.message == message)
    period = stage.system.messages[message].period_ns * 1e-9
    by = min(int(found.timeout / 3 / period), 8)
    if by < 1:
        raise InapplicableRuleError("the time-out is too short for a late frame")

    def tamper(sample: Sample) -> Sequence[Frame]:
        number = sample.number - by
        return [sample.frame(number=number)] if number >= 0 else []

    return tamper


def _too_old(stage: ParticipantStage, message: str) -> Tamper:
    carried = stage.system.messages[message]
    max_age = carried.max_age_ns
    period = carried.period_ns
    if max_age <= 0 or carried.encoding.message.time < 0:
        raise InapplicableRuleError("the message has no max_age or no time stamp")
    by = int(1.2 * max_age / period) + 2
    return lambda sample: [sample.frame(number=max(0, sample.number - by))]


def _jump(stage: ParticipantStage) -> str:
    """Single samples are far from those around them, within their range: faster than they can
    change. Neither a guard nor an output of the participant may notice.
    """
    found = {name: _steps(stage, name) for name in stage.system.received_by(stage.node)}
    came = [_jumped(stage, name, steps) for name, steps in found.items() if np.any(steps)]
    if not came:
        raise InapplicableRuleError("no value of this participant has a rate below its range")
    return "; ".join(came)


def _steps(stage: ParticipantStage, name: str) -> np.ndarray:
    """Steps of the values of a message that are four times as fast as they may be, and end within
    their range; 0: there is none.
    """
    role = stage.cast.messages[name]
    found = np.zeros(len(role.values))
    for i, limit in enumerate(ranges.limits(stage.system, stage.node, role.carried)):
        step = 4.0 * float(limit.rate) * role.carried.period_ns * 1e-9
        for way in (step, -step):
            if limit.low < role.values[i] + way < limit.high and np.isfinite(step):
                found[i] = way
    return found


def _jumped(stage: ParticipantStage, name: str, steps: np.ndarray) -> str:
    def tamper(sample: Sample) -> Sequence[Frame]:
        if sample.number % 8:
            return [sample.frame()]
        return [sample.frame(values=sample.values + steps)]

    mark = len(stage.hearing)
    sleep(0.3)
    before, mark = _moves(stage, mark), len(stage.hearing)
    text = f"single samples of {name} that jump by {np.max(np.abs(steps)):.3g}"
    with tampered(stage, name, tamper):
        came = expect_active(stage, mark, 0.3, text)
    for output, moved in _moves(stage, mark).items():
        usual = before.get(output, 0.0)
        if moved > 10.0 * usual + 1e-3:
            raise BrokenRuleError(
                f"with {text}, {output} moves by {moved:.3g} in a period, before that by "
                f"{usual:.3g} at most"
            )
    return came


def _moves(stage: ParticipantStage, mark: int) -> dict[str, float]:
    """The largest change of a value between two samples, of each message of the participant."""
    found: dict[str, float] = {}
    last: dict[str, tuple[float, ...]] = {}
    for f in stage.hearing.since(mark, Heard.SAMPLE):
        if f.values and f.name in last:
            moved = max(abs(a - b) for a, b in zip(f.values, last[f.name], strict=True))
            found[f.name] = max(found.get(f.name, 0.0), moved)
        last[f.name] = f.values or last.get(f.name, ())
    return found


def _peer_of(stage: ParticipantStage) -> str:
    if not stage.spec.requires:
        raise InapplicableRuleError("the participant requires no peer")
    return stage.spec.requires[0]


def _stop_of_peer(stage: ParticipantStage, what: str, limit: float) -> str:
    mark, began = len(stage.hearing), monotonic_ns()
    stop = expect_stop(stage, mark, limit, Why.PEER, what)
    return f"{stop.text()}, {(stop.first.t_ns - began) * 1e-6:.0f} ms after {what}"


def _silent_peer(stage: ParticipantStage) -> str:
    peer = _peer_of(stage)
    with stage.cast.lock:
        stage.cast.peers[peer].beats = False
    within = stage.seconds("within")
    return _stop_of_peer(stage, f"the silence of {peer}", within + 0.35 + 4 * stage.slot)


def _damaged_peer(stage: ParticipantStage) -> str:
    peer = _peer_of(stage)

    def damage(frame: Frame) -> Frame:
        data = bytearray(frame.payload)
        data[-1] ^= 0x10
        return copy_of(frame, bytes(data))

    with stage.cast.lock:
        stage.cast.peers[peer].damage = damage
    within = stage.seconds("within")
    return _stop_of_peer(stage, f"damaged heartbeats of {peer}", within + 0.35 + 4 * stage.slot)


def _failed_peer(stage: ParticipantStage) -> str:
    from bridge.native.enums import LifeState

    peer = _peer_of(stage)
    with stage.cast.lock:
        stage.cast.peers[peer].state = LifeState.FAULT
        stage.cast.peers[peer].due_ns = 0
    return _stop_of_peer(stage, f"FAULT of {peer}", 0.2 + 4 * stage.slot)


def _restarted_peer(stage: ParticipantStage) -> str:
    peer = _peer_of(stage)
    with stage.cast.lock:
        stage.cast.peers[peer].boots += 1
        stage.cast.peers[peer].due_ns = 0
    return _stop_of_peer(stage, f"a restart of {peer}", 0.2 + 4 * stage.slot)


def _rule(number: str, title: str, clause: str, expected: str) -> ConformityRule:
    return ConformityRule(number, title, clause, expected)


_STOPS = "The input becomes stale as if nothing came, and the participant stops for it."
INPUT_CHECKS = (
    Check(
        _rule("C-40", "silent input", "safety.md#3-watchdogs",
              "A participant stops when an input has received nothing for its time-out: not later "
              "than a period and two slots after it, and not earlier."),
        CheckScene.ACTIVE, _silence),
    Check(
        _rule("C-41", "short silence", "safety.md#4-stale-inputs",
              "Gaps of half a time-out are held: the participant stays ACTIVE."),
        CheckScene.ACTIVE, _short_silence),
    Check(
        _rule("C-42", "silent peer", "safety.md#3-watchdogs",
              "A participant stops (peer) when a required peer sends no heartbeat for `within`."),
        CheckScene.ACTIVE, _silent_peer),
    Check(
        _rule("C-43", "peer in FAULT", "safety.md#1-life-cycle-of-a-node",
              "A participant stops (peer) as soon as a required peer tells FAULT."),
        CheckScene.ACTIVE, _failed_peer),
    Check(
        _rule("C-44", "restarted peer", "safety.md#1-life-cycle-of-a-node",
              "A participant stops (peer) when the boots of a required peer change."),
        CheckScene.ACTIVE, _restarted_peer),
    Check(
        _rule("C-45", "damaged heartbeats", "can.md#protection",
              "Heartbeats with a wrong CRC do not count: the peer is silent."),
        CheckScene.ACTIVE, _damaged_peer),
    Check(_rule("C-50", "wrong CRC", "can.md#protection", _STOPS),
          CheckScene.ACTIVE, refused(_wrong_crc, "frames with one wrong bit in the CRC")),
    Check(_rule("C-51", "wrong data ID", "can.md#protection", _STOPS),
          CheckScene.ACTIVE, refused(_wrong_data_id, "frames protected with another data ID")),
    Check(_rule("C-52", "one wrong bit", "can.md#protection", _STOPS),
          CheckScene.ACTIVE, refused(_flipped_bit, "frames with one wrong bit behind the CRC")),
    Check(_rule("C-53", "other length", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_other_length, "longer or shorter frames with a valid CRC")),
    Check(_rule("C-54", "other format", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_other_format, "frames of the other format (classic or FD)")),
    Check(_rule("C-55", "29-bit identifier, remote frame", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_other_identifier, "29-bit identifiers or remote frames")),
    Check(_rule("C-56", "value not finite", "can.md#numbers", _STOPS),
          CheckScene.ACTIVE, refused(_invalid, "samples with an invalid code")),
    Check(_rule("C-57", "value out of range", "safety.md#5-plausibility-checks", _STOPS),
          CheckScene.ACTIVE, refused(_out_of_range, "samples with a value out of its range")),
    Check(
        _rule("C-58", "jump", "safety.md#5-plausibility-checks",
              "A sample that changes faster than its rate is refused: no jump reaches a guard or "
              "an output."),
        CheckScene.ACTIVE, _jump),
    Check(_rule("C-59", "repeated frame", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_repeated, "one frame repeated")),
    Check(_rule("C-60", "older frames", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_older, "older samples, backwards")),
    Check(_rule("C-61", "ahead of its time", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_ahead, "samples a second ahead of their time")),
    Check(_rule("C-62", "forged counter", "can.md#receiving-a-frame", _STOPS),
          CheckScene.ACTIVE, refused(_forged_counter, "old samples with counters of new ones")),
    Check(_rule("C-63", "older than max_age", "safety.md#3-watchdogs", _STOPS),
          CheckScene.ACTIVE, refused(_too_old, "samples older than max_age")),
    Check(
        _rule("C-64", "single forged frames", "can.md#receiving-a-frame",
              "A forged frame does not lock its true sender out: the participant stays ACTIVE."),
        CheckScene.ACTIVE, accepted(_single_forged, "a frame ahead of its time")),
    Check(
        _rule("C-65", "resynchronization", "can.md#receiving-a-frame",
              "A counter that begins anew is accepted with the third frame: the participant stays "
              "ACTIVE."),
        CheckScene.ACTIVE, accepted(_restarted_counter, "a counter that was restarted")),
    Check(
        _rule("C-66", "late frames", "can.md#receiving-a-frame",
              "Frames that come late and in order are accepted: the participant stays ACTIVE."),
        CheckScene.ACTIVE, accepted(_late_frames, "frames that come late")),
    Check(
        _rule("C-67", "foreign frames", "can.md#receiving-a-frame",
              "Frames of no message change nothing: the participant stays ACTIVE."),
        CheckScene.ACTIVE, accepted(_foreign, "frames of unknown identifiers")),
    Check(
        _rule("C-68", "damaged frames beside valid ones", "can.md#receiving-a-frame",
              "A damaged frame does not take the place of a valid one: the participant stays "
              "ACTIVE."),
        CheckScene.ACTIVE, accepted(_beside(_flipped_bit), "damaged frames")),
)  # fmt: skip
