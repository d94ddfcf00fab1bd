"""The babbling peer: frames of one identifier at a given rate until it is stopped."""

from __future__ import annotations

import ctypes as c
import re
import signal
import subprocess
import sys

import can
import pytest

from bridge.can.interface import CanBusSpec, attach
from bridge.can.repeated_frame import repeat
from bridge.faults.script import FaultEvent
from bridge.rehearsal.babbler import command, main

EVENT = FaultEvent(0.0, "babble", "left", 0, id=0x10, rate=2000.0, length=8)


def received(bus):
    frames = []
    while (message := bus.recv(0.2)) is not None:
        frames.append(message)
    return frames


@pytest.mark.parametrize(
    "identifier, extended", [(0x10, False), (0x12345, True), (0x80000010, True)]
)
def test_frames_come_in_order_with_their_identifier(identifier, extended):
    with can.Bus(interface="virtual", channel="babble") as other:
        attachment = attach(CanBusSpec("x", "virtual", "babble"), accepts=())
        done = repeat(attachment.bus, identifier, 10_000, 8, 20, c.c_int32(0))
        attachment.close()
        frames = received(other)
    assert done == (20, 0)
    assert {(m.arbitration_id, m.is_extended_id) for m in frames} == {
        (identifier & 0x1FFFFFFF, extended)
    }
    assert [int.from_bytes(m.data, "little") for m in frames] == list(range(20))


def test_nothing_is_sent_after_the_stop():
    attachment = attach(CanBusSpec("x", "virtual", "stopped"), accepts=())
    assert repeat(attachment.bus, 1, 1.0, 0, None, c.c_int32(1)) == (0, 0)
    attachment.close()


def test_long_frames_are_can_fd(capsys):
    with can.Bus(interface="virtual", channel="long", fd=True) as other:
        said = ["-i", "virtual", "-c", "long", "--fd", "--id", "0x20", "--rate", "1000"]
        assert main([*said, "--length", "64", "--seconds", "0.01"]) == 0
        frames = received(other)
    assert [(m.is_fd, m.bitrate_switch, len(m.data)) for m in frames] == [(True, True, 64)] * 10
    assert capsys.readouterr().out == (
        "sending 0x20 1000 times a second\n10 frames sent, 0 not taken\n"
    )


def test_a_bus_that_is_not_there_is_an_error(capsys):
    said = ["-i", "socketcan", "-c", "nowhere7", "--id", "1", "--rate", "1"]
    assert main(said) == 2
    assert "nowhere7" in capsys.readouterr().err


def test_one_that_is_held_sends_when_it_is_told_to():
    said = [*command(EVENT, "virtual", "alone"), "--hold", "--seconds", "0.01"]
    with subprocess.Popen(said, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as peer:
        assert peer.stdin is not None and peer.stdout is not None
        assert peer.stdout.readline() == "sending 0x10 2000 times a second\n"
        assert peer.poll() is None
        out, _ = peer.communicate("\n", timeout=60)
    assert out == "20 frames sent, 0 not taken\n"


def test_a_signal_ends_one_that_is_held():
    with subprocess.Popen(
        [*command(EVENT, "virtual", "alone"), "--hold"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as peer:  # fmt: skip
        assert peer.stdout is not None and peer.stdout.readline()
        peer.send_signal(signal.SIGTERM)
        peer.wait(timeout=60)
        assert peer.stdout.read() == "0 frames sent, 0 not taken\n"


def test_a_signal_ends_it_and_it_says_what_it_did():
    said = command(EVENT, "virtual", "alone")
    assert said[0] == sys.executable
    with subprocess.Popen(said, stdout=subprocess.PIPE, text=True) as peer:
        assert peer.stdout is not None
        assert peer.stdout.readline() == "sending 0x10 2000 times a second\n"
        peer.send_signal(signal.SIGTERM)
        out, _ = peer.communicate(timeout=60)
    assert peer.returncode == 0
    assert re.fullmatch(r"\d+ frames sent, 0 not taken\n", out)
