"""What a message through python-can costs: ``python -m benchmarks.bus --python-can N``.

One thread sends a message of 8 bytes on one bus object and receives it on another. Measured is the
processor time (user and system) of a message, of all processes that take part, and the wall time;
the paths take turns. `virtual` and `udp_multicast` are interfaces of python-can, without a bus: no
arbitration, no lengths of frames, no errors. A round trip of 32 bytes between two processes by a
bare Unix socket is what a call of a served bus costs at least that sleeps until it is answered; two
of them are a message whose sending is answered, too. They are measured where the kernel lets the
processes run, and with a processor for each.

For `udp_multicast` the program moves into a network namespace of its own, which takes the rights of
root; without them its row is missing. A row for vcan0 comes where that interface exists, for
example in the virtual machine of ``python -m bridge.vcan run``; it includes the work of the kernel.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import socket
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can

from bridge.bus_server.listener import listen
from bridge.bus_server.server import BusServer
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import channel_options
from bridge.simulated_can.protocol import parse_address

BUS: dict[str, Any] = {"bitrate": 1_000_000, "speed": "simulated"}
CLONE_NEWNET = 0x40000000
MULTICAST = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo"

#: Processor time of a message, us, and the wall times of each message, us.
Cost = tuple[float, list[float]]


def serve(pipe: Connection, place: str) -> None:
    """Serve a bus; tell its address, and, whenever asked, the processor time of this process."""
    channel = Channel("bench", channel_options("bench", **BUS))
    server = BusServer(channel, listen(parse_address(f"bench@{place}")))
    pipe.send(place if "/" in place else f"127.0.0.1:{server.port}")
    while pipe.recv():
        pipe.send(time.process_time_ns())
    server.close()


def echo(pipe: Connection, place: str) -> None:
    """Send back what comes; tell the address, and the processor time of this process at the end."""
    listener = listen(parse_address(f"bench@{place}"))
    pipe.send(place)
    while pipe.recv():
        connection, _ = listener.accept()
        with connection:
            begin = time.process_time_ns()
            while said := connection.recv(4096):
                connection.sendall(said)
            pipe.send(time.process_time_ns() - begin)


def echo_apart(pipe: Connection, place: str) -> None:
    """The same on the last processor, which :func:`round_trips` leaves to it with `apart`."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    echo(pipe, place)


@contextmanager
def beside(
    target: Callable[[Connection, str], None], place: str
) -> Iterator[tuple[Connection, str]]:
    """A process, by its pipe, and the address that it has told."""
    pipe, end = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=target, args=(end, place))
    process.start()
    try:
        yield pipe, pipe.recv()
    finally:
        pipe.send(False)
        process.join()


def _used(pipe: Connection) -> int:
    pipe.send(True)
    return int(pipe.recv())


def exchanged(messages: int, others: Callable[[], int], **options: object) -> Cost:
    """The cost of messages between two bus objects; `others`: processor time elsewhere, ns."""
    sent = can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False)
    walls = []
    with can.Bus(**options) as a, can.Bus(**options) as b:  # type: ignore[arg-type]
        for i in range(messages + messages // 10):  # the first ones warm up
            if i == messages // 10:
                used = time.process_time_ns() + others()
            begin = time.perf_counter_ns()
            a.send(sent)
            assert b.recv(5.0) is not None
            walls.append((time.perf_counter_ns() - begin) / 1e3)
        used = time.process_time_ns() + others() - used
    return used / messages / 1e3, walls[messages // 10 :]


def round_trips(
    pipe: Connection, place: str, trips: int, messages: int, apart: bool = False
) -> Cost:
    """The cost of round trips of 32 bytes with the process of `echo`, so many for each message.

    `apart`: on the first processor.
    """
    said, walls = bytes(32), []
    allowed = os.sched_getaffinity(0)
    if apart:
        os.sched_setaffinity(0, {min(allowed)})
    pipe.send(True)
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(place)
        used = time.process_time_ns()
        for _ in range(messages):
            begin = time.perf_counter_ns()
            for _ in range(trips):
                connection.sendall(said)
                connection.recv(4096)
            walls.append((time.perf_counter_ns() - begin) / 1e3)
        used = time.process_time_ns() - used
    os.sched_setaffinity(0, allowed)
    return (used + int(pipe.recv())) / messages / 1e3, walls


def print_costs(messages: int, repeat: int) -> None:
    """Print a table of the paths, each measured `repeat` times with `messages` messages."""
    kernel = "vcan0" in (name for _, name in socket.if_nameindex())
    apart = not kernel and _isolated()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        paths = _paths(stack, folder)
        kinds = {"udp_multicast": "239.74.163.2"} if apart else {}
        for kind, channel in (kinds | ({"socketcan": "vcan0"} if kernel else {})).items():
            paths[kind] = partial(exchanged, others=int, interface=kind, channel=channel)
        found: dict[str, list[Cost]] = {name: [] for name in paths}
        for _ in range(repeat):
            for name, path in paths.items():
                found[name].append(path(messages=messages))
    print("| python-can interface | processor time, µs | as virtual | wall, µs | p99, µs |")
    print("|---|---|---|---|---|")
    unit = [used for used, _ in found["virtual"]]
    for name, costs in found.items():
        used = [cost for cost, _ in costs]
        ratio = statistics.median(x / y for x, y in zip(used, unit, strict=True))
        walls = sorted(wall for _, part in costs for wall in part)
        print(
            f"| {name} | {statistics.median(used):.1f} | {ratio:.1f} | "
            f"{walls[len(walls) // 2]:.0f} | {walls[len(walls) * 99 // 100]:.0f} |"
        )


def _paths(stack: ExitStack, folder: Path) -> dict[str, Callable[..., Cost]]:
    """The paths of a message, and the processes that they need."""
    local = {"interface": "cosim", "channel": "bench", **BUS}
    paths: dict[str, Callable[..., Cost]] = {
        "virtual": partial(exchanged, others=int, interface="virtual", channel="bench"),
        "cosim, one process, simulated time": partial(exchanged, others=int, **local),
        "cosim, one process, wall clock": partial(exchanged, others=int, **local | {"speed": 1.0}),
    }
    pipe, place = stack.enter_context(beside(echo, str(folder / "echo")))
    paths["a bare round trip, both processes"] = partial(round_trips, pipe, place, 1)
    paths["two bare round trips, both processes"] = partial(round_trips, pipe, place, 2)
    if len(os.sched_getaffinity(0)) > 1:
        pipe, place = stack.enter_context(beside(echo_apart, str(folder / "apart")))
        for trips, name in ((1, "a bare round trip"), (2, "two bare round trips")):
            paths[f"{name}, a processor each"] = partial(
                round_trips, pipe, place, trips, apart=True
            )
    for name, wanted in (("Unix socket", str(folder / "bus")), ("TCP", "127.0.0.1:0")):
        pipe, place = stack.enter_context(beside(serve, wanted))
        options: dict[str, Any] = {"interface": "cosim", "channel": f"bench@{place}"}
        paths[f"cosim, served by {name}, both processes"] = partial(
            exchanged, others=partial(_used, pipe), **options
        )
    return paths


def _isolated() -> bool:
    """Move this process into a network namespace of its own; False if it may not."""
    if ctypes.CDLL(None).unshare(CLONE_NEWNET):
        return False
    return subprocess.run(["sh", "-c", MULTICAST], check=False).returncode == 0
