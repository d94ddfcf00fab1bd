"""The emulated drive of our own protocol, as strict as those of vendors."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.drives.model import DriveSpec
from bridge.native import node as native
from bridge.native.frame import Flags
from bridge.native.safety import Command, DriveRequest, DriveState, LifeState
from tests.bridge.deployments import named
from tests.bridge.heard_alone import alone, torque

H, MS = 1e-3, 1_000_000
TORQUE = [3.0, 2.0, 0.0, 0.0]


def tell(node, *commands):
    for command in commands:
        native.functions().node_tell(c.byref(node.wired.struct), command)


def test_a_torque_from_before_it_was_enabled_does_not_act(tmp_path):
    """Its controller is gone; the drive is cleared and enabled again, and waits for a new one."""
    with alone(named("can", "run.stop=2"), "master", tmp_path) as node:
        for k in range(40):
            node.say("LINK_2", k, TORQUE)
        node.run(0.5)  # the watchdog has 100 ms
        (drive,) = node.wired.drives
        assert drive.state is DriveState.FAULT
        tell(node, Command.RESET, Command.ARM, Command.START)
        rows = node.run(0.55)
        assert rows["state"][-1] == LifeState.ACTIVE and drive.state is DriveState.ENABLED
        assert not torque(rows, node)[501:].any()
        node.say("LINK_2", 112, TORQUE)
        assert torque(node.run(0.6), node)[-1].tolist() == TORQUE[:2]


def test_a_torque_that_comes_while_it_is_off_does_not_act_later(tmp_path):
    with alone(named("can", "run.stop=2"), "master", tmp_path) as node:
        for k in range(40):
            node.say("LINK_2", k, TORQUE)
        node.run(0.5)
        node.say("LINK_2", 100, TORQUE)  # to a drive in FAULT
        node.run(0.51)
        tell(node, Command.RESET, Command.ARM, Command.START)
        rows = node.run(0.55)
        assert rows["state"][-1] == LifeState.ACTIVE
        assert not torque(rows, node)[511:].any()


# ---- its states, against the diagram of docs/safety.md ----

EVENTS = st.lists(
    st.tuples(
        st.sampled_from([*DriveRequest, "torque", "not finite", "nothing"]), st.integers(0, 8)
    ),
    max_size=40,
)
DIAGRAM = {
    ("OFF", "POWER_ON"): "READY",
    ("READY", "ENABLE"): "ENABLED",
    ("ENABLED", "DISABLE"): "READY",
    ("FAULT", "CLEAR"): "READY",
}


class Oracle:
    """OFF, READY, ENABLED, FAULT; a watchdog of 5 ms that begins anew at each change."""

    def __init__(self):
        self.state, self.fed = "OFF", 0

    def request(self, name, t):
        if name == "TRIP":
            self.state = self.state if self.state == "OFF" else "FAULT"
            return
        new = "OFF" if name == "POWER_OFF" else DIAGRAM.get((self.state, name))
        if new:
            self.state, self.fed = new, t

    def step(self, command, valid, t):
        """The torque that acts, N.m, on `command` at `t`, which is a sample if `valid`."""
        if valid:
            self.fed = t
        if self.state == "ENABLED" and (t - self.fed > 5 or not np.isfinite(command)):
            self.state = "FAULT"
        return max(-10.0, min(10.0, command)) if self.state == "ENABLED" else 0.0


@given(events=EVENTS)
def test_it_follows_the_diagram_its_watchdog_latches_and_nothing_acts_while_it_is_off(events):
    drive, oracle, t = DriveSpec(tau_max=10.0, watchdog="5 ms").build(1, H), Oracle(), 0
    for what, wait in events:
        t += wait
        if isinstance(what, DriveRequest):
            drive.request(what, t * MS)
            oracle.request(what.name, t)
        command = {"torque": 99.0, "not finite": np.nan}.get(what, 1.0)
        valid = what in ("torque", "not finite")
        torque = drive.step([command], valid, [2.0], t * MS)[0]
        assert torque == oracle.step(command, valid, t)
        assert drive.state.name == oracle.state


@pytest.mark.parametrize(("name", "message"), [("can", "LINK_2"), ("can-classic", "TAU_2")])
def test_frames_in_another_format_feed_nothing(name, message, tmp_path):
    """It hears torques in the format of its protocol only: CAN FD, or classic."""
    with alone(named(name, "run.stop=2"), "master", tmp_path) as node:
        for k in range(40):
            node.say(message, k, TORQUE if name == "can" else TORQUE[:2])
        for t, _, frame in node._coming:
            if t > 50 * MS:
                frame.flags ^= int(Flags.FD)
        node.run(0.2)
        assert node.wired.drives[0].state is DriveState.FAULT
