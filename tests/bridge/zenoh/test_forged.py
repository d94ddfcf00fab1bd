"""A stranger on an open network sends services of the nodes: the run goes on, and says so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import zenoh

from bridge.deployment.zenoh_keys import names_of
from bridge.native import epoch
from bridge.native.frame import DATA
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status
from bridge.records.node_lives import Life
from bridge.records.records import Statement
from bridge.rehearsal.supervisor import NODES, Rehearsal, RehearsalRecord
from bridge.replay import replay
from bridge.results.extra_senders import extra_services
from cosim.base.clock import realtime_ns, sleep, stopwatch
from tests.bridge.results.test_elsewhere import report
from tests.bridge.zenoh.rehearsed import collect, prepared, sockets

STARTS, BEATS, LONG = 50, 200, 18
ARMS = ("master", "slave")


class Stranger:
    """A client of one node's session."""

    def __init__(self, system, socket):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["unixsock-stream/{socket}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session, self._system = zenoh.open(config), system
        self._names = names_of(system.deployment, "net")

    def say(self, key, encoding, values, counter=0):
        header = Header(status=int(Status.SIMULATED), counter=counter)
        self.put(key, encoding.frame(values, header, 0).payload)

    def put(self, key, data):
        """Send what a busy receiver may not make the session drop, for it is counted."""
        self._session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

    def forge(self):
        names, services = self._names, self._system.services["net"]
        beat = services.heartbeats[self._system.deployment.nodes["slave"].number]
        said = epoch.values(9, 77, True, realtime_ns(), (1.0, 2.0, 3.0, 4.0))
        for k in range(BEATS):
            self.say(names.of("slave", "heartbeat"), beat, [LifeState.FINISHED, 0, 1, 0], k)
            if k < STARTS:
                self.say(names.shared("epoch"), services.epoch, said, k)
                self.say(names.shared("nmt"), services.nmt, [1, 0], k)
            if k < LONG:
                self.put(names.of("slave", "heartbeat"), bytes(DATA + 1 + 100_000 * k))
        sleep(1.0)  # closing the session drops what it has not yet written
        self._session.close()

    def flood(self, seconds, least):
        """Messages of 5 MB to a key that the node hears: for so long, and at least so many.

        Before `least` none may be dropped, for they are counted.
        """
        key, elapsed = self._names.of("slave", "heartbeat"), stopwatch()
        for _ in range(least):
            self.put(key, bytes(5_000_000))
        while elapsed() < seconds:
            self._session.put(key, bytes(5_000_000))
        self._session.close()


def during(running: Rehearsal, act: Callable[[], None]) -> RehearsalRecord:
    """Run; what a stranger does begins 1.5 s after all are ready."""
    ready = running._all_ready

    def later() -> None:
        sleep(1.5)  # the run has begun
        act()

    def then_act() -> None:
        ready()
        Thread(target=later, daemon=True).start()

    running._all_ready = then_act  # type: ignore[method-assign]
    with running:
        return running.run()


def test_forged_services_are_counted_and_named(tmp_path: Path) -> None:
    calm = [f"deploy.nodes.{n}.within=10" for n in ARMS]
    changes = ['run.stop="8 s"', *calm, *sockets(ARMS, tmp_path)]
    system, running = prepared("teleoperation", "zenoh", changes, tmp_path / "run")
    during(running, lambda: Stranger(system, tmp_path / "master").forge())
    lives = {name: Statement.read(tmp_path / "run" / NODES, Life(name)) for name in system.nodes}
    master = lives["master"]
    assert master is not None and master.end == "finished"
    assert master.services["epochs"] >= STARTS and master.services["late_starts"] == STARTS
    assert master.heartbeats["slave"] >= BEATS
    assert master.buses["net"]["oversized"] == LONG
    reports = [SimpleNamespace(life=Life(n), statement=s) for n, s in lives.items()]
    said = [x for x in extra_services(system, reports) if x.startswith("master ")]
    assert "of which" in said[0] and "heartbeats of slave" in said[0]
    assert f"{STARTS} STARTs while it ran" in said[2]
    assert f"{LONG} messages longer than any" in said[3]
    assert "EPOCHs, of which" in said[1] and len(said) == 4


def test_what_nodes_send_themselves_is_no_surplus() -> None:
    """Over several buses; of a node that was killed it is not known what it sent."""

    def one(node, heartbeats, **services):
        made = report(node)
        made.statement.heartbeats, made.statement.services = heartbeats, services
        made.statement.buses = {}
        return made

    system = SimpleNamespace(buses_of=lambda node: ("left", "right"))
    quiet = [
        one("a", {"b": 200, "away": 10**6}, heartbeats_sent=100, epochs=8, epochs_sent=1),
        one("b", {"a": 100}, heartbeats_sent=100, epochs=0, epochs_sent=4),
    ]
    assert not list(extra_services(system, quiet))
    quiet[0].statement.heartbeats["b"] = 300
    (found,) = extra_services(system, quiet)
    assert found == (
        "a heard 300 heartbeats of b, of which 100 were sent: somebody else sends them, too"
    )
    quiet[1].statement = None
    assert not list(extra_services(system, quiet))


def test_after_messages_of_megabytes_samples_come_as_before(tmp_path: Path) -> None:
    """For 1.5 s a third session sends 5 MB after 5 MB; then ages are what they were."""
    calm = [f"deploy.nodes.{n}.within=10" for n in ARMS]
    changes = ['run.stop="6 s"', *calm, *sockets(ARMS, tmp_path)]
    system, running = prepared("teleoperation", "zenoh", changes, tmp_path / "run")
    flooded = during(running, lambda: Stranger(system, tmp_path / "master").flood(1.5, 10))
    found = collect(system, flooded, tmp_path / "run")
    heard = replay.received_by_life(tmp_path / "run" / NODES)[Life("master")]
    period = system.messages["xi_slave"].period_ns
    sent = heard["sequence"] * period * 1e-9
    last = sent > 5.0
    assert last.sum() > 0.5e9 / period  # of those that were sent, most came
    assert np.median(heard["arrival_ns"][last] * 1e-9 - sent[last]) < 0.5  # and no backlog
    assert found.reports["master"]["buses"]["net"]["oversized"] >= 10  # which the verdict names
    assert found.reports["master"]["end"] == "finished"
