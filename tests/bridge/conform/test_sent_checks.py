"""Rules about what a participant sends, on frames that a test has written: a wrong one breaks the
rule that names it, and no other one.
"""

import dataclasses

import numpy as np
import pytest

from bridge.conform.checks import BrokenRuleError, CheckScene, VoidAttemptError
from bridge.conform.hearing import Heard
from bridge.conform.participant import CHECKS
from bridge.conform.stage import ParticipantStage
from bridge.deployment.system import load_system
from bridge.native.enums import LifeState, Status
from bridge.native.frame import Flags, Frame
from bridge.native.message import Header
from tests.bridge.deployments import TELEOPERATION

RECORD = {c.rule.number: c.judge for c in CHECKS if c.scene is CheckScene.RECORD}
T0, MS = 10**12, 1_000_000
STATUS = int(LifeState.ACTIVE) | int(Status.DEADMAN | Status.SIMULATED)


@dataclasses.dataclass
class Sent:
    """A frame that is about to arrive."""

    bus: str
    kind: Heard
    number: int
    t_ns: int
    header: Header
    values: list
    change: object = None


class Written:
    """200 samples and 20 heartbeats of master_control, as they should be."""

    def __init__(self):
        self.stage = ParticipantStage(load_system(TELEOPERATION, "can"), "master_control", ())
        self.stage.lateness.close()
        self.stage.lives.append(0)
        self.stage.runs.append((0, T0))
        self.stage.cast.t0_ns = T0
        self.link = self.stage.system.messages["LINK_2"]
        self.sent = [
            Sent("left", Heard.SAMPLE, k, T0 + self.nominal(k) + MS, self.header(k), [1, 2, 3, 4])
            for k in range(200)
        ]
        self.sent += [
            Sent("left", Heard.HEARTBEAT, k, T0 + k * 50 * MS,
                 Header(k, int(Status.SIMULATED), 0), [2, 0, 7, 1])
            for k in range(20)
        ]  # fmt: skip
        self.sent += [
            dataclasses.replace(s, bus="right") for s in self.sent if s.kind is Heard.HEARTBEAT
        ]

    def nominal(self, k):
        return k * self.link.period_ns + self.link.offset_ns

    def header(self, k):
        return Header(k % 256, STATUS, self.nominal(k) // 1000)

    def sample(self, k):
        return next(s for s in self.sent if s.kind is Heard.SAMPLE and s.number == k)

    def judge(self, number):
        for s in sorted(self.sent, key=lambda s: s.t_ns):
            service = self.stage.system.services[s.bus]
            codec = self.link.encoding if s.kind is Heard.SAMPLE else service.heartbeats[2]
            frame = codec.frame(s.values, s.header)
            self.stage.hearing.arrived(s.bus, s.change(frame) if s.change else frame, s.t_ns)
        return RECORD[number](self.stage)


def flipped(frame):
    frame.data[9] ^= 1
    return frame


def shorter(frame):
    frame.length = 20
    return frame


def classic(frame):
    return Frame.of(frame.id, frame.payload[:8], 0)


def foreign(frame):
    return Frame.of(0x3A3, frame.payload, int(Flags.FD | Flags.BRS))


def late(written):
    for s in written.sent:
        s.t_ns += 60 * MS * (s.kind is Heard.SAMPLE)


def slow(written):
    for s in written.sent:
        s.t_ns += s.number * 30 * MS * (s.kind is Heard.HEARTBEAT)


def header(field, change):
    def mutate(written):
        sample = written.sample(100)
        setattr(sample.header, field, change(getattr(sample.header, field)))

    return mutate


def changed(change):
    def mutate(written):
        written.sample(100).change = change

    return mutate


def valued(value):
    def mutate(written):
        written.sample(100).values = [value, 0, 0, 0]

    return mutate


def dropped(written):
    written.sent.remove(written.sample(100))


MUTANTS = [
    ("C-01", changed(foreign)),
    ("C-01", changed(classic)),
    ("C-02", changed(shorter)),
    ("C-03", changed(flipped)),
    ("C-04", header("counter", lambda c: c + 1)),
    ("C-04", dropped),
    ("C-05", header("t_us", lambda t: t + 10)),
    ("C-05", header("t_us", lambda t: t + 5000)),
    ("C-06", late),
    ("C-07", valued(np.nan)),
    ("C-07", valued(2000.0)),
    ("C-08", header("status", lambda s: s & ~int(Status.SIMULATED))),
    ("C-08", header("status", lambda s: s | 7)),
    ("C-09", slow),
]


@pytest.mark.parametrize("number", sorted(RECORD))
def test_frames_as_they_should_be_break_no_rule(number):
    assert Written().judge(number)


@pytest.mark.parametrize(("number", "mutate"), MUTANTS)
def test_a_wrong_frame_breaks_the_rule_that_names_it(number, mutate):
    written = Written()
    mutate(written)
    with pytest.raises(BrokenRuleError):
        written.judge(number)


@pytest.mark.parametrize(("number", "mutate"), [("C-06", late), ("C-09", slow)])
def test_a_late_kit_does_not_blame_the_participant(number, mutate):
    written = Written()
    mutate(written)
    written.stage.lateness.worst_ns = lambda since: 200 * MS
    with pytest.raises(VoidAttemptError):
        written.judge(number)
