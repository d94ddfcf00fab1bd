"""A host without loopback or multicast is reported before anything starts."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.preflight import host
from bridge.rehearsal.hosts import Hosts
from bridge.relay import namespaces
from cosim.base.errors import ScenarioError
from cosim.base.interrupts import signals_as_interrupt
from tests.tiers import first_fast

SCENARIO = Path("configs/teleoperation.toml").resolve()
ROOT = SCENARIO.parents[1]
_NUMBER = count()


def test_this_host_has_both() -> None:
    host.loopback()
    host.multicast()


def test_what_is_missing_is_said_with_the_bus_that_needs_it(monkeypatch) -> None:
    def refused(*_: object) -> socket.socket:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(socket, "create_connection", refused)
    system = load_system(SCENARIO, "zenoh")
    with pytest.raises(ScenarioError) as caught:
        host.check(system)
    assert str(caught.value).startswith(str(system.deployment.path))
    assert "buses" in str(caught.value)
    assert "no connection to 127.0.0.1 (Network is unreachable)" in str(caught.value)
    assert "expected the network interface lo up" in str(caught.value)


def test_only_what_a_deployment_needs_is_asked_for(monkeypatch) -> None:
    def never() -> None:
        raise AssertionError

    monkeypatch.setattr(host, "loopback", never)
    monkeypatch.setattr(host, "multicast", never)
    host.check(load_system(SCENARIO, "can"))  # SocketCAN


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="namespaces need root")
@pytest.mark.parametrize("arguments", first_fast([["-i", "udp_multicast"], ["--deploy", "zenoh"]]))
def test_a_rehearsal_where_nothing_is_up_starts_no_node(tmp_path: Path, arguments) -> None:
    name = f"{namespaces.PREFIX}{os.getpid()}-reach{next(_NUMBER)}"
    try:
        namespaces.ip("netns", "add", name)
    except namespaces.NetworkError as error:
        pytest.skip(str(error))
    try:
        found = subprocess.run(
            ["ip", "netns", "exec", name, sys.executable, "-c",
             "from cosim.cli import main; main()", "rehearse", str(SCENARIO), *arguments,
             "--out", str(tmp_path / "run")],
            capture_output=True, text=True, cwd=ROOT, check=False,
        )  # fmt: skip
    finally:
        namespaces.delete(name)
    assert found.returncode == 2, found.stderr
    assert "this host does not support it: " in found.stderr
    assert "Traceback" not in found.stderr
    assert not (tmp_path / "run").exists()


def test_a_signal_while_hosts_are_made_leaves_no_namespace(tmp_path, monkeypatch) -> None:
    made: list[str] = []

    def add(name: str) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        made.append(name)

    monkeypatch.setattr(namespaces, "add", add)
    monkeypatch.setattr(namespaces, "delete", made.remove)
    monkeypatch.setattr(namespaces, "multicast", lambda name: None)
    hosts = Hosts({"a": ["a"]}, tmp_path / "packets")
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        hosts.__enter__()
    assert made == []


def test_a_signal_while_hosts_are_removed_removes_them_all(tmp_path, monkeypatch) -> None:
    made: list[str] = []

    def delete(name: str) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        made.remove(name)

    monkeypatch.setattr(namespaces, "add", made.append)
    monkeypatch.setattr(namespaces, "delete", delete)
    monkeypatch.setattr(namespaces, "multicast", lambda name: None)
    with (
        pytest.raises(KeyboardInterrupt),
        signals_as_interrupt(),
        Hosts({"a": ["a"]}, tmp_path / "packets"),
    ):
        assert made
    assert made == []
