"""A node on a bus that does not leave the process: how it ends, and what is left of it."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from types import SimpleNamespace

import pytest

import bridge.node.run
from bridge.deployment.system import load_system
from bridge.node.run import NodeOptions, run_node
from bridge.records.node_lives import Life
from bridge.records.records import Gone, LifeEnd, Missed
from bridge.rehearsal import supervisor
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal, Settings
from bridge.results.outcome import complete
from bridge.results.report import NodeReport, fault_lines
from cosim.base.clock import monotonic_ns
from cosim.base.errors import RunError
from tests.bridge.bench import Bench, until
from tests.bridge.deployments import CONFIGS, TELEOPERATION

CAN = CONFIGS / "deploy" / "can.toml"


def changes(test, *more):
    """Buses of their own for a test."""
    buses = {"left": f"{test} left", "right": f"{test} right"}
    said = [f'deploy.buses.{bus}.interface="virtual"' for bus in buses]
    return (*said, *(f'deploy.buses.{b}.channel="{c}"' for b, c in buses.items()), *more)


def run_master(folder, name, listen, stop):
    """The drive of the master alone; its report."""
    settings = changes(name, f"run.stop={stop}", "deploy.silence=0")
    system = load_system(TELEOPERATION, "can", settings)
    options = NodeOptions(Life("master"), folder, warm_up=0.0, realtime=False)
    report = run_node(system, options, lambda event: None, listen)
    assert json.loads((folder / "master.json").read_text())["end"] == report.end
    return report


def test_a_ctrl_c_while_it_finishes_does_not_take_its_report(monkeypatch, request, tmp_path):
    real = bridge.node.run.node_statement

    def interrupted(*given):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)
        return real(*given)

    monkeypatch.setattr(bridge.node.run, "node_statement", interrupted)
    report = run_master(tmp_path, request.node.name, lambda control: control.quit(), 1.0)
    assert report.end is LifeEnd.NEVER_STARTED


def broken(*_):
    raise ValueError("an error of a helper")


@pytest.mark.parametrize("event", ["ready", "joined"])
def test_an_error_of_a_thread_next_to_a_node_ends_it(request, tmp_path, event):
    """It printed a traceback, and waited for ever for a start that nobody could give."""
    settings = changes(request.node.name, "run.stop=60", "deploy.silence=0")
    system = load_system(TELEOPERATION, "can", settings)
    options = NodeOptions(Life("master"), tmp_path, warm_up=0.0, realtime=False)

    def say(told):
        if told["event"] == event:
            broken()

    def listen(control):
        if event == "joined":
            control.start(monotonic_ns() - 10**10)

    with pytest.raises(ValueError, match="of a helper"):
        run_node(system, options, say, listen)
    with pytest.raises(ValueError, match="of a helper"):
        run_node(system, options, lambda told: None, broken)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_it_whichever_thread_gets_it(request, tmp_path, number):
    """Those of libraries block none, and the kernel asks any of them."""
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()

    def listen(control):
        control.start(monotonic_ns() + 200_000_000)
        until(lambda: control._struct.begun)
        signal.pthread_kill(other.ident, number)

    try:
        assert run_master(tmp_path, request.node.name, listen, 60.0).end is LifeEnd.STOPPED
    finally:
        over.set()
        other.join()


def test_a_life_that_begins_after_the_end_says_so(request, tmp_path):
    def listen(control):
        control.start(monotonic_ns() - 5_000_000_000)

    report = run_master(tmp_path, request.node.name, listen, 0.1)
    assert report.end is LifeEnd.TOO_LATE
    assert report.slots == 0
    assert "100 slots to t = 0.1 s" in report.error


def test_a_node_that_is_stopped_before_its_start_does_not_wait_for_it(tmp_path):
    with Bench(tmp_path) as bench:
        bench.heard()
        bench.control.start(monotonic_ns() + 3600_000_000_000)
        bench.control.stop()
        until(lambda: bench.result is not None)
    assert not bench.wired.struct.begun


# ---- among others ---------------------------------------------------------------------------


def rehearse(folder, name, events, *more):
    """What came of it; all nodes are threads."""
    said = changes(name, 'run.step="5 ms"', *more)
    system = load_system(TELEOPERATION, str(CAN), said)
    settings = Settings(TELEOPERATION, CAN, said, warm_up=0.0, realtime=False, events=events)
    with Rehearsal(system, settings, folder) as rehearsal:
        rehearsal.run()
    return rehearsal.ended


def test_nobody_waits_for_a_start_after_one_has_failed(monkeypatch, request, tmp_path):
    monkeypatch.setattr(supervisor, "LEAD", 60.0)  # s; nobody starts before that
    events = [
        ScheduledEvent(-59.9, "one is gone", lambda r: r.current["slave"].send_command("quit"))
    ]
    ended = rehearse(tmp_path, request.node.name, events, "run.stop=30")
    assert {life.done["end"] for life in ended.lives} == {"never started"}


def test_a_life_that_joins_after_the_end_is_a_note(request, tmp_path):
    def goes(rehearsal):
        rehearsal.expected.add("slave")
        rehearsal.current["slave"].send_command("quit")

    def comes_back(rehearsal):
        until(lambda: rehearsal.t > 0.5)
        rehearsal.restart("slave")

    events = [ScheduledEvent(0.2, "gone", goes), ScheduledEvent(0.3, "back", comes_back)]
    ended = rehearse(tmp_path, request.node.name, events, "run.stop=0.4")
    assert isinstance(ended.notes[-1], Missed) and ended.notes[-1].life == Life("slave", 2)
    assert ended.lives[-1].done["end"] is LifeEnd.TOO_LATE


@pytest.mark.parametrize(("t", "note"), [(0.5, Missed), (0.3, Gone)])
def test_a_life_that_found_nobody_is_missed_only_where_the_run_was_over(tmp_path, t, note):
    class Fake:
        start = SimpleNamespace(life=Life("slave", 2))
        code, done, ready, refused, deaf, drives = 2, None, None, [], (), None
        faults: list[dict[str, object]] = []  # noqa: RUF012

        def poll(self):
            pass

        def reason(self):
            return "nobody listens"

    system = load_system(TELEOPERATION, str(CAN), ["run.stop=0.4"])
    rehearsal = Rehearsal(system, Settings(TELEOPERATION, CAN, ()), tmp_path)
    rehearsal.current["slave"] = Fake()
    rehearsal.ended.start_ns = monotonic_ns() - round(t * 1e9)
    rehearsal._look()
    (found,) = rehearsal.ended.notes
    assert isinstance(found, note) and found.detail == "nobody listens"


def test_when_a_rehearsal_is_left_all_nodes_are_told_before_any_is_waited_for(
    monkeypatch, request, tmp_path
):
    said = changes(request.node.name)
    order = []

    class Fake:
        def __init__(self, start):
            self.start, self.ready, self.done, self.drives = start, None, None, None

        def check(self):
            raise RunError("cannot be configured")

        def send_command(self, command):
            order.append(command)

        def end(self):
            order.append("end")

    system = load_system(TELEOPERATION, str(CAN), said)
    with (
        pytest.raises(RunError, match="cannot be configured"),
        Rehearsal(system, Settings(TELEOPERATION, CAN, said), tmp_path) as rehearsal,
    ):
        monkeypatch.setattr(rehearsal, "_kind", Fake)
        rehearsal.run()
    assert order == ["quit"] * 4 + ["end"] * 4


# ---- what it says of what it sent -----------------------------------------------------------


def test_values_that_do_not_fit_their_message_are_told(request, tmp_path):
    """Positions of a frame end at 2048 rad; this arm stands further round."""
    far = "components.master.start.q=[3000.0,0.0]"

    def listen(control):
        control.start(monotonic_ns() + 200_000_000)
        until(lambda: control._struct.slot > 10)
        control.quit()

    system = load_system(
        TELEOPERATION, "can", changes(request.node.name, "run.stop=600", "deploy.silence=0", far)
    )
    options = NodeOptions(Life("master"), tmp_path, warm_up=0.0, realtime=False)
    report = run_node(system, options, lambda event: None, listen)
    assert report.sent["STATE_1"]["saturated"] > 0
    said = NodeReport(Life("master"), 50, None, "finished", (), report)
    assert "STATE_1" in fault_lines([said])[0]
    assert "did not fit" in fault_lines([said])[0]


def test_where_no_node_came_to_a_slot_it_is_said_why(monkeypatch, request, tmp_path):
    monkeypatch.setattr(supervisor, "LEAD", 60.0)  # s; nobody starts before that
    told = ScheduledEvent(-60.0, "told to stop", lambda rehearsal: rehearsal.stop())
    ended = rehearse(tmp_path, request.node.name, [told])
    system = load_system(TELEOPERATION, str(CAN), changes(request.node.name))
    with pytest.raises(RunError, match=r"no node reached its first slot \(.*told to stop"):
        complete(system, tmp_path, ended, {})
