"""Nodes on hosts of a file: the result is the twin's; who is missing is named; nothing is left."""

from __future__ import annotations

import json
import os
import signal
import socket
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bridge.deployment.system import load_system
from bridge.node.checkpoints import PART
from bridge.rehearsal import host_file
from bridge.rehearsal.agent import Agent
from bridge.rehearsal.host_connection import HostConnection
from bridge.rehearsal.host_task import HostTask
from bridge.rehearsal.remote import RemoteHosts, on_hosts
from bridge.rehearsal.router_config import client_config, router_config
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import NODES, Rehearsal
from bridge.replay import replay, twin
from cosim.base.errors import RunError, ScenarioError
from tests.bridge.deployments import CONFIGS

SCENARIO, DEPLOYMENT = CONFIGS / "many.toml", CONFIGS / "deploy/many.toml"


def robots(n: int, stop: float) -> tuple[str, ...]:
    return (
        f"graphs.net.n={n}", f"deploy.nodes.node.count={n}", f"deploy.messages.xi.count={n}",
        f"run.stop={stop}",
    )  # fmt: skip


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def two_local(folder: Path) -> Path:
    """A file with two hosts that are this one, each with a router."""
    path = folder / "hosts.toml"
    ports = free_port(), free_port()
    path.write_text("".join(f"[hosts.h{i}]\nport = {port}\n" for i, port in enumerate(ports)))
    return path


def started(file: Path, folder: Path, changes: tuple[str, ...]) -> tuple[Rehearsal, RemoteHosts]:
    system = load_system(SCENARIO, str(DEPLOYMENT), changes)
    hosts, _ = on_hosts(system, host_file.load(file), changes, folder)
    settings = Settings(SCENARIO, DEPLOYMENT, changes, warm_up=0.0, starter=hosts)
    return Rehearsal(system, settings, folder), hosts


def is_the_twin(changes: tuple[str, ...], folder: Path) -> None:
    (folder / "alone").mkdir()
    twin.simulate(load_system(SCENARIO, str(DEPLOYMENT), changes), folder / "alone")
    expected, found = replay.load(folder / "alone"), replay.load(folder / NODES)
    assert set(expected) == set(found)
    for node, rows in expected.items():
        assert rows.tobytes() == found[node].tobytes(), node


def test_nodes_on_two_hosts_are_the_twin(tmp_path: Path) -> None:
    changes = robots(6, 0.3)
    running, hosts = started(two_local(tmp_path), tmp_path / "run", changes)
    with running:
        assert running.run().notes == []
    is_the_twin(changes, tmp_path / "run")
    facts = hosts.facts()
    assert sorted(len(host["nodes"]) for host in facts.values()) == [3, 3]
    assert len({host["identity"] for host in facts.values()}) == 1  # one machine


@pytest.mark.parametrize("what", ["node", "router", "host"])
def test_who_is_killed_at_the_start_is_named(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    running, hosts = started(two_local(tmp_path), tmp_path / "run", robots(6, 100.0))
    ready = running._all_ready

    def kill() -> None:
        import os
        import signal

        connection = hosts.connections["h1"]
        match what:
            case "node":
                running.kill("node2")
            case "router":
                os.kill(connection.router, signal.SIGKILL)
            case "host":
                os.kill(connection.pid, signal.SIGKILL)
        ready()
        running._watch(lambda t, end: None)

    monkeypatch.setattr(running, "_all_ready", kill)
    named = {
        "node": "node node2: killed by SIGKILL on host h",
        "router": "host h1: its Zenoh router has ended: killed by SIGKILL",
        "host": r"host h1: the connection has ended \(killed by SIGKILL",
    }
    with pytest.raises(RunError, match=named[what]), running:
        running.run()


def test_a_host_that_is_frozen_in_the_run_is_named_and_ends_it(tmp_path: Path) -> None:
    file = two_local(tmp_path)
    file.write_text(f'silence = "2 s"\n{file.read_text()}')
    running, hosts = started(file, tmp_path / "run", robots(6, 3000.0))
    announce = running._announce

    def freeze() -> None:
        announce()
        os.kill(hosts.connections["h1"].pid, signal.SIGSTOP)

    running._announce = freeze  # type: ignore[method-assign]
    with running:
        notes = [str(note.describe()) for note in running.run().notes]
    (said,) = (text for text in notes if "has ended" in text)
    assert "host h1: nothing came from it for 2 s (silence)" in said
    assert {str(life.start.life) for life in running.ended.lives if life.done} >= {
        node for node in hosts.facts()["h0"]["nodes"]
    }


def connected(**routers: str) -> RemoteHosts:
    """Hosts by name with those that their routers are connected to, as letters."""
    hosts = object.__new__(RemoteHosts)
    hosts.connections = {}
    for name, others in routers.items():
        found = hosts.connections[name] = object.__new__(HostConnection)
        found.name, found.failed, found.watch = name, "", None
        found._lost, found.routers = set(), frozenset()
        found._heard_of_routers(name, frozenset(others))
    return hosts


@pytest.mark.parametrize(
    ("routers", "host", "others"),
    [
        ({"a": "b", "b": "a", "c": ""}, "c", "a, b"),
        ({"a": "", "b": "c", "c": "b"}, "a", "b, c"),
        ({"a": "bc", "b": "ac", "c": "a"}, "c", "b"),  # one end has not noticed
        ({"a": "", "b": ""}, "b", "a"),
    ],
)
def test_the_host_that_is_cut_off_is_the_one_with_the_fewest_connections(
    routers: dict[str, str], host: str, others: str
) -> None:
    assert connected(**routers)._cut_off() == (host, others)


def test_a_connection_that_was_lost_in_the_run_stays_lost() -> None:
    """Before it, routers may connect as often as they like."""
    hosts = connected(a="b", b="a")
    a = hosts.connections["a"]
    a._heard_of_routers("a", frozenset())
    assert hosts._unconnected() == [("a", "b")]
    a._heard_of_routers("a", frozenset("b"))
    assert hosts._unconnected() == []
    a.watch = lambda: None
    a._heard_of_routers("a", frozenset())
    a._heard_of_routers("a", frozenset("b"))
    assert hosts._unconnected() == [("a", "b")]


def test_hosts_that_have_failed_are_not_missed() -> None:
    hosts = connected(a="b", b="a", c="")
    hosts.connections["c"].failed = "the connection has ended"
    assert hosts._unconnected() == []


def test_files_come_over_a_connection_and_rows_that_were_not_written_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, here = tmp_path / "there", tmp_path / "here"
    agent = Agent(HostTask("", "", (), "", (), (), "", (), 10.0, "a", 0), there)
    agent.nodes.mkdir(parents=True)
    here.mkdir()
    rows, unwritten = os.urandom(PART + 1000), bytes(3 * PART + 7)
    files = {"empty": b"", "whole": rows, "killed": rows + unwritten, "none": unwritten,
             "gap": rows + unwritten + rows}  # fmt: skip
    for name, content in files.items():
        (agent.nodes / name).write_bytes(content)
    lines: list[dict[str, Any]] = []
    monkeypatch.setattr(agent, "say", lambda kind, **facts: lines.append({"kind": kind, **facts}))
    agent._collect()
    connection = object.__new__(HostConnection)
    connection._folder, connection._collected = here, {}
    for line in lines:
        connection._heard(line)
    assert connection.collected
    assert {path.name: path.read_bytes() for path in here.iterdir()} == files
    assert len(json.dumps(lines)) < 4 * 1.4 * len(rows)


@pytest.mark.parametrize("silence", [2.0, 10.0, 60.0])
def test_no_layer_gives_a_connection_up_before_silence(silence: float, tmp_path: Path) -> None:
    """Neither ssh nor Zenoh, also for samples that wait for the network."""
    path = tmp_path / "hosts.toml"
    text = f'silence = "{silence} s"\ninsecure = true\n[hosts.a]\naddress = "192.0.2.1"\n'
    path.write_text(f'{text}[hosts.b]\nstart = "ssh"\nto = "192.0.2.2"\n')
    words = host_file.Site(host_file.load(path), tmp_path / "packets").call("b").words
    options = dict(word.split("=") for word in words if word.startswith("ServerAlive"))
    assert int(options["ServerAliveInterval"]) * int(options["ServerAliveCountMax"]) > silence
    at = "transport/link/tx"
    for config in (client_config(silence), router_config(silence, tls=False)):
        read = zenoh.Config.from_json5(json.dumps(config))
        wait = read.get_json(f"{at}/queue/congestion_control/block/wait_before_close")
        assert int(wait) >= silence * 1e6
        assert int(read.get_json(f"{at}/lease")) >= silence * 1e3
    assert int(read.get_json(f"{at}/lease")) == silence * 1e3  # routers notice it then


BAD: list[tuple[str, str]] = [
    ("", r"no \[hosts.NAME\] table"),
    ("latency = 1\n", r"no \[hosts.NAME\] table"),
    ('speed = 1\n[hosts.a]\n', "unknown key 'speed'; expected one of hosts, latency"),
    ('[hosts.a]\nstart = "ssh"\n', "hosts.a: ssh without `to`"),
    ('[hosts.a]\nstart = "rsh"\n', "hosts.a.start"),
    ('[hosts.a]\nfolder = "/x"\n', "hosts.a.folder: found folder with local"),
    ('[hosts.a]\n[hosts.b]\n', "hosts.b.port: found the address and the port of a"),
    ('[hosts.a]\n[hosts.b]\nstart = "ssh"\nto = "192.0.2.1"\n',
     "hosts.a.address: 127.0.0.1 is not reached from b"),
    ('[hosts.a]\naddress="192.0.2.2"\n[hosts.b]\nstart = "ssh"\nto = "192.0.2.1"\n',
     r"expected certificates \(keys = FOLDER\)"),
    ('keys = "keys"\n[hosts.a]\nstart = "namespace"\n', "found certificates, and routers without"),
    ('keys = "keys"\ninsecure = true\n[hosts.a]\n', "found certificates, and routers without"),
    ('silence = "1 s"\n[hosts.a]\n', "silence: found 1 s, expected at least 2 s"),
    ('[hosts.a]\nstart = "namespace"\n[hosts.b]\n', "hosts.b: found local"),
    ('[hosts.a]\nstart = "namespace"\nto = "nowhere"\n',
     "hosts.a.to: no network namespace 'nowhere'"),
    ('[hosts.a]\nnodes = ["robot9"]\n', "hosts.a.nodes: no node 'robot9'; there are: node1"),
    ('[hosts.a]\nnodes = ["node1"]\n[hosts.b]\nport = 1\nnodes = ["node1"]\n',
     "node1 is on a already"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "sentence"), BAD)
def test_what_is_wrong_in_a_file_is_said_with_its_place(
    text: str, sentence: str, tmp_path: Path
) -> None:
    path = tmp_path / "hosts.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=sentence):
        host_file.fixed(host_file.load(path), ("node1", "node2"))
