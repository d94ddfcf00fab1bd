"""A listener on Zenoh receives the messages of nodes, publishes nothing, and is not a peer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from bridge.can.socket import BusError
from bridge.cli.monitor import monitor
from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import names_of
from bridge.monitor.listener import Listener
from bridge.monitor.listener_view import view
from bridge.monitor.messages import HeardSample, ReceivedMessage
from bridge.native.safety import LifeState, Status, Why
from bridge.zenoh.channel import ZenohAttachment
from bridge.zenoh.node_channel import open_bus, traffic_of
from bridge.zenoh.options import options_of
from cosim.base.clock import monotonic_ns
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.cli.options import flat
from tests.bridge.listening import ARMS, beat, encoded, followed, loaded, reached
from tests.bridge.zenoh.rehearsed import CONFIGS, collect, prepared, sockets

SECOND = 10**9
NEVER_DROPPED = "deploy.buses.net.options.lockstep=true"


@pytest.fixture(autouse=True)
def ahead(monkeypatch):
    """The command steps behind other processes; the tests that follow do not."""
    monkeypatch.setattr("bridge.cli.monitor._behind", lambda **_: None)


@pytest.fixture
def system(tmp_path: Path) -> System:
    return loaded(*sockets(ARMS, tmp_path))


@pytest.fixture
def master(system: System, tmp_path: Path) -> Iterator[ZenohAttachment]:
    """The master's end; it drops nothing."""
    end = open_bus(loaded(*sockets(ARMS, tmp_path), NEVER_DROPPED), "net", "master")
    yield end
    end.close()


def test_values_states_and_losses(system: System, master: ZenohAttachment):
    carried, skipped = system.messages["xi_master"], (5, 6, 11)
    with Listener(system) as listener:
        followed(listener, master, system)
        heard = listener.heard["xi_master"]
        for k in (k for k in range(1, 21) if k not in skipped):
            status = LifeState.ACTIVE | Status.SIMULATED
            master.bus.send(encoded(carried.encoding, [k, -k], k, status))
        reached(listener, lambda: heard.values[0] == 20.0)
        assert heard.values.tolist() == [20.0, -20.0]
        assert heard.lost == 3 and heard.sender() == "active simulated"
        assert listener.beats["master"].state == "active" and listener.there("master")
        assert listener.there("slave") is False
        assert master.bus.drain() == []  # nothing was sent to it
        row = next(r for r in view(listener, monotonic_ns()).tables[1].rows if r[0] == "xi_master")
        assert row[1] == "master" and row[6] == "3" and row[7].endswith("simulated")
        assert "master active" in view(listener, monotonic_ns()).line


def test_jitter_is_told_by_stamps_of_any_clock_also_where_they_wrap(system: System):
    heard = ReceivedMessage.of(system.messages["xi_master"])
    sent = [k * 5000 for k in range(6)]  # us, on the sender's clock
    transit = [700, 200, 900, 200, 1700, 450]  # us
    for stamp, took in zip(sent, transit, strict=True):
        arrived = (stamp + took + 12345678) * 1000
        heard.recent.append(HeardSample(arrived, (stamp + 2**32 - 11000) % 2**32, np.zeros(2)))
    assert heard.late.tolist() == pytest.approx([t * 1e-6 for t in (500, 0, 700, 0, 1500, 250)])
    heard.forget(10**12)
    assert heard.late.shape == (0,)


def test_a_payload_of_another_kind_is_refused(system: System, master: ZenohAttachment):
    with Listener(system) as listener:
        followed(listener, master, system)
        heard = listener.heard["xi_master"]
        broken = encoded(system.messages["xi_master"].encoding, [1.0, 2.0], 7)
        broken.data[30] ^= 1
        master.bus.send(broken)
        key = names_of(system.deployment, "net").message("master", "master_control", "xi_master")
        master.session.put(key, bytes(1000))
        master.bus.send(encoded(heard.carried.encoding, [np.nan, 1.0], 8, LifeState.ACTIVE))
        why = {"CRC": 1, "length": 1, "not finite": 1}
        reached(listener, lambda: why.items() <= heard.refused.items())
        assert heard.values.tolist() == [0.0, 0.0]


def test_a_listener_is_not_taken_for_the_peer_that_a_node_waits_for(
    system: System, master: ZenohAttachment, tmp_path: Path
):
    """The peer's token is there, and nobody but the listener might hear what the node says."""
    d = system.deployment
    said = traffic_of(system, "net", "slave")
    options = replace(options_of(d, "net", "slave"), wait=0.5)
    with Listener(system) as listener:
        reached(listener, lambda: listener.there("master"))
        deaf = replace(said, hears={})
        wrong = ZenohAttachment("net", names_of(d, "net"), deaf, options)
        reached(listener, lambda: listener.there("slave"))
        assert "slave there" in view(listener, monotonic_ns()).line
        master._options = replace(master._options, wait=0.5)
        with pytest.raises(BusError, match=r"^no node listens to teleoperation/master"):
            master.wait_for_peers()
        followed(listener, master, system)  # it runs all the same, say: then it is listened to
        assert listener.nets["net"].session.info.peers_zid()
        wrong.close()
        reached(listener, lambda: listener.there("slave") is False)
        reached(listener, lambda: not master.presence.there)
        with pytest.raises(BusError, match=r"^not there: slave after"):
            master.wait_for_peers()


def test_a_node_that_has_gone_is_listened_to_again_when_it_runs_again(
    system: System, master: ZenohAttachment
):
    with Listener(system) as listener:
        followed(listener, master, system, counter=100)
        now = monotonic_ns()
        master.close()
        reached(listener, lambda: listener.there("master") is False)
        assert "master gone" in view(listener, now + 2 * SECOND).line
        again = open_bus(system, "net", "master")
        reached(listener, lambda: listener.there("master"))
        assert not any(
            getattr(p.matching_status, "matching", False)
            for number, p in again._publishers.items()
            if number == system.messages["xi_master"].encoding.message.id
        )
        again.bus.send(beat(system, "master", LifeState.STOPPING, 2, Why.PEER | Why.ESTOP))
        heard, before = listener.heard["xi_master"], listener.heard["xi_master"].t_ns
        sample = encoded(heard.carried.encoding, [3.0, 4.0], 0, LifeState.STOPPING)
        reached(listener, lambda: heard.t_ns > before, lambda: again.bus.send(sample))
        assert heard.values.tolist() == [3.0, 4.0] and heard.lost == 0
        assert listener.beats["master"].boots == 2
        why = next(t for t in view(listener, monotonic_ns()).tables if t.title == "why")
        assert [row[0] for row in why.rows] == ["master", "master"]
        again.close()


def test_what_is_sent_before_the_run_counts_nothing(system: System, master: ZenohAttachment):
    encoding = system.messages["xi_master"].encoding
    with Listener(system) as listener:
        heard = listener.heard["xi_master"]

        def preview() -> None:
            master.bus.send(beat(system, "master", LifeState.INACTIVE))
            master.bus.send(encoded(encoding, [1.0, 2.0], 0, LifeState.INACTIVE))

        reached(listener, lambda: len(heard.recent) > 2, preview)
        for k in (9, 10, 11):
            master.bus.send(encoded(encoding, [k, k], k, LifeState.ACTIVE))
        reached(listener, lambda: heard.values[0] == 11.0)
        assert heard.lost == 0 and not heard.refused
        assert len(heard.late) <= 3  # a stamp is of the run


# ---- what users call ----


def call(*arguments: str):
    app = typer.Typer()
    app.command()(flat(monitor))
    given = ["--listen", "--scenario", str(CONFIGS / "teleoperation.toml"), *arguments]
    return CliRunner().invoke(app, given, catch_exceptions=False)


def test_where_nobody_is(tmp_path: Path):
    said = [x for text in sockets(ARMS, tmp_path) for x in ("--set", text)]
    done = call("--deploy", "zenoh", *said, "--once")
    assert done.exit_code == 0 and "nobody connected; tries unixsock-stream/" in done.output
    assert "never" in done.output and "none" in done.output


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            ["--connect", "tcp/192.0.2.1:7461"],
            "is reachable from other machines without encryption",
        ),
        (["--connect", "here"], "unknown protocol 'here'"),
        (["--mcap", "a.mcap"], "expected no --mcap"),
        (["--bus", "left"], "no bus 'left'; there are: net"),
        (["--set", "deploy.buses.net.options.listen={}"], "no address to connect to"),
    ],
)
def test_what_cannot_be_listened_to_is_a_sentence(given: list[str], said: str):
    with pytest.raises(ScenarioError, match=said):
        call("--deploy", "zenoh", "--once", *given)


@pytest.mark.slow
def test_a_rehearsal_that_is_listened_to(tmp_path: Path):
    """The listener is there before the nodes; they wait for each other, run, replay to the bit."""
    changes = ['run.stop="2 s"', *sockets(ARMS, tmp_path)]
    system, running = prepared("teleoperation", "zenoh", changes, tmp_path / "run")
    words: list[str] = []
    with Listener(system) as listener:

        def look(t: float, end: float) -> None:
            listener.receive(now := monotonic_ns())
            words.append(view(listener, now).line)

        with running:
            ended = running.run(look)
        assert [len(h.recent) > 0 or h.t_ns > 0 for h in listener.heard.values()] == [True, True]
        assert all(h.refused == {} for h in listener.heard.values())
    found = collect(system, ended, tmp_path / "run")
    assert ended.notes == [] and (found.replayed.greatest, found.replayed.first) == (0.0, None)
    assert all(found.reports[arm]["buses"]["net"]["restarts"] == 0 for arm in ARMS)
    assert any("master active, slave active; xi_master" in line for line in words)
