"""An end that was paused for longer than its lease is received again, and receives."""

import os
import signal
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from bridge.native.frame import Frame
from bridge.zenoh.socket_release import Linger, release
from cosim.base.clock import sleep, stopwatch
from tests.bridge.zenoh.ends import IDENTIFIERS, both, endpoint, opened
from tests.bridge.zenoh.test_channel import free_ports

FROZEN, PATIENCE = 4.0, 30.0  # s; a connection is given up after 3


def bound_to_one_port() -> tuple[socket.socket, socket.socket]:
    """A socket of UDP and one of TCP; which port is free for both, only trying tells."""
    for _ in range(100):
        stuck = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stream = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            stuck.bind(("127.0.0.1", 0))
            stream.bind(stuck.getsockname())
        except OSError:
            stuck.close()
            stream.close()
        else:
            return stuck, stream
    raise AssertionError("no port is free for UDP and TCP")


def test_an_address_is_free_again_and_other_sockets_are_left_alone():
    stuck, stream = bound_to_one_port()
    with (
        stuck,
        stream,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again,
    ):
        other.bind(("127.0.0.1", 0))
        address = stuck.getsockname()
        with pytest.raises(OSError, match="in use"):
            again.bind(address)
        endpoint = f"udp/127.0.0.1:{address[1]}"
        assert release([endpoint.replace("udp", "tcp")]) == 0  # `stream` does not listen
        assert release([f"{endpoint}?rel=0"]) == 1
        again.bind(address)
        assert other.getsockname()[1] and stream.getsockname() == address


@pytest.mark.parametrize("protocol", ["tcp", "tls", "ws"])
def test_an_address_of_streams_is_free_again_and_its_connections_live_on(protocol):
    with (
        socket.create_server(("127.0.0.1", 0)) as stuck,
        socket.create_connection(stuck.getsockname()) as there,
    ):
        here, _ = stuck.accept()
        with here:
            address = stuck.getsockname()
            with pytest.raises(OSError, match="in use"):
                socket.create_server(address)
            endpoint = f"{protocol}/127.0.0.1:{address[1]}"
            assert release([f"{endpoint}?rel=1"]) == 1
            socket.create_server(address).close()
            there.sendall(b"x")
            assert here.recv(1) == b"x"


def test_a_connection_is_not_waited_for_when_it_closes():
    """Zenoh closes with 10 s of patience for lost acknowledgements, and receives nothing then."""
    patient = struct.pack("ii", 1, 10)
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as end,
    ):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, patient)
        linger = Linger()
        assert linger.clear() == 1
        assert not end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER)
        with socket.create_connection(server.getsockname()) as later:
            assert linger.clear() == 0
            later.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, patient)
            assert linger.clear() == 0  # each connection is looked at once
            assert Linger().clear() == 1


def test_zenoh_s_connections_have_no_patience_left(tmp_path):
    """Asks the kernel about the sockets of two ends, as a stranger would see them."""
    (port,) = free_ports(1)
    ends = both(f"tcp/127.0.0.1:{port}")
    try:
        elapsed = stopwatch()
        while Linger().clear():  # Zenoh sets it; within a look it is gone for good
            assert elapsed() < PATIENCE
            sleep(0.5)
    finally:
        for end in ends:
            end.close()


def test_looking_for_an_address_leaves_no_descriptor_open(tmp_path: Path):
    """Files are no sockets: a copy of each stayed open, and a node ran out of descriptors."""
    descriptors = "/proc/self/fd"
    with ExitStack() as files:
        for number in range(20):
            files.enter_context((tmp_path / str(number)).open("w"))
        before = len(os.listdir(descriptors))
        for _ in range(3):
            assert release(["udp/127.0.0.1:9"]) == 0
        assert len(os.listdir(descriptors)) == before


def left_open(where: str) -> None:
    """A process that ends with an error while its session is open."""
    opened("a", "b", listen=(where,))
    raise SystemExit(3)


def test_a_session_that_was_not_closed_does_not_hold_its_process(tmp_path: Path):
    """After an error it lived on, with its token, and nothing more was said."""
    program = (
        f"from tests.bridge.zenoh.test_deaf import left_open; left_open({endpoint(tmp_path)!r})"
    )
    ended = subprocess.run([sys.executable, "-c", program], timeout=PATIENCE * 4, check=False)
    assert ended.returncode == 3


def talk(end):
    """Say something every 5 ms, and count what is heard, until a line comes."""
    heard = 0
    while True:
        for identifier in IDENTIFIERS:
            end.bus.send(Frame.of(identifier, bytes(8)))
        sleep(0.02)
        heard += len(end.bus.drain())
        yield heard


def listener(port):
    """Process ``a``: it listens, and prints each second how much it has heard."""
    end = opened("a", "b", listen=(f"udp/127.0.0.1:{port}",))
    end.wait_for_peers()
    elapsed, second = stopwatch(), 0.0
    for heard in talk(end):
        if elapsed() > second:
            second = elapsed() + 0.2
            print(heard, flush=True)


@pytest.mark.slow
def test_a_listener_over_udp_that_was_paused_is_heard_and_hears_again():
    (port,) = free_ports(1)
    program = f"from tests.bridge.zenoh.test_deaf import listener; listener({port})"
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    ) as other:
        end = opened("b", "a", connect=(f"udp/127.0.0.1:{port}",))
        try:
            end.wait_for_peers()
            said, assertion = talk(end), stopwatch()
            while not next(said):
                assert assertion() < PATIENCE
            os.kill(other.pid, signal.SIGSTOP)
            frozen = stopwatch()
            while frozen() < FROZEN:
                next(said)
            os.kill(other.pid, signal.SIGCONT)
            assert other.stdout is not None
            before, theirs, again = next(said), int(other.stdout.readline()), stopwatch()
            while next(said) <= before + 100 or int(other.stdout.readline()) <= theirs + 1000:
                assert again() < PATIENCE
        finally:
            end.close()
            other.kill()
