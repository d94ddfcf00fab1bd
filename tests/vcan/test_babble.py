"""The babbling peer on a real SocketCAN bus, and a bus that goes down under it."""

from __future__ import annotations

import ctypes as c
import subprocess

import can

from bridge.can.interface import CanBusSpec, attach
from bridge.can.repeated_frame import repeat
from bridge.faults.script import FaultEvent
from bridge.rehearsal.babbler import command
from tests.vcan.peers import PATIENCE, call


def test_others_hear_it_until_it_is_hushed(vcan):
    event = FaultEvent(0.0, "babble", "left", 0, id=0x10, rate=500.0, length=3)
    with (
        can.Bus(interface="socketcan", channel=vcan[0]) as other,
        subprocess.Popen(
            command(event, "socketcan", vcan[0]), stdout=subprocess.PIPE, text=True
        ) as peer,
    ):
        heard = [other.recv(PATIENCE) for _ in range(20)]
        peer.terminate()
        out, _ = peer.communicate(timeout=PATIENCE)
    assert peer.returncode == 0 and out.endswith("0 not taken\n")
    assert {(m.arbitration_id, m.dlc) for m in heard if m} == {(0x10, 3)}
    assert [int.from_bytes(m.data, "little") for m in heard if m] == list(range(20))


def test_a_bus_that_goes_down_is_no_end(vcan):
    attachment = attach(CanBusSpec("x", "socketcan", vcan[0]), accepts=())
    call("ip", "link", "set", vcan[0], "down")
    assert repeat(attachment.bus, 0x10, 1e5, 8, 10, c.c_int32(0)) == (0, 10)
    call("ip", "link", "set", vcan[0], "up")
    assert repeat(attachment.bus, 0x10, 1e5, 8, 10, c.c_int32(0)) == (10, 0)
    attachment.close()
