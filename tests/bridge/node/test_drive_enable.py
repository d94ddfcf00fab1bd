"""Foreign drives are enabled once their watchdog reads back, and disabled at the end."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from bridge.deployment.system import System, load_system
from bridge.drives.profiles import SHORTEST
from bridge.node.drive_enable import enabled, foreign_drives
from cosim.base.errors import RunError, ScenarioError
from tests.bridge.bench import until

ROOT = Path(__file__).parents[3]
CONTROLLERS = ("master_control", "slave_control")
ENABLE, DISABLE = bytes.fromhex("FFFFFFFFFFFFFFFC"), bytes.fromhex("FFFFFFFFFFFFFFFD")


@pytest.fixture(scope="module")
def system() -> System:
    settings = ["run.stop=1"]
    for bus in ("left", "right", "link"):
        settings += [f'deploy.buses.{bus}.interface="virtual"']
        settings += [f'deploy.buses.{bus}.channel="enabling-{bus}"']
    scenario = ROOT / "configs/teleoperation.toml"
    return load_system(scenario, "can-damiao", settings)


class Motors:
    """Everything said on a bus, and two motors that keep a register and answer for it."""

    def __init__(self, channel: str, off: bool) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.off, self.registers = off, dict[int, bytes]()
        self.seen: list[tuple[int, bytes]] = []
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        while not self.ended.is_set():
            message = self.bus.recv(0.02)
            if message is None:
                continue
            self.seen.append((message.arbitration_id, bytes(message.data)))
            if message.arbitration_id != 0x7FF:
                continue
            node, what = message.data[0], message.data[2]
            if what == 0x55:
                self.registers[node] = bytes(4) if self.off else bytes(message.data[4:])
            elif node in self.registers:
                data = bytes([node, 0, 0x33, 9]) + self.registers[node]
                answer = can.Message(0, 0x10 + node, is_extended_id=False, data=data)
                self.bus.send(answer)

    def close(self) -> None:
        self.ended.set()
        self.thread.join()
        self.bus.shutdown()


@contextmanager
def motors(off: bool = False) -> Iterator[dict[str, Motors]]:
    found = {bus: Motors(f"enabling-{bus}", off) for bus in ("left", "right")}
    try:
        yield found
    finally:
        for one in found.values():
            one.close()


def said(motor: Motors, data: bytes) -> list[int]:
    return [identifier for identifier, found in motor.seen if found == data]


def test_drives_of_the_nodes_started_here_and_no_others(system: System) -> None:
    both = foreign_drives(system, CONTROLLERS)
    assert sorted((d.bus, d.node) for d in both) == [
        (b, n) for b in ("left", "right") for n in (1, 2)
    ]
    assert {d.bus for d in foreign_drives(system, CONTROLLERS[:1])} == {"left"}
    assert foreign_drives(system, ("master", "slave")) == ()
    assert all(d.profile.timeout == SHORTEST for d in both)


def test_enabled_between_and_disabled_after(system: System) -> None:
    with motors() as there:
        with enabled(system, CONTROLLERS) as drives:
            assert len(drives) == 4
            until(lambda: all(len(said(m, ENABLE)) >= 2 for m in there.values()))
            assert all(said(m, ENABLE) == [1, 2] and not said(m, DISABLE) for m in there.values())
            written = [data for i, data in there["left"].seen if i == 0x7FF and data[2] == 0x55]
            assert [int.from_bytes(d[4:], "little") * 50e-6 for d in written] == [SHORTEST] * 2
        until(lambda: all(len(said(m, DISABLE)) >= 2 for m in there.values()))
        assert all(sorted(said(m, DISABLE)) == [1, 2] for m in there.values())


def test_disabled_also_after_an_error(system: System) -> None:
    with motors() as there:
        with pytest.raises(ZeroDivisionError), enabled(system, CONTROLLERS):
            raise ZeroDivisionError
        until(lambda: all(len(said(m, DISABLE)) >= 2 for m in there.values()))
        assert all(sorted(said(m, DISABLE)) == [1, 2] for m in there.values())


def test_a_watchdog_that_is_off_is_refused(system: System) -> None:
    with motors(off=True) as there:
        with pytest.raises(ScenarioError, match="reads 0, off"), enabled(system, CONTROLLERS):
            pass
        assert not any(said(m, ENABLE) for m in there.values())


def test_a_drive_that_is_not_there_is_an_error(system: System) -> None:
    with (
        pytest.raises(RunError, match="did not answer with its TIMEOUT"),
        enabled(system, CONTROLLERS),
    ):
        pass
