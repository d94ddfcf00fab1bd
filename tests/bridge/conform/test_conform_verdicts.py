"""A rule is broken only by a kit that is in time; a kit that is late is inconclusive."""

import pytest

from bridge.conform.checks import (
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    VoidAttemptError,
)
from bridge.conform.participant import ATTEMPTS, PARTICIPANT_RULES, ParticipantKit
from bridge.conform.rules import Conformity
from bridge.deployment.system import load_system
from tests.bridge.deployments import TELEOPERATION


class Attempts:
    """A judge whose attempts have the results of a list; the last one is repeated."""

    def __init__(self, *ends):
        self.ends, self.count = list(ends), 0

    def __call__(self, stage):
        end = self.ends[min(self.count, len(self.ends) - 1)]
        self.count += 1
        if end is not None:
            raise end("it came")
        return "as expected"


@pytest.fixture
def kit():
    kit = ParticipantKit(load_system(TELEOPERATION, "can"), "master_control", (), ["ranges"])
    yield kit
    kit._stage.lateness.close()


def judged(kit, *ends, late_s=0.0, number="C-73", scene=CheckScene.OTHER_LIFE):
    kit._stage.lateness.worst_ns = lambda since: round(late_s * 1e9)
    judge = Attempts(*ends)
    found = kit._judged(Check(PARTICIPANT_RULES[number], scene, judge))
    return found.verdict, judge.count


def test_two_punctual_attempts_break_a_rule(kit):
    assert judged(kit, BrokenRuleError) == (Conformity.FAILED, 2)
    assert judged(kit, BrokenRuleError, None) == (Conformity.PASSED, 2)
    assert judged(kit, VoidAttemptError, BrokenRuleError) == (Conformity.FAILED, 3)


def test_a_late_kit_breaks_no_rule(kit):
    assert judged(kit, BrokenRuleError, late_s=1.0) == (Conformity.INCONCLUSIVE, ATTEMPTS)
    assert judged(kit, VoidAttemptError) == (Conformity.INCONCLUSIVE, ATTEMPTS)


def test_tolerances_count_no_more_lateness_than_a_verdict_bears(kit):
    kit._stage.lateness.worst_ns = lambda since: 10**12
    assert kit._stage.late(0) == kit._stage.bears == 0.05  # half of 100 ms without STATE_1


def test_rules_that_do_not_apply(kit):
    assert judged(kit, InapplicableRuleError) == (Conformity.NOT_APPLICABLE, 1)
    assert judged(kit, BrokenRuleError, number="C-57") == (Conformity.NOT_APPLICABLE, 0)


def test_frames_are_judged_once(kit):
    record = {"number": "C-01", "scene": CheckScene.RECORD}
    assert judged(kit, BrokenRuleError, **record) == (Conformity.FAILED, 1)


@pytest.mark.parametrize(("late_s", "sent"), [(1, 201), (5, 1)])
def test_a_kit_that_is_seconds_behind_leaves_samples_out(kit, late_s, sent):
    cast, now_ns = kit._stage.cast, 10**12
    frames = []
    cast.send, cast.silent = lambda bus, frame: frames.append(bus), False
    cast.t0_ns, cast.sync = now_ns - 10**10, None
    role = cast.messages["STATE_1"]
    for other in (*cast.peers.values(), *cast.messages.values()):
        other.due_ns = now_ns + 1
    role.number, role.due_ns = 7, now_ns - late_s * 10**9
    cast._turn(now_ns)
    assert len(frames) == sent
    # All the same it has counted them, is due next in its grid, and was late by all of it.
    assert role.number == 7 + late_s * 200 + 1
    assert role.due_ns == now_ns + 5_000_000
    assert kit._stage.lateness.worst_ns(now_ns) == late_s * 10**9
