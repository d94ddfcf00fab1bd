"""Rules about the EPOCH that a participant believes, and that by which it starts."""

from __future__ import annotations

from bridge.conform.cast import EpochFields, copy_of
from bridge.conform.checks import (
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    needs_epoch,
    needs_program,
    state_text,
)
from bridge.conform.hearing import Heard, HeardFrame
from bridge.conform.rules import ConformityRule
from bridge.conform.stage import ParticipantStage
from bridge.native.enums import EPOCH_LEAD_NS, NMT_START, LifeState
from bridge.native.frame import Frame
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.copies import replace

#: s from an EPOCH that may be rejected to its t = 0.
AHEAD = 0.7


def _damaged_epoch(stage: ParticipantStage) -> str:
    def damage(frame: Frame) -> Frame:
        data = bytearray(frame.payload)
        data[8 if len(data) > 8 else 0] ^= 0x04  # in the CRC of P04 or P02: the rest is plausible
        return copy_of(frame, bytes(data))

    return _rejects(stage, "that is damaged", EpochFields(0, damage=damage))


def _needs_date(stage: ParticipantStage) -> None:
    if any(stage.system.deployment.buses[b].kind != "can" for b in stage.buses):
        raise InapplicableRuleError("EPOCH has the identity of the host, and no DATE, on Zenoh")


def _other_date(stage: ParticipantStage) -> str:
    _needs_date(stage)
    return _rejects(stage, "of another clock", EpochFields(0, date_error_ns=3 * 10**9))


def _other_host(stage: ParticipantStage) -> str:
    return _rejects(stage, "of another host", EpochFields(0, other=True))


def _no_date(stage: ParticipantStage) -> str:
    _needs_date(stage)
    return _rejects(stage, "without DATE", EpochFields(0, dated=False))


def _by_date(stage: ParticipantStage) -> str:
    _needs_date(stage)
    strange = EpochFields(0, date_error_ns=3 * 10**9, other=True)
    first, away, fits = _strange_start(stage, strange, believed=True)
    said = f"{away * 1e3:+.0f} ms from the t = 0 of an EPOCH of another host and clock"
    if not fits:
        raise BrokenRuleError(f"ACTIVE {said}, expected up to 100 ms before it")
    return f"{first.text()} {said}"


def _rejects(stage: ParticipantStage, what: str, said: EpochFields) -> str:
    """The EPOCH of a new life is rejected: t = 0 is 0.1 s after START."""
    first, away, fits = _strange_start(stage, said, believed=False)
    if not fits:
        raise BrokenRuleError(
            f"ACTIVE {away * 1e3 + 100:.0f} ms after START, expected 100 ms: it believed an EPOCH "
            f"{what}"
        )
    return f"{first.text()} {away * 1e3 + 100:.0f} ms after START"


def _strange_start(
    stage: ParticipantStage, said: EpochFields, *, believed: bool
) -> tuple[HeardFrame, float, bool]:
    """A new life gets this EPOCH, `AHEAD` s before its t = 0, and START: its first ACTIVE frame,
    how long after the expected t = 0 it came (s), and whether that is in time.
    """
    needs_program(stage)
    needs_epoch(stage)
    stage.end_life()
    stage.begin()
    stage.cast.silent = False
    sleep(0.3)
    since, mark = monotonic_ns(), len(stage.hearing)
    told_ns = monotonic_ns() + round(AHEAD * 1e9)
    stage.cast.epoch(replace(said, origin_ns=told_ns))
    t0_ns = told_ns if believed else monotonic_ns() + EPOCH_LEAD_NS
    stage.command(NMT_START)
    stage.begin_run(t0_ns)
    first = stage.hearing.wait(
        lambda f: f.kind in (Heard.SAMPLE, Heard.HEARTBEAT) and f.state is LifeState.ACTIVE,
        mark, 1.5,
    )  # fmt: skip
    if first is None:
        raise BrokenRuleError(f"{state_text(stage)} 1.5 s after START")
    away = (first.t_ns - t0_ns) * 1e-9
    slack = 0.1 + stage.late(since)
    return first, away, -0.02 - EPOCH_LEAD_NS * 1e-9 <= away <= slack + stage.slot


def _rule(number: str, title: str, clause: str, expected: str) -> ConformityRule:
    return ConformityRule(number, title, clause, expected)


EPOCH_CHECKS = (
    Check(
        _rule("C-72", "damaged EPOCH", "can.md#messages",
              "A damaged EPOCH is rejected: t = 0 is 0.1 s after START."),
        CheckScene.OTHER_LIFE, _damaged_epoch),
    Check(
        _rule("C-77", "EPOCH of another clock", "can.md#messages",
              "An EPOCH is rejected if the DATE before it differs by more than 2 s from the "
              "receiver's own date: t = 0 is 0.1 s after START."),
        CheckScene.OTHER_LIFE, _other_date),
    Check(
        _rule("C-78", "EPOCH of another host", "can.md#messages",
              "An EPOCH is rejected if the HOST before it, or on Zenoh its identity, is of another "
              "host with the same number: t = 0 is 0.1 s after START."),
        CheckScene.OTHER_LIFE, _other_host),
    Check(
        _rule("C-79", "EPOCH by DATE", "firmware.md#the-board",
              "A participant without a date (`--without date`) takes that of DATE, whatever the "
              "host and clock: t = 0 is as long after DATE as EPOCH tells."),
        CheckScene.OTHER_LIFE, _by_date),
    Check(
        _rule("C-80", "EPOCH without DATE", "firmware.md#the-board",
              "A participant without a date (`--without date`) rejects an EPOCH without DATE: "
              "t = 0 is 0.1 s after START."),
        CheckScene.OTHER_LIFE, _no_date),
)  # fmt: skip
