"""Nodes in lock-step: the samples that the end waits for, missing ones, and full queues."""

from __future__ import annotations

from threading import Thread

import pytest

from bridge.native import lockstep as native
from bridge.native.frame import Frame, Ring
from bridge.native.message import Header
from bridge.native.node import FINISHED, STOPPED
from bridge.native.safety import LifeState, Status
from cosim.base.clock import sleep
from tests.bridge.bench import until
from tests.bridge.node.test_lookahead import one, system_with

SENT = 5_000  # us, from a sample to the next


def alone(changes=(), stop=0.597, wait="50 ms"):
    """The system of a master whose links bring a sample 0.3 s after it was sent."""
    links = [f'links.{i}.delay={{law="constant", delay="0.3 s"}}' for i in (0, 1)]
    return system_with(*links, *changes, stop=stop, wait=wait)


def samples(system, counters):
    """A ring with these samples of the slave."""
    ring, encoding = Ring(512), system.messages["xi_slave"].encoding
    for k in counters:
        status = LifeState.ACTIVE | Status.SIMULATED
        ring.put(encoding.frame([0.0, 0.0], Header(counter=k, status=status, t_us=SENT * k)))
    return ring


@pytest.mark.parametrize(
    ("phase", "given", "result"),
    [("1.2", 120, FINISHED), ("1.2", 119, native.STALLED), ("1.5", 119, FINISHED),
     ("1.5", 118, native.STALLED), ("1.5", 60, native.STALLED)],
)  # fmt: skip
@pytest.mark.parametrize("ahead", ["true", "false"])
def test_a_run_ends_with_the_samples_before_its_last_slot(tmp_path, phase, given, result, ahead):
    """That of the master is at 596 ms + 0.3 ms; sample 119 is sent at 595 ms + 1.2 or 1.5 ms."""
    phases = [f'deploy.nodes.{n}.phase="{x} ms"' for n, x in (("slave", phase), ("master", 0.3))]
    system = alone([*phases, f"deploy.buses.net.options.lookahead={ahead}"])
    with one(system, "master", (samples(system, range(given)), Ring(512)), tmp_path) as node:
        assert node.run() == result
        struct = node.wired.struct
        if result == FINISHED:
            assert struct.slot == 597 and struct.life.state == LifeState.FINISHED
            assert node.wired.receivers["xi_slave"].ok == given
            assert node.error(result) == ""
        else:
            assert f"sample {given} of xi_slave" in node.error(result)
            assert (struct.slot == 597) == (ahead == "true" and given >= 60)


def test_samples_behind_the_last_one_are_not_looked_at(tmp_path):
    """A sender that goes on after the end sends numbers that are not those of this run."""
    system = alone()
    with one(system, "master", (samples(system, [*range(120), 7, 0]), Ring(512)), tmp_path) as node:
        assert node.run() == FINISHED


@pytest.mark.parametrize("started", [False, True])
@pytest.mark.parametrize(("counters", "at"), [((0, 1, 3), 2), ((1,), 0), ((0, 0), 1)])
def test_a_sample_that_is_missing_is_named_before_and_after_the_start(
    tmp_path, counters, at, started
):
    system = alone()
    with one(system, "master", (samples(system, counters), Ring(512)), tmp_path) as node:
        node.wired.struct.told *= started
        result = node.run()
        assert result == native.LOST and node.wired.struct.slot == 0
        assert (node.struct.awaited, node.struct.found) == (0, counters[-1])
        assert f"sample {at} of xi_slave" in node.error(result)


def taken(ring, found):
    frame = Frame()
    while ring.get(frame):
        found.append(Frame.from_buffer_copy(frame))


def test_a_queue_that_is_full_holds_a_node_up_and_loses_nothing(tmp_path):
    system, sent, found, over = alone(), Ring(4), [], []
    encoding = system.messages["xi_master"].encoding

    def take():
        while not over:
            sleep(0.001)
            taken(sent, found)

    with one(system, "master", (samples(system, range(120)), sent), tmp_path) as node:
        taker = Thread(target=take)
        taker.start()
        try:
            assert node.run() == FINISHED
        finally:
            over.append(1)
            taker.join()
    taken(sent, found)
    headers = [encoding.decode(frame.payload)[2] for frame in found]
    assert [header.counter for header in headers] == list(range(120))
    assert [header.t_us for header in headers] == [SENT * k for k in range(120)]


def test_a_node_that_waits_for_room_can_be_stopped(tmp_path):
    system, sent = alone(wait="20 s"), Ring(4)
    with one(system, "master", (samples(system, range(120)), sent), tmp_path) as node:
        results = []
        runner = Thread(target=lambda: results.append(node.run()))
        runner.start()
        until(lambda: len(sent) == 4)
        node.wired.struct.quit = 1
        runner.join(20.0)
        assert results == [STOPPED] and node.wired.struct.slot <= 21
