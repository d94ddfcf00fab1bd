"""Packets between two hosts through the relay, and its record."""

import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bridge.relay import namespaces
from bridge.relay.namespaces import NetworkError
from bridge.relay.network import RelayNetwork
from cosim.base.clock import sleep

DELAY = {"law": "uniform", "low": "20 ms", "high": "30 ms"}


@contextmanager
def sockets(network: RelayNetwork) -> Iterator[tuple[socket.socket, socket.socket]]:
    made = []
    for host in ("a", "b"):
        with network.on_host(host):
            made.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made[-1].bind((network.addresses[host], 5000))
        made[-1].settimeout(5.0)
    yield made[0], made[1]
    for s in made:
        s.close()


def test_packets_arrive_late_by_what_was_drawn_and_are_recorded(tmp_path: Path):
    with RelayNetwork(["a", "b"], tmp_path / "packets", {"a>b": {"delay": DELAY}}) as network:
        with sockets(network) as (a, b):
            for k in range(50):
                a.sendto(bytes([k]), (network.addresses["b"], 5000))
                sleep(0.001)
            assert [b.recv(10) for _ in range(50)] == [bytes([k]) for k in range(50)]
            b.sendto(b"back", (network.addresses["a"], 5000))
            assert a.recv(10) == b"back"
        there, back = network.of("a>b"), network.of("b>a")
        assert (len(there), len(back), set(there["length"])) == (50, 1, {29})
        assert there["delay_ns"].min() >= 20e6 and there["delay_ns"].max() <= 30e6
        assert (there["left_ns"] >= there["t_ns"] + there["delay_ns"]).all()
        assert (np.diff(there["left_ns"]) >= 0).all()
        assert back["delay_ns"].tolist() == [0]
        del there, back


def test_a_partition_and_its_end(tmp_path: Path):
    with RelayNetwork(["a", "b"], tmp_path / "packets") as network, sockets(network) as (a, b):
        where = (network.addresses["b"], 5000)
        a.sendto(b"1", where)
        assert b.recv(10) == b"1"
        network.set("*", down=True)
        sleep(0.1)
        a.sendto(b"2", where)
        sleep(0.1)
        network.set("*")
        sleep(0.1)
        a.sendto(b"3", where)
        assert b.recv(10) == b"3"
        assert network.of("a>b")["left_ns"].tolist()[1] == -1


def test_hosts_are_gone_afterwards_and_see_nothing_else(tmp_path: Path):
    with RelayNetwork(["a", "b"], tmp_path / "packets") as network:
        links = namespaces.ip("-n", network.namespaces["a"], "-o", "link")
        assert len(links.splitlines()) == 2  # its own loopback, and the way to the router
        with network.on_host("a"):
            found = subprocess.run(["ip", "-o", "link"], capture_output=True, text=True, check=True)
        assert found.stdout.split() == links.split()
    assert not any(name in namespaces.ip("netns", "list") for name in network.namespaces.values())


def test_what_is_wrong_is_said_and_nothing_is_left(tmp_path: Path):
    network = RelayNetwork(["a"], tmp_path / "packets", {"a>b": {}})
    with pytest.raises(NetworkError, match=r"did not start: no link 'a>b'"), network:
        pass
    assert network.namespaces["a"] not in namespaces.ip("netns", "list")
