"""Networks of a test: its hosts, its laws, its recorded delays."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from bridge.relay import namespaces
from bridge.testing.case import PytestCase
from bridge.testing.networks import HostNetworks
from cosim.base.clock import sleep
from tests.network.test_relay import sockets

pytest_plugins = ["pytester"]


def case(folder: Path, name: str = "t.py::test_x") -> PytestCase:
    return PytestCase(name, folder, folder / "t.py", folder / "cosim")


def delays(network, packets: int = 3) -> list[int]:
    """Delays, ns, of packets from a to b, which have all arrived."""
    with sockets(network) as (a, b):
        for k in range(packets):
            a.sendto(bytes([k]), (network.addresses["b"], 5000))
            assert b.recv(10) == bytes([k])
            sleep(0.001)
    return [int(x) for x in network.of("a>b")["delay_ns"]]


def test_a_recorded_delay_lies_next_to_the_test(tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text("t_send,delay\n0,0.004\n100,0.004\n")
    trace = {"law": "trace", "file": "measured.csv"}
    with ExitStack() as closing:
        network = HostNetworks(case(tmp_path), closing)(["a", "b"], {"a>b": {"delay": trace}})
        assert delays(network) == [4_000_000] * 3
        made = list(network.namespaces.values())
        assert all(name in namespaces.ip("netns", "list") for name in made)
    assert not any(name in namespaces.ip("netns", "list") for name in made)


def test_a_failing_test_leaves_no_hosts(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_fails(network):
            net = network(["a", "b"], {"*": {"delay": {"law": "constant", "delay": "5 ms"}}})
            assert net.names == [], " ".join(net.namespaces.values())
        """
    )
    result = pytester.runpytest("-p", "no:cacheprovider")
    result.assert_outcomes(failed=1)
    (line,) = [x for x in result.stdout.lines if x.startswith("E   ") and "cosim-" in x]
    names = line.split(":", 1)[1].split()
    there = namespaces.ip("netns", "list")
    assert len(names) == 2 and not any(name in there for name in names)


def test_delays_are_drawn_from_the_name_of_the_test(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds = []

    def seen(network, hosts, record, links, seed) -> None:
        seeds.append(seed)

    monkeypatch.setattr("bridge.relay.network.RelayNetwork.__init__", seen)
    monkeypatch.setattr("bridge.relay.network.RelayNetwork.__enter__", lambda network: network)
    monkeypatch.setattr("bridge.relay.network.RelayNetwork.__exit__", lambda *_: None)
    for name in ("t.py::test_x", "t.py::test_x", "t.py::test_y"):
        with ExitStack() as closing:
            HostNetworks(case(tmp_path, name), closing)(["a", "b"])
    assert seeds[0] == seeds[1] != seeds[2]
    assert np.all(np.array(seeds) >= 0)
