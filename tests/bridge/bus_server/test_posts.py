"""Messages to a served bus that do not wait for its answer keep their order all the same."""

from __future__ import annotations

import gc
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bridge.bus_server.attention import Attention
from bridge.bus_server.listener import listen
from bridge.bus_server.remote_port import RemotePort
from bridge.bus_server.server import BusServer
from bridge.bus_server.several_buses import served_buses
from bridge.simulated_can.bus import CosimBus
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOperationError, channel_options
from bridge.simulated_can.protocol import CallSocket, parse_address
from bridge.simulated_can.thread_connection import BusConnection
from cosim.bus.settings import ScriptedError
from cosim.bus.timing import BusTiming
from tests.bridge.simulated_can.benches import everything, message

ROOT = Path(__file__).parents[3]
MILLISECOND = 0.001
TAKES = 0.02
"""The wall time that a slow server takes for each message that is posted, s."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[BusServer]:
    channel = Channel("bench", channel_options("bench", bitrate=1e6, speed="simulated"))
    found = BusServer(channel, listen(parse_address(f"bench@{tmp_path}/bench.sock")))
    yield found
    found.close()


@pytest.fixture
def address(tmp_path: Path, server: BusServer) -> str:
    return f"bench@{tmp_path}/bench.sock"


@pytest.fixture
def posted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The numbers of the messages that are posted, which a slow server takes."""
    found: list[int] = []
    post: Callable[..., None] = RemotePort.post

    def slowly(port: RemotePort, number: int, packed: list[Any]) -> None:
        time.sleep(TAKES)
        found.append(number)
        post(port, number, packed)

    monkeypatch.setattr(RemotePort, "post", slowly)
    return found


def in_thread(action: Callable[[], object]) -> None:
    """Do it in a thread of its own, until its end."""
    thread = threading.Thread(target=action, daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()


def several(bus: CosimBus, count: int = 9, timeout: float | None = None) -> None:
    """Send messages with the identifiers from 0 on."""
    for i in range(count):
        bus.send(message(i), timeout)


def test_only_a_message_without_room_waits_for_the_server(address: str, posted: list[int]) -> None:
    with CosimBus(address, tx_queue_size=4) as a, CosimBus(address) as b:
        for i in range(4):
            a.send(message(i))
        with pytest.raises(ChannelOperationError, match="found 4 frames in the transmit queue"):
            a.send(message(9))
        assert [m.arbitration_id for m in everything(b)] == [0, 1, 2, 3]
        a.send(message(5))
        assert b.recv(1).arbitration_id == 5
    assert posted == [1, 2, 3, 4]


def test_messages_of_a_bus_keep_their_order_though_threads_take_turns(
    address: str, posted: list[int]
) -> None:
    with CosimBus(address) as a, CosimBus(address) as b:
        in_thread(lambda: a.send(message(0)))
        for i in range(1, 7):
            a.send(message(2 * i - 1))
            in_thread(lambda i=i: a.send(message(2 * i)))
        assert [m.arbitration_id for m in everything(b)] == list(range(13))
    assert posted


def test_what_a_thread_that_ended_has_posted_is_sent_before_later_calls_for_other_buses(
    address: str, posted: list[int]
) -> None:
    """The server still has most of the messages to take when the thread ends."""
    with CosimBus(address) as a, CosimBus(address) as b:
        in_thread(lambda: several(a))
        assert len(posted) < 4
        assert [m.arbitration_id for m in everything(b, MILLISECOND)] == list(range(9))
        in_thread(lambda: several(a))
        b.send(message(9))
        assert [m.arbitration_id for m in everything(b, MILLISECOND)] == list(range(9))
        assert [m.arbitration_id for m in everything(a, MILLISECOND)] == [9]


def test_what_a_thread_posts_while_another_waits_is_sent_before_the_next_call(
    address: str, posted: list[int]
) -> None:
    with CosimBus(address) as a, CosimBus(address) as b:
        thread = threading.Thread(target=several, args=(a,), daemon=True)
        threading.Timer(0.2, thread.start).start()
        first = b.recv(None)
        thread.join(20)
        assert first is not None
        assert len(posted) < 4
        got = [first, *everything(b, MILLISECOND)]
        assert [m.arbitration_id for m in got] == list(range(9))


def test_what_a_thread_has_posted_to_a_bus_that_it_closed_is_sent_before_later_calls(
    address: str, posted: list[int]
) -> None:
    with CosimBus(address) as a, CosimBus(address) as b:
        in_thread(lambda: (several(a), a.shutdown()))
        assert len(posted) == 8
        time.sleep(0.1)  # the server has let the node go
        assert [m.arbitration_id for m in everything(b, MILLISECOND)] == list(range(9))


def test_messages_that_are_taken_cost_later_calls_nothing(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread asks for the last ones that are not known to be taken, and only for those."""
    asked: list[int] = []
    settle = BusConnection.settle
    monkeypatch.setattr(
        BusConnection, "settle", lambda bus, n: (asked.append(n), settle(bus, n))[-1]
    )
    with CosimBus(address) as a, CosimBus(address) as b:
        in_thread(lambda: (a.send(message(1)), a.send(message(2))))
        for _ in range(9):
            b.recv(0)
            a.send(message(3))
        in_thread(lambda: b.recv(0))
        assert asked == [2, 11]
        a.send(message(3))
        b.recv(0)
        in_thread(lambda: (b.recv(0), a.send(message(4))))
        a.recv(0)
        b.recv(0)
    assert asked == [2, 11]


def test_threads_that_post_to_two_buses_at_once_lose_nothing() -> None:
    buses = {"x": BusTiming(1e6), "y": BusTiming(1e6)}
    with served_buses(buses, simulated=True) as names, ExitStack() as stack:
        x, y, *others = (stack.enter_context(CosimBus(names[name])) for name in "xyxy")
        threads = [
            threading.Thread(target=several, args=(bus, 300, 1.0), daemon=True) for bus in (x, y)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20)
        for other in others:
            assert [m.arbitration_id for m in everything(other)] == list(range(300))


def test_time_does_not_wait_for_a_thread_that_has_left_its_bus_and_waited_for_messages_of_others(
    posted: list[int],
) -> None:
    """Its wait for messages of another bus did not make it a participant there."""
    buses = {"x": BusTiming(1e6), "y": BusTiming(1e6)}
    left, over = threading.Event(), threading.Event()
    with served_buses(buses, simulated=True) as names, CosimBus(names["x"]) as x:

        def other() -> None:
            with CosimBus(names["y"]) as y:
                y.recv(0)
            left.set()
            over.wait(20)

        def own() -> None:
            x.send(message(1))
            x.send(message(2))
            thread.start()
            left.wait(20)
            x.sleep(1.0)

        thread = threading.Thread(target=other, daemon=True)
        in_thread(own)
        over.set()
        thread.join(20)
    assert posted == [2]


def test_time_waits_for_a_thread_that_has_only_sent(address: str, posted: list[int]) -> None:
    """Its first message is answered, so the server knows the thread from then on."""
    with CosimBus(address) as a, CosimBus(address):
        thread = threading.Thread(target=lambda: a.send(message(1)), daemon=True)
        thread.start()
        thread.join(20)
    assert posted == []


def test_threads_that_post_to_two_servers_wait_for_each_other(posted: list[int]) -> None:
    buses = {"x": BusTiming(1e6), "y": BusTiming(1e6)}
    with served_buses(buses, simulated=True) as names, ExitStack() as stack:
        x, y, z = (stack.enter_context(CosimBus(names[name])) for name in ("x", "y", "y"))
        in_thread(lambda: (x.send(message(1)), x.send(message(2))))
        in_thread(lambda: (y.send(message(3)), y.send(message(4))))
        assert [m.arbitration_id for m in everything(z, MILLISECOND)] == [3, 4]
    assert posted == [2, 2]


def test_another_thread_drops_what_was_posted(address: str, posted: list[int]) -> None:
    with CosimBus(address) as a, CosimBus(address) as b:
        a.send(message(1))
        a.send(message(2))
        in_thread(a.flush_tx_buffer)
        assert everything(b) == []
    assert posted == [1, 2]


def test_what_is_posted_is_sent_before_the_time_of_another_bus_passes(posted: list[int]) -> None:
    buses = {"x": BusTiming(1e6), "y": BusTiming(1e6)}
    with served_buses(buses, simulated=True) as names, ExitStack() as stack:
        x, other, y = (stack.enter_context(CosimBus(names[name])) for name in ("x", "x", "y"))
        x.send(message(1))
        assert other.recv(1) is not None
        began = y.time
        x.send(message(2))
        assert y.recv(MILLISECOND) is None
        got = other.recv(0)
        assert got is not None
        assert got.timestamp - began < MILLISECOND
    assert posted == [1, 2]


def test_what_is_posted_is_sent_though_its_sender_closes_its_bus(
    address: str, posted: list[int]
) -> None:
    with CosimBus(address) as b:
        with CosimBus(address) as a:
            for i in range(4):
                a.send(message(i))
        assert [m.arbitration_id for m in everything(b)] == [0, 1, 2, 3]
    assert posted == [1, 2, 3, 4]


def test_what_is_posted_is_sent_though_its_sender_dies(address: str, posted: list[int]) -> None:
    code = (
        "import can, os\n"
        f"b = can.Bus(interface='cosim', channel={address!r})\n"
        "for i in range(4): b.send(can.Message(arbitration_id=i, is_extended_id=False))\n"
        "os._exit(9)"
    )
    with CosimBus(address) as b:
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
        got: list[int] = []
        end = time.monotonic() + 10
        while len(got) < 4 and time.monotonic() < end:
            got += [m.arbitration_id for m in everything(b, 1e-3)]
        assert got == [0, 1, 2, 3]
    assert posted == [1, 2, 3, 4]


def test_a_posted_message_that_is_refused_refuses_the_next_call(address: str) -> None:
    with CosimBus(address, tx_queue_size=1) as a, CosimBus(address) as b:
        a.send(message(1))
        a._place._most = 99  # type: ignore[attr-defined]  # more than the server has told
        a.send(message(2))
        with pytest.raises(ChannelOperationError, match="found 1 frames in the transmit queue"):
            a.recv(0)
        assert [m.arbitration_id for m in everything(b)] == [1]
        a.send(message(3))
        assert b.recv(1).arbitration_id == 3


def test_a_bus_off_is_told_by_the_message_that_cannot_be_sent(address: str) -> None:
    with CosimBus(address, auto_restart=False) as a, CosimBus(address):
        for attempt in range(1, 33):
            a.disturb(ScriptedError(0x123, 30, attempt))
        a.send(message(0x123))
        a.sleep(1.0)
        with pytest.raises(ChannelOperationError, match="found the node bus-off"):
            a.send(message(2))


def test_the_connection_of_a_thread_ends_with_it(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulated time waits for a thread as long as it has one."""
    closed: list[int] = []
    close = RemotePort.count
    monkeypatch.setattr(
        RemotePort, "count", lambda port, n: (close(port, n), closed.append(n), None)[-1]
    )
    gc.disable()
    try:
        with CosimBus(address) as a:
            in_thread(lambda: a.send(message(1)))
            end = time.monotonic() + 10
            while -1 not in closed and time.monotonic() < end:
                time.sleep(0.01)
            assert closed == [1, 1, -1]
    finally:
        gc.enable()


def test_a_message_that_no_bus_carries_is_refused_at_once(address: str) -> None:
    with CosimBus(address) as a:
        a.send(message(1))
        for wrong in (message(0x800, check=False), message(1, bytes(12), is_fd=True)):
            with pytest.raises(ChannelOperationError, match="channel 'bench': found"):
                a.send(wrong)


def test_a_server_that_is_gone_is_noticed_by_a_thread_that_only_sends(address: str) -> None:
    channel = Channel("bench", channel_options("bench", bitrate=1e6, speed="simulated"))
    other = address.replace("bench.sock", "other.sock")
    server = BusServer(channel, listen(parse_address(other)))
    with CosimBus(other) as a:
        a.send(message(1))
        server.close()
        with pytest.raises(ChannelOperationError, match=r"the connection to .* closed"):
            for _ in range(2000):
                a.send(message(1))


def test_in_bus_time_each_message_waits_for_its_answer() -> None:
    """A program must not go on before the bus has its message at the program's time."""
    channel = Channel("bench", channel_options("bench", bitrate=1e6, speed="simulated"))
    address = parse_address("bench@127.0.0.1:0")
    server = BusServer(channel, listen(address), attention=Attention())
    with CosimBus(f"bench@127.0.0.1:{server.port}") as a:
        a.send(message(1))
        assert a._place._most == 0  # type: ignore[attr-defined]
    server.close()


def test_a_child_that_is_forked_has_connections_of_its_own(address: str, server: BusServer) -> None:
    """Else the server would take its calls for those of its parent's thread."""
    code = f"""
import can, os
def opened(): return can.Bus(interface="cosim", channel={address!r})
def said(bus, i): bus.send(can.Message(arbitration_id=i, is_extended_id=False))
a = opened()
said(a, 1); said(a, 2)
if os.fork() == 0:
    said(opened(), 0x10)
    os._exit(0)
print(os.wait()[1])
said(a, 3)
print(a.recv(1.0).arbitration_id)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, text=True, capture_output=True
    )
    assert done.stdout.split() == ["0", str(0x10)], done.stderr
    assert len(server._threads._known) == 2


@pytest.mark.slow
def test_ten_runs_of_two_processes_on_two_buses_give_the_same_bytes() -> None:
    found = set()
    program = Path(__file__).with_name("programs") / "two_buses.py"
    for _ in range(10):
        with served_buses({"x": BusTiming(500e3), "y": BusTiming(250e3)}, simulated=True) as names:
            started = [
                subprocess.Popen(
                    [sys.executable, program, str(number), *names.values()],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
                )
                for number in (1, 2)
            ]  # fmt: skip
            for process in started:
                assert process.stdout is not None
                assert process.stdout.readline() == "there\n"
            for process in started:
                assert process.stdin is not None
                process.stdin.write("go\n")
                process.stdin.flush()
            found.add(tuple(process.communicate(timeout=100)[0] for process in started))
    assert len(found) == 1
    assert all(said.count("\n") > 50 for said in found.pop())


class Silent:
    """A socket on which nothing has come when one looks, and then an empty list."""

    def __init__(self) -> None:
        self.looks = 0

    def recv(self, most: int, flags: int = 0) -> bytes:
        if flags & socket.MSG_DONTWAIT:
            self.looks += 1
            raise BlockingIOError
        return b"\0\0\0\1\x90"

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("processors", "most"), [({0}, 0), ({0, 1}, 20)])
def test_looks_in_vain_become_rare(
    monkeypatch: pytest.MonkeyPatch, processors: set[int], most: int
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: processors)
    silent = Silent()
    calls = CallSocket(silent)  # type: ignore[arg-type]
    assert [calls.receive() for _ in range(2000)] == [[]] * 2000
    assert silent.looks <= 100 * most
    assert (silent.looks > 0) == (most > 0)
