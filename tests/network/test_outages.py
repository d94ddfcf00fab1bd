"""A cable that is out for half a second to half a minute: both ends hear again, by any transport.

A switch stands between the hosts, so only one of them notices. The lengths of a transport run side
by side; the ends are processes, of which each says at the end what it heard since.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from bridge.native.frame import Frame
from bridge.relay import namespaces
from bridge.relay.namespaces import ip
from bridge.zenoh.access import access_control
from bridge.zenoh.certificates import make_keys
from bridge.zenoh.channel import ZenohAttachment
from bridge.zenoh.options import ZenohOptions
from cosim.base.clock import sleep, stopwatch
from tests.bridge.zenoh.ends import IDENTIFIERS, NAMES, traffic
from tests.bridge.zenoh.rehearsed import CONFIGS

HOSTS = {"a": "192.0.2.1", "b": "192.0.2.2"}
LENGTHS = (0.5, 3.5, 8.0, 30.0)  # s
#: s after which both ends must hear again, and of them hearing each other before and after.
PATIENCE, CALM = 20.0, 1.0
BOTH = ("tcp/{}:7461?rel=1", "udp/{}:7461?rel=0")
TRANSPORTS = {
    "lan": (BOTH, "lan.json5"),
    "wide": (BOTH, "wide.json5"),
    "tcp": (("tcp/{}:7461",), ""),
    "udp": (("udp/{}:7461",), ""),
    "tls": (("tls/{}:7461",), "secure.json5"),
    "quic": (("quic/{}:7461",), "secure.json5"),
}
_NUMBER = count()
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@dataclass(frozen=True)
class Cable:
    """Two hosts and a switch, each a namespace."""

    hosts: dict[str, str]

    def set(self, state: str) -> None:
        ip("-n", self.hosts["b"], "link", "set", "cable", state)


@contextmanager
def cabled() -> Iterator[Cable]:
    unique = f"{namespaces.PREFIX}{os.getpid()}-{next(_NUMBER)}"
    hosts, switch = {host: f"{unique}-{host}" for host in HOSTS}, f"{unique}-switch"
    with ExitStack() as made:
        for name in (*hosts.values(), switch):
            namespaces.add(name)
            made.callback(namespaces.delete, name)
        ip("-n", switch, "link", "add", "bridge", "type", "bridge")
        ip("-n", switch, "link", "set", "bridge", "up")
        for host, name in hosts.items():
            port = f"port-{host}"
            to = ("peer", "name", port, "netns", switch)
            ip("link", "add", "cable", "netns", name, "type", "veth", *to)
            ip("-n", name, "addr", "add", f"{HOSTS[host]}/24", "dev", "cable")
            ip("-n", name, "link", "set", "cable", "up")
            ip("-n", switch, "link", "set", port, "master", "bridge", "up")
        yield Cable(hosts)


def talk(node: str, transport: str, keys: str) -> None:
    """Process of an end: it says every 20 ms something, and each line it reads is answered."""
    endpoints, config = TRANSPORTS[transport]
    listen = tuple(e.format(HOSTS[node]) for e in endpoints)
    connect = tuple(e.format(HOSTS["a"]) for e in endpoints) if node == "b" else ()
    file = CONFIGS / "zenoh" / config if config else None
    options = ZenohOptions(
        "test", listen=listen, connect=connect, config=file, keys=Path(keys), insecure=True
    )
    other = "b" if node == "a" else "a"
    allowed = access_control(NAMES, tuple(HOSTS))
    end = ZenohAttachment("net", NAMES, traffic(node, other), options, access=allowed)
    end.wait_for_peers()
    heard = 0
    while True:
        for identifier in IDENTIFIERS:
            end.bus.send(Frame.of(identifier, bytes(8)))
        sleep(0.02)
        heard += len(end.bus.drain())
        if select.select([sys.stdin], [], [], 0.0)[0]:
            sys.stdin.readline()
            restarts = end.health(0).restarts
            print(json.dumps({"heard": heard, "restarts": restarts}), flush=True)


class End:
    """One end, as its process."""

    def __init__(self, cable: Cable, node: str, transport: str, keys: Path) -> None:
        program = (
            f"from tests.network.test_outages import talk; talk(*{(node, transport, str(keys))})"
        )
        with namespaces.in_namespace(cable.hosts[node]):
            self.process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )  # fmt: skip

    def ask(self) -> dict[str, Any]:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        said: dict[str, Any] = json.loads(self.process.stdout.readline())
        return said

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


def hear_each_other(ends: Sequence[End]) -> list[bool]:
    """Whether each end hears something within `PATIENCE`."""
    before = [end.ask()["heard"] for end in ends]
    elapsed = stopwatch()
    while True:
        sleep(CALM)
        found = [end.ask()["heard"] > old for end, old in zip(ends, before, strict=True)]
        if all(found) or elapsed() > PATIENCE:
            return found


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_both_ends_hear_each_other_again_after_an_outage(transport, tmp_path):
    make_keys(tmp_path, tuple(HOSTS), tuple(HOSTS.values()))
    with ExitStack() as made:
        cables = {length: made.enter_context(cabled()) for length in LENGTHS}
        ends: dict[float, list[End]] = {}
        for length, cable in cables.items():
            ends[length] = [End(cable, node, transport, tmp_path) for node in HOSTS]
            for end in ends[length]:
                made.callback(end.close)
        for pair in ends.values():
            assert all(hear_each_other(pair))
        for cable in cables.values():
            cable.set("down")
        elapsed, deaf = stopwatch(), {}
        for length, cable in cables.items():
            sleep(max(0.0, length - elapsed()))
            cable.set("up")
        for length, pair in ends.items():
            if not all(found := hear_each_other(pair)):
                deaf[length] = (found, [end.ask() for end in pair])
        assert not deaf
