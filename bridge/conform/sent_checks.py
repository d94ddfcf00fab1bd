"""Rules about every frame that a participant has sent, judged at the end of a kit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from statistics import median

from bridge.can.codec import Codec
from bridge.conform.checks import (
    TOLERANCE,
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    VoidAttemptError,
    nominal_ns,
)
from bridge.conform.hearing import Heard, HeardFrame
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import ParticipantStage
from bridge.deployment.carried import Carried
from bridge.native.enums import E2EProfile, Status
from bridge.native.message import Decoded, counter_bits


def _frames(stage: ParticipantStage) -> list[HeardFrame]:
    found = stage.hearing.since(0)
    if not found:
        raise VoidAttemptError("no frame came")
    return found


def _identifiers(stage: ParticipantStage) -> str:
    found = _frames(stage)
    foreign = [f for f in found if f.kind is Heard.FOREIGN]
    if foreign:
        raise BrokenRuleError(f"{len(foreign)} frames that it must not send: {foreign[0].text()}")
    return f"{len(found)} frames"


def _bad(stage: ParticipantStage, result: Decoded) -> None:
    bad = [f for f in _frames(stage) if f.kind is not Heard.FOREIGN and f.result is result]
    if bad:
        raise BrokenRuleError(f"{len(bad)} frames, the first is {bad[0].text()}")


def _lengths(stage: ParticipantStage) -> str:
    _bad(stage, Decoded.LENGTH)
    return f"{len(_frames(stage))} frames"


def _checksums(stage: ParticipantStage) -> str:
    _bad(stage, Decoded.CRC)
    return f"{len(_frames(stage))} frames"


def _values(stage: ParticipantStage) -> str:
    _bad(stage, Decoded.INVALID)
    _bad(stage, Decoded.RANGE)
    count = 0
    for carried in _own(stage):
        limits = _declared(stage, carried)
        for f in stage.hearing.since(0, Heard.SAMPLE):
            if f.name != carried.name or not f.values:
                continue
            count += 1
            for value, (low, high) in zip(f.values, limits, strict=True):
                if not low <= value <= high:
                    raise BrokenRuleError(
                        f"{value:.6g} in {f.text()}, expected {low:g} to {high:g}"
                    )
    return f"{count} samples"


def _declared(stage: ParticipantStage, carried: Carried) -> list[tuple[float, float]]:
    """The range in which receivers believe each value, in its unit."""
    from bridge.deployment import ranges

    system, other = stage.system, stage.node
    receivers = [n for n in system.nodes if carried.name in system.received_by(n)]
    found = ranges.limits(system, receivers[0] if receivers else other, carried)
    return [(x.low, x.high) for x in found]


def _own(stage: ParticipantStage) -> list[Carried]:
    return [m for m in stage.system.messages.values() if m.node == stage.node and not m.forward]


def _runs(stage: ParticipantStage) -> Iterator[tuple[int, int, int]]:
    """The first and the last frame of each run, and t = 0."""
    borders = sorted({*stage.lives, *(index for index, _ in stage.runs), len(stage.hearing)})
    for index, t0 in stage.runs:
        yield (
            index,
            min(b for b in (*borders, len(stage.hearing)) if b > index or b == borders[-1]),
            t0,
        )


def _samples(stage: ParticipantStage, carried: Carried) -> Iterator[tuple[int, list[HeardFrame]]]:
    """The t = 0 of each run, and the samples of a message, without previews."""
    for begin, end, t0 in _runs(stage):
        found = [
            f for f in stage.hearing.since(begin, Heard.SAMPLE)
            if f.index < end and f.name == carried.name and f.result is Decoded.OK
            and not stage.hearing.is_preview(f)
        ]  # fmt: skip
        if found:
            yield t0, found


def _counters(stage: ParticipantStage) -> str:
    """Samples and heartbeats count by one."""
    count = 0
    for carried in _own(stage):
        bits = counter_bits(E2EProfile(carried.encoding.message.e2e))
        for _, found in _samples(stage, carried) if bits else ():
            count += _judge_counters(found, bits)
    number = stage.number
    for bus in stage.buses:
        beat = stage.system.services[bus].heartbeats.get(number)
        if not isinstance(beat, Codec):
            continue
        bits = counter_bits(E2EProfile(beat.message.e2e))
        ends = [*stage.lives[1:], len(stage.hearing)]
        for begin, end in zip(stage.lives, ends, strict=True):
            beats = [
                f for f in stage.hearing.since(begin, Heard.HEARTBEAT)
                if f.index < end and f.bus == bus and f.values
            ]  # fmt: skip
            count += _judge_counters(beats, bits)
    return f"{count} frames count by one"


def _judge_counters(found: list[HeardFrame], bits: int) -> int:
    for a, b in pairwise(found):
        if (b.counter - a.counter) % (1 << bits) != 1:
            raise BrokenRuleError(f"counter {b.counter} after {a.counter}: {b.text()}")
    return len(found)


def _stamps(stage: ParticipantStage) -> str:
    """The stamp is number · period + phase, and its number has the counter as low bits."""
    count = 0
    for carried in _own(stage):
        message = carried.encoding.message
        if message.time < 0:
            continue
        bits = counter_bits(E2EProfile(message.e2e))
        span = 1 << message.header[message.time].length
        for t0, found in _samples(stage, carried):
            for f in found:
                arrived = (f.t_ns - t0) // 1000
                behind = (arrived - f.t_us) % span
                stamp = arrived - (behind - span if behind > span // 2 else behind)
                number = round((stamp * 1000 - carried.offset_ns) / carried.period_ns)
                wanted = (number * carried.period_ns + carried.offset_ns) // 1000
                if stamp != wanted or (number - f.counter) % (1 << bits):
                    raise BrokenRuleError(
                        f"stamp {f.t_us} us with counter {f.counter}: {f.text()}; the nearest "
                        f"sample is {number}, at {wanted % span} us"
                    )
                count += 1
    if not count:
        raise InapplicableRuleError("no message of the participant has a time stamp")
    return f"{count} samples"


def _away(
    stage: ParticipantStage, carried: Carried, t0: int, found: list[HeardFrame]
) -> list[float]:
    """Arrivals less nominal times, s: by the stamps, or by counting from the first sample. The last
    sample may be one of torque 0, sent at once.
    """
    stamped = [(f, nominal_ns(stage, f, t0)) for f in found[:-1]]
    if carried.encoding.message.time >= 0:
        return [(f.t_ns - at) * 1e-9 for f, at in stamped if at is not None]
    shift = round((found[0].t_ns - t0 - carried.offset_ns) / carried.period_ns)
    zero = t0 + carried.offset_ns + shift * carried.period_ns
    return [(f.t_ns - zero - i * carried.period_ns) * 1e-9 for i, (f, _) in enumerate(stamped)]


def _broken_in_time(stage: ParticipantStage, text: str) -> BrokenRuleError | VoidAttemptError:
    """The error of a rule about time: void if the kit was ever late by more than it bears."""
    if stage.lateness.worst_ns(0) * 1e-9 > stage.bears:
        return VoidAttemptError(text)
    return BrokenRuleError(text)


def _periods(stage: ParticipantStage) -> str:
    """Samples come at their nominal times: the median, and on the whole."""
    came = []
    for carried in _own(stage):
        away = list[float]()
        for t0, found in _samples(stage, carried):
            away += _away(stage, carried, t0, found)
        if not away:
            continue
        slack = TOLERANCE + carried.period_ns * 1e-9 / 2 + stage.lateness.worst_ns(0) * 1e-10
        early, middle = sorted(away)[len(away) // 20], median(away)
        if not (-slack <= early and middle <= slack):
            raise _broken_in_time(
                stage,
                f"{carried.name} comes {middle * 1e3:+.1f} ms from its nominal times (median), "
                f"{early * 1e3:+.1f} ms (5 %), tolerance {slack * 1e3:.1f} ms",
            )
        came.append(f"{carried.name} {middle * 1e3:+.1f} ms (median of {len(away)})")
    return ", ".join(came) or "it sends no sample"


def _statuses(stage: ParticipantStage) -> str:
    """A rehearsal says that it is simulated; samples tell a state that there is."""
    count = 0
    for f in _frames(stage):
        if f.kind not in (Heard.SAMPLE, Heard.HEARTBEAT, Heard.EPOCH) or f.result is not Decoded.OK:
            continue
        codec = _status_codec(stage, f)
        if codec is None or codec.message.status < 0:
            continue
        count += 1
        if not f.status & Status.SIMULATED:
            raise BrokenRuleError(f"{f.text()} without the flag of a simulation")
        if f.state is None and stage.hearing.tells_state(f.name):
            raise BrokenRuleError(f"{f.text()} tells a state that does not exist")
    return f"{count} frames"


def _status_codec(stage: ParticipantStage, f: HeardFrame) -> Codec | None:
    known = stage.hearing.known(f.kind).get(f"{f.bus}/{f.name}")
    return known.codec if known else None


def _heartbeats(stage: ParticipantStage) -> str:
    """Heartbeats come every period; before the start more often is as well."""
    period, came = stage.seconds("heartbeat"), []
    if period <= 0:
        raise InapplicableRuleError("the deployment gives the participant no heartbeat")
    for bus in stage.buses:
        if stage.number not in stage.system.services[bus].heartbeats:
            continue
        gaps: list[float] = []
        for begin, end, _ in _runs(stage):
            times = [
                f.t_ns for f in stage.hearing.since(begin, Heard.HEARTBEAT)
                if f.index < end and f.bus == bus
            ]  # fmt: skip
            gaps += [(b - a) * 1e-9 for a, b in pairwise(times)]
        if not gaps:
            raise BrokenRuleError(f"no heartbeats on {bus}")
        limit = period + stage.slot + 0.005
        if median(gaps) > limit:
            raise _broken_in_time(
                stage,
                f"a heartbeat every {median(gaps) * 1e3:.0f} ms on {bus} (median), expected "
                f"{period * 1e3:g} ms",
            )
        late = [g for g in gaps if g > 2 * period + stage.slot + TOLERANCE]
        if len(late) > max(1, len(gaps) // 50):
            text = f"{len(late)} of {len(gaps)} gaps on {bus} above two periods"
            raise _broken_in_time(stage, text)
        came.append(f"{bus}: every {median(gaps) * 1e3:.0f} ms, at most {max(gaps) * 1e3:.0f} ms")
    return ", ".join(came)


def _rule(number: str, title: str, clause: str, expected: str) -> ConformityRule:
    return ConformityRule(number, title, clause, expected)


SENT_CHECKS = (
    Check(
        _rule("C-01", "identifiers and formats", "can.md#identifiers",
              "Each frame has identifier and format (on Zenoh: the key) of a message or service of "
              "the participant."),
        CheckScene.RECORD, _identifiers),
    Check(
        _rule("C-02", "lengths", "can.md#messages", "Each frame has the length of its message."),
        CheckScene.RECORD, _lengths),
    Check(
        _rule("C-03", "CRC and data ID", "can.md#protection",
              "Each protected frame has a valid CRC with the data ID of its message."),
        CheckScene.RECORD, _checksums),
    Check(
        _rule("C-04", "counters", "can.md#protection",
              "The counters of samples and of heartbeats grow by one, and wrap."),
        CheckScene.RECORD, _counters),
    Check(
        _rule("C-05", "time stamps", "can.md#receiving-a-frame",
              "The stamp of a sample is number · period + phase; the counter is the number's low "
              "bits."),
        CheckScene.RECORD, _stamps),
    Check(
        _rule("C-06", "periods", "can.md#identifiers",
              "Samples come once a period, at t = 0 + number · period + phase; tolerance: half a "
              "period, 20 ms, and a tenth of the kit's own lateness."),
        CheckScene.RECORD, _periods),
    Check(
        _rule("C-07", "values", "can.md#numbers",
              "No sample carries an invalid code or a value beyond the range of its signal."),
        CheckScene.RECORD, _values),
    Check(
        _rule("C-08", "status", "can.md#messages",
              "All frames of a rehearsal have status bit 7 (simulated), and tell a state that "
              "exists."),
        CheckScene.RECORD, _statuses),
    Check(
        _rule("C-09", "heartbeats", "can.md#identifiers",
              "In the run a heartbeat comes every `heartbeat` (50 ms) on each bus; tolerance: a "
              "slot and 5 ms (median)."),
        CheckScene.RECORD, _heartbeats),
)  # fmt: skip
