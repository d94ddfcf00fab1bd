"""Queries and commands to a running node over Zenoh."""

import ctypes as c
import threading
from functools import partial
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.deployment.zenoh_keys import Names
from bridge.native import node as native
from bridge.native.safety import LifeState
from bridge.node.buses import answer, open_buses
from bridge.node.run import Control
from bridge.records.node_lives import Life
from bridge.wiring.wiring import WiredNode
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.remote_control import ask, command
from bridge.zenoh.session import configure, open_session
from cosim.base.clock import monotonic_ns
from cosim.base.errors import RunError
from tests.bridge.zenoh.rehearsed import CONFIGS, sockets
from tests.bridge.zenoh.test_channel import until

NAMES = Names("teleoperation")
PATIENCE = 30.0  # s


@pytest.fixture
def client(tmp_path: Path):
    options = ZenohOptions("test", connect=(f"unixsock-stream/{tmp_path}/master",))
    session = open_session(configure(options, "operator"), "net")
    yield session
    session.close()


def test_a_node_is_asked_and_told(tmp_path: Path, request: pytest.FixtureRequest):
    changes = [
        "deploy.buses.net.options.wait=0",
        "deploy.silence=0",
        "deploy.nodes.master.overrun='5 s'",  # machines stand still now and then
        *sockets(["master"], tmp_path),
    ]
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh", changes)
    with open_buses(system, Life("master"), tmp_path) as ends:
        buses = {name: end.bus for name, end in ends.items()}
        wired = WiredNode(system, "master", buses, tmp_path / "master.journal", native.WALL)
        with wired:
            control = Control(wired.struct)
            answer(wired, ends, control)
            client = request.getfixturevalue("client")
            until(lambda: client.info.peers_zid())
            asked(client, wired, control)


def asked(client, wired: WiredNode, control: Control) -> None:
    ran = threading.Thread(target=native.functions().node_live, args=(c.byref(wired.struct),))
    ran.start()
    say = partial(ask, client, NAMES, "master", seconds=PATIENCE)
    assert say("state")["armed"] is False
    say("arm")
    until(lambda: say("state")["armed"])
    control.start(monotonic_ns())
    until(lambda: say("state")["slot"] > 10)
    found = say("state")
    assert (found["state"], found["reasons"], found["peers"]) == ("active", "", [])
    known = say("parameters")
    assert known["messages"]["xi_master"]["signals"] == [f"master_control.xi[{i}]" for i in (0, 1)]
    assert known["components"]["master_control"]["parameters"]["lambda_M"] == 10.0
    say("stop")
    ran.join(PATIENCE)
    assert not ran.is_alive()
    assert wired.struct.life.state == LifeState.INACTIVE


def test_nobody_answers(tmp_path: Path):
    session = open_session(configure(ZenohOptions("test"), "operator"), "net")
    with pytest.raises(RunError, match="no answer to teleoperation/master/state"):
        ask(session, NAMES, "master", "state", 0.2)
    with pytest.raises(RunError, match="a node is asked for one of state, parameters, clock, arm"):
        ask(session, NAMES, "master", "jump")
    session.close()


def test_all_nodes_are_started_over_the_bus(tmp_path: Path, request: pytest.FixtureRequest):
    changes = [
        "deploy.buses.net.options.wait=0",
        "deploy.silence=0",
        "deploy.nodes.master.overrun='5 s'",  # machines stand still now and then
        *sockets(["master"], tmp_path),
    ]
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh", changes)
    nmt = system.services["net"].nmt
    assert nmt is not None
    with open_buses(system, Life("master"), tmp_path) as ends:
        buses = {name: end.bus for name, end in ends.items()}
        with WiredNode(system, "master", buses, tmp_path / "master.journal", native.WALL) as wired:
            ran = threading.Thread(
                target=native.functions().node_live, args=(c.byref(wired.struct),)
            )
            ran.start()
            client = request.getfixturevalue("client")
            command(client, NAMES, nmt, "start", 2)  # another's number
            command(client, NAMES, nmt, "start")
            until(lambda: wired.struct.slot > 10)
            assert wired.struct.life.state == LifeState.ACTIVE
            command(client, NAMES, nmt, "stop")
            ran.join(PATIENCE)
            assert not ran.is_alive()


def test_a_command_that_is_none_and_one_that_nobody_hears():
    nmt = load_system(CONFIGS / "teleoperation.toml", "zenoh").services["net"].nmt
    session = open_session(configure(ZenohOptions("test"), "operator"), "net")
    assert nmt is not None
    with pytest.raises(RunError, match="'go' is not a command; expected one of start, stop, arm"):
        command(session, NAMES, nmt, "go")
    with pytest.raises(RunError, match="no node listens to teleoperation/nmt"):
        command(session, NAMES, nmt, "start")
    session.close()
