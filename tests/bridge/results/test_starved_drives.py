"""A machine that stands still starves drives: inconclusive, not failed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd
from bridge.results import overload, verdict
from bridge.results.verdict import Word
from tests.bridge.deployments import named

OFF = "master_control: drive 1 on bus left follows nothing"


def outcome(failure: str, reasons: tuple[str, ...] = ("drive",), off: bool = True) -> Any:
    """A run that a drive ended; `failure`: the sign that its node noticed."""
    event = {"t": 1.0, "drive": "drive 1 on bus left", "phase": "failed", "failure": failure}
    statement = SimpleNamespace(messages={}, sent={}, drives=(event,), error="")
    report = SimpleNamespace(
        life=Life("master_control"), statement=statement, reasons=reasons, end=LifeEnd.FAULT,
        why=f"drive 1 on bus left: {failure}",
    )  # fmt: skip
    replayed = SimpleNamespace(first=None, altered=())
    return SimpleNamespace(
        reports=[report], replayed=replayed, faults=(), finished=False,
        rows={Life("master_control"): np.zeros(0, [("slot", np.int64), ("state", np.int32)])},
        unanswered=(OFF,) if off else (), notes=(), required=(),
    )  # fmt: skip


@pytest.fixture(params=["", "this machine let a node wait for 1200 ms"])
def late(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The cause that the machine has."""
    monkeypatch.setattr(overload, "cause", lambda *_: request.param)
    for name in ("extra_frames", "extra_services"):
        monkeypatch.setattr(verdict, name, lambda *_: ())
    monkeypatch.setattr(verdict, "_old_torques", lambda *_: ())
    return str(request.param)


def test_a_drive_that_told_nothing_on_a_machine_that_stood_still_is_inconclusive(late: str) -> None:
    found = verdict.judge(named("can-damiao"), outcome("silent"))
    assert found.word == (Word.INCONCLUSIVE if late else Word.FAILED)
    assert OFF in found.reasons and any("silent" in text for text in found.reasons)


@pytest.mark.parametrize("failure", ["state", "number", "format"])
def test_a_drive_that_tells_a_fault_fails_on_any_machine(late: str, failure: str) -> None:
    found = verdict.judge(named("can-damiao"), outcome(failure))
    assert found.word == Word.FAILED and OFF in found.reasons


def test_a_drive_that_follows_nothing_fails_where_nothing_stopped(late: str) -> None:
    run = outcome("", reasons=())
    run.finished, run.reports[0].end = True, LifeEnd.FINISHED
    assert verdict.judge(named("can-damiao"), run).word == Word.FAILED
