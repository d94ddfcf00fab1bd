"""A listener gets states, values and losses from frames, and sends none."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from bridge.can.interface import attach
from bridge.cli.monitor import monitor
from bridge.monitor.listener import Listener
from bridge.monitor.listener_view import view
from bridge.native import message as native
from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.native.safety import LifeState, Status, Why
from bridge.node.buses import can_spec
from bridge.safety.limits import explain
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import ScenarioError
from cosim.cli.options import flat
from tests.bridge.deployments import TELEOPERATION, named

SECOND = 10**9


@pytest.fixture(autouse=True)
def ahead(monkeypatch):
    """The command steps behind other processes; the tests that follow do not."""
    monkeypatch.setattr("bridge.cli.monitor._behind", lambda **_: None)


@pytest.fixture
def system(request):
    changes = [
        f'deploy.buses.{bus}.{key}="{value}"'
        for bus in ("left", "right")
        for key, value in (("interface", "virtual"), ("channel", f"{request.node.name} {bus}"))
    ]
    return named("can", *changes)


@pytest.fixture
def talker(system):
    """A node's place on the left bus."""
    opened = attach(can_spec(system.deployment, "left"))
    yield opened
    opened.close()


def encoded(encoding, values, status=0, counter=0):
    frame = Frame()
    array = np.array(values, dtype=np.float64)
    native.encode(encoding.message, array.ctypes.data, Header(counter, status), frame)
    return frame


def taken(listener, n):
    """Take n frames; they come through a thread."""
    end, got = monotonic_ns() + 20 * SECOND, 0
    while got < n and monotonic_ns() < end:
        got += listener.receive(monotonic_ns())
        sleep(0.005)
    return got


def test_values_status_and_losses(system, talker):
    carried = system.messages["LINK_2"]
    width, skipped = carried.outlet.width, (5, 6, 11)
    status = LifeState.ACTIVE | Status.DEADMAN | Status.SIMULATED
    with Listener(system) as listener:
        sent = 0
        for k in range(20):
            if k not in skipped:
                values = [k + 0.5 * i for i in range(width)]
                talker.bus.send(encoded(carried.encoding, values, status, k))
                sent += 1
        assert taken(listener, sent) == sent
        heard = listener.heard["LINK_2"]
        assert heard.values.tolist() == [19 + 0.5 * i for i in range(width)]
        assert heard.lost == len(skipped) and len(heard.recent) == sent and not heard.refused
        now = monotonic_ns()
        row = next(r for r in view(listener, now).tables[1].rows if r[0] == "LINK_2")
        assert row[1] == "master_control" and row[7] == "deadman simulated"
        listener.receive(now + 2 * SECOND)
        assert not heard.recent
        assert talker.bus.drain() == []  # nothing was sent to it


def test_a_frame_that_is_broken_is_refused(system, talker):
    carried = system.messages["LINK_2"]
    frame = encoded(carried.encoding, [1.0] * carried.outlet.width)
    frame.data[9] ^= 1
    with Listener(system) as listener:
        talker.bus.send(frame)
        talker.bus.send(Frame.of(0x123, b"abc"))
        assert taken(listener, 2) == 2
        heard = listener.heard["LINK_2"]
        assert heard.refused == {"CRC": 1} and np.isnan(heard.values).all()
        assert listener.unknown == {"left": 1, "right": 0}


def test_heartbeats_tell_the_state_of_a_node(system, talker):
    beats = system.services["left"].heartbeats
    number = system.deployment.nodes["master_control"].number
    with Listener(system) as listener:
        assert "nobody there" in view(listener, monotonic_ns()).line
        talker.bus.send(encoded(beats[number], [LifeState.STOPPING, Why.PEER, 3, 1]))
        assert taken(listener, 1) == 1
        beat = listener.beats["master_control"]
        assert (beat.state, beat.boots, beat.armed) == ("stopping", 3, True)
        assert beat.reasons == (explain(Why.PEER),)
        now = monotonic_ns()
        assert "master_control stopping" in view(listener, now).line
        assert "master_control silent" in view(listener, now + 2 * SECOND).line
        nodes = view(listener, now).tables[0]
        assert [r[2] for r in nodes.rows if r[0] != "master_control"] == ["never"] * 3
        assert len(nodes.marked) == 4


def test_listening_once_from_the_command_line():
    app = typer.Typer()
    app.command()(flat(monitor))
    given = ["--listen", "--scenario", str(TELEOPERATION), "-i", "virtual", "--once"]
    done = CliRunner().invoke(app, given, catch_exceptions=False)
    assert done.exit_code == 0 and "listening on left, right" in done.output
    with pytest.raises(ScenarioError, match="--listen needs --scenario"):
        CliRunner().invoke(app, ["--listen"], catch_exceptions=False)
