"""A simulated bus mirrored to a SocketCAN interface: frames pass both ways, in their order."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import can

from tests.bridge.simulated_can.benches import message

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, "-c", "from cosim.cli import main; main()", "bus")


def test_frames_pass_between_the_simulated_bus_and_the_interface(vcan: tuple[str, str]) -> None:
    arguments = ("--listen", "127.0.0.1:0", "--mirror", vcan[0])
    server = subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert server.stdout
    found = re.search(r'channel="([^"]+)"', server.stdout.readline())
    assert found
    assert vcan[0] in server.stdout.readline()
    with (
        can.Bus(interface="cosim", channel=found[1]) as here,
        can.Bus(interface="socketcan", channel=vcan[0]) as there,
    ):
        for i in range(50):
            here.send(message(0x100 + i, bytes([i])))
            there.send(message(0x200 + i, bytes([i])))
        seen = [there.recv(20) for _ in range(50)]
        assert [m and m.arbitration_id for m in seen] == [0x100 + i for i in range(50)]
        seen = [here.recv(20) for _ in range(50)]
        assert [m and m.arbitration_id for m in seen] == [0x200 + i for i in range(50)]
    server.send_signal(signal.SIGINT)
    server.communicate(timeout=60)
    assert server.returncode == 130


def test_a_mirror_goes_on_when_its_interface_was_down(vcan: tuple[str, str]) -> None:
    arguments = ("--listen", "127.0.0.1:0", "--mirror", vcan[0])
    server = subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert server.stdout
    found = re.search(r'channel="([^"]+)"', server.stdout.readline())
    assert found
    assert vcan[0] in server.stdout.readline()
    with can.Bus(interface="cosim", channel=found[1]) as here:
        for state in ("down", "up"):
            subprocess.run(["ip", "link", "set", vcan[0], state], check=True)
            here.send(message(0x10))  # refused while it is down
        with can.Bus(interface="socketcan", channel=vcan[0]) as there:
            passed = False
            for i in range(100):
                there.send(message(0x200 + i))
                here.send(message(0x100 + i))
                passed = here.recv(0.1) is not None and there.recv(0.1) is not None
                if passed:
                    break
            assert passed
    server.send_signal(signal.SIGINT)
    server.communicate(timeout=60)
    assert server.returncode == 130


def test_two_interfaces_are_two_nodes_that_arbitrate(vcan: tuple[str, str]) -> None:
    """Frames of a high priority overtake a burst that waits at the other node."""
    arguments = ("--listen", "127.0.0.1:0", "--bitrate", "20000")
    mirrors = ("--mirror", vcan[0], "--mirror", vcan[1])
    command = [*COMMAND, *arguments, *mirrors]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert server.stdout
    found = re.search(r'channel="([^"]+)"', server.stdout.readline())
    assert found
    assert vcan[0] in server.stdout.readline() and vcan[1] in server.stdout.readline()
    with (
        can.Bus(interface="cosim", channel=found[1]) as listener,
        can.Bus(interface="socketcan", channel=vcan[0]) as low,
        can.Bus(interface="socketcan", channel=vcan[1]) as high,
    ):
        for i in range(60):  # 6 ms each: the burst takes a third of a second
            low.send(message(0x400, bytes([i] * 8)))
        first = listener.recv(20)
        assert first is not None
        for i in range(10):
            high.send(message(0x100, bytes([i] * 8)))
        seen = [m for m in (listener.recv(20) for _ in range(69)) if m is not None]
    order = [(m.arbitration_id, m.data[0]) for m in (first, *seen)]
    assert [x for x in order if x[0] == 0x400] == [(0x400, i) for i in range(60)]
    at = [i for i, x in enumerate(order) if x[0] == 0x100]
    assert [order[i] for i in at] == [(0x100, i) for i in range(10)]
    assert at[-1] - at[0] < 15 and at[-1] < 60  # together, and long before the end of the burst
    times = [m.timestamp for m in (first, *seen)]
    assert times[-1] - times[0] > 69 * 111 / 20000  # the time of a bus, not of vcan
    server.send_signal(signal.SIGINT)
    server.communicate(timeout=60)
    assert server.returncode == 130
