"""Response times that `cosim check --deploy` prints, with the transmit queues of the deployment."""

from __future__ import annotations

import pytest

from bridge.can.messages import bus_responses
from bridge.can.rates import simulated_worst
from bridge.preflight import deployment
from cosim.bus.settings import QueueKind
from tests.bridge.deployments import TELEOPERATION, named
from tests.cli.command import Command


def responses(system, bus):
    """Of each message: worst by analysis and on the simulated bus, s."""
    messages = [m for m in deployment.messages(system) if m.bus == bus]
    timing = deployment.timings(system)[bus]
    simulated = simulated_worst(messages, timing)
    return {
        m.name: (response.worst * 1e-9, simulated[m.extended, m.identifier])
        for m, response in bus_responses(messages, timing)
    }


@pytest.mark.parametrize("queue", ["fifo", "sorted"])
@pytest.mark.parametrize("name", ["can", "can-classic", "can-cia402"])
def test_the_simulated_response_is_within_the_analysis(name, queue):
    system = named(name, f'deploy.buses.left.queue="{queue}"')
    found = responses(system, "left")
    assert len(found) > 5
    assert all(0 < simulated <= worst for worst, simulated in found.values())


def test_in_a_fifo_a_message_waits_for_what_its_node_queued_before():
    fifo = responses(named("can-classic"), "left")
    by_priority = responses(named("can-classic", 'deploy.buses.left.queue="sorted"'), "left")
    assert fifo["TAU_2"][0] > 2 * by_priority["TAU_2"][0]
    assert fifo["SYNC"] != by_priority["SYNC"]


def test_messages_have_the_queue_of_their_bus_and_the_order_of_their_node():
    system = named("can-classic", 'deploy.buses.right.queue="mailboxes"')
    found = deployment.messages(system)
    assert {(m.bus, m.queue) for m in found} == {
        ("left", QueueKind.FIFO), ("right", QueueKind.MAILBOXES),
    }  # fmt: skip
    mine = [m.name for m in found if (m.bus, m.node) == ("left", "master_control")]
    assert mine == ["SYNC", "TAU_2", "XI_2", "HEARTBEAT_2"]


def test_check_says_which_queues_there_are(monkeypatch, capsys):
    cosim = Command(monkeypatch, capsys)
    changed = ("--set", 'deploy.buses.right.queue="sorted"')
    said = cosim("check", TELEOPERATION, "--deploy", "can", *changed).out
    assert "\nbus left, transmit queues: fifo\n" in said
    assert "\nbus right, transmit queues: sorted\n" in said


def test_states_that_drives_tell_by_themselves_are_counted():
    """CANSimple: a heartbeat has command 1 in the lowest five bits of its identifier."""
    told = {
        m.identifier: m.period
        for m in deployment.messages(named("six_axis"))
        if m.bus == "left" and m.node.startswith("drive ")
    }
    assert told == {number << 5 | 1: 0.01 for number in range(1, 7)}
