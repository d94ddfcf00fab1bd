"""Rehearsals of some nodes: real drives, and nodes on other machines, do not report here."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bridge.records.node_lives import Life
from bridge.results.extra_senders import extra_frames
from bridge.results.outcome import metric_lines
from cosim.record import Run
from tests.bridge.deployments import named, offline, scenario_of

CONTROLLERS = ("master_control", "slave_control")


def report(node, **heard):
    """Of a node that received so many frames of messages."""
    messages = {name: {"ok": n} for name, n in heard.items()}
    return SimpleNamespace(life=Life(node), statement=SimpleNamespace(messages=messages, sent={}))


def test_frames_of_a_drive_that_is_elsewhere_are_no_surplus():
    system = named("can", "run.stop=0.1")
    rows = {Life(name): {"slot": np.zeros(0, dtype=np.int64)} for name in ("master", *CONTROLLERS)}
    reports = [report("master_control", STATE_1=1000, LINK_4=0), report("slave_control")]
    assert list(extra_frames(system, rows, reports)) == []
    (found,) = extra_frames(system, rows, [*reports, report("master")])  # here, and sent none
    assert (found.message, found.heard, found.sent) == ("STATE_1", 1000, 0)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return offline(scenario_of("can"), tmp_path_factory.mktemp("run") / "run", "run.stop=0.1")


def test_metrics_name_the_signals_of_nodes_that_are_elsewhere(run):
    system = named("can", "run.stop=0.1")

    def said(*nodes):
        outcome = SimpleNamespace(reports=[report(node) for node in nodes])
        return [" ".join(text.split()) for text in metric_lines(system, outcome, run)]

    away = said(*CONTROLLERS)
    assert away[0] == (
        "sync error not computed: master.q, slave.q, of a node that did not run here"
    )
    assert away[-1].startswith("peak torque ") and "N.m at" in away[-1]
    everything = said("master", "slave", *CONTROLLERS)
    assert len(everything) == 11 and "not computed" not in " ".join(everything)
