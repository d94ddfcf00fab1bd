"""Needs a kernel with CAN: ``python -m bridge.vcan run --mem 2G -- python -m pytest tests/vcan``.

A run that does not name this folder leaves it out; ``tests/bridge/vcan/test_vcan_launcher.py``
(slow) runs all of it on such a kernel, and asserts that nothing was skipped.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

from tests.vcan.peers import call

HERE = Path(__file__).resolve().parent
COMMAND = "python -m bridge.vcan run --mem 2G -- python -m pytest tests/vcan"
_NUMBERS = count()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave these tests out unless somebody asks for them, and then run them or fail."""
    start = config.invocation_params.dir
    asked = [(start / argument.partition("::")[0]).resolve() for argument in config.args]
    if not any(path.is_relative_to(HERE) for path in asked):
        return True
    if "vcan0" not in (name for _, name in socket.if_nameindex()):
        raise pytest.UsageError(f"no vcan0 here; {COMMAND}")
    return None


def _up(buses: tuple[str, ...]) -> None:
    lines = (f"link set {bus} down\nlink set {bus} mtu 72 up\n" for bus in buses)
    call("ip", "-batch", "-", text="".join(lines))


@pytest.fixture
def vcan() -> Iterator[tuple[str, str]]:
    """Two buses, vcan0 and vcan1: up, for CAN FD, without queueing discipline or gateway rules."""
    buses = ("vcan0", "vcan1")
    _up(buses)
    yield buses
    call("cangw", "-F", check=False)
    lines = "".join(f"qdisc del dev {bus} root\n" for bus in buses)
    call("tc", "-force", "-batch", "-", check=False, text=lines)
    _up(buses)


@pytest.fixture
def fresh_bus() -> Iterator[str]:
    """A bus that nobody has seen before."""
    bus = f"vcan{100 + next(_NUMBERS)}"
    call("ip", "link", "add", "dev", bus, "type", "vcan")
    call("ip", "link", "set", bus, "mtu", "72", "up")
    yield bus
    call("ip", "link", "del", "dev", bus, check=False)
