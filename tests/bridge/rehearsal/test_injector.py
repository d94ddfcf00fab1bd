"""What a fault script does to the interfaces of a rehearsal's buses."""

from __future__ import annotations

import subprocess
from contextlib import ExitStack
from types import SimpleNamespace

import pytest

from bridge.deployment.system import load_system
from bridge.rehearsal import injector
from cosim.base.errors import RunError
from tests.bridge.faulty import SCENARIO, script

DOWN = {"kind": "bus-down", "bus": "right", "at": 1.0, "for": 0.3}


@pytest.fixture
def interface(monkeypatch):
    """What `ip link set` was asked for, and how it ends."""
    asked, ends = [], SimpleNamespace(code=0)

    def run(words, **_):
        asked.append(words[-2:])
        return SimpleNamespace(returncode=ends.code, stderr="Operation not permitted")

    monkeypatch.setattr(subprocess, "run", run)
    return SimpleNamespace(asked=asked, ends=ends)


@pytest.fixture(scope="module")
def system():
    return load_system(SCENARIO, "can", [])


def test_a_bus_that_was_set_down_is_up_again_when_the_rehearsal_is_left(system, interface):
    down, up = injector.events(script(DOWN), system)
    assert (down.sets_interface, up.sets_interface) == (True, True)
    channel = system.deployment.buses["right"].channel
    with ExitStack() as rehearsal:
        down.action(SimpleNamespace(closing=rehearsal.callback))
        assert interface.asked == [[channel, "down"]]  # the run ends before the script sets it up
    assert interface.asked == [[channel, "down"], [channel, "up"]]


def test_an_interface_that_cannot_be_set_is_an_error_with_its_reason(system, interface):
    down, _ = injector.events(script(DOWN), system)
    interface.ends.code = 2
    with pytest.raises(RunError, match="down: Operation not permitted"):
        down.action(SimpleNamespace(closing=lambda do: None))
