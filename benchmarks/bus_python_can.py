"""What a message through python-can costs: ``python -m benchmarks.bus --python-can N``.

One thread sends a message of 8 bytes on one bus object and receives it on another. Measured is the
processor time (user and system) of a message, of all processes that take part, and the wall time;
the median of several repetitions. A row for vcan0 comes where that interface exists, for example in
the virtual machine of ``python -m bridge.vcan run``; it includes the work of the kernel.
"""

from __future__ import annotations

import multiprocessing
import socket
import statistics
import time
from collections.abc import Callable
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


def serve(pipe: Connection, place: str) -> None:
    """Serve a bus; tell its address, and, whenever asked, the processor time of this process."""
    channel = Channel("bench", channel_options("bench", **BUS))
    server = BusServer(channel, listen(parse_address(f"bench@{place}")))
    pipe.send(place if "/" in place else f"127.0.0.1:{server.port}")
    while pipe.recv():
        pipe.send(time.process_time_ns())
    server.close()


def cost(messages: int, others: Callable[[], int], **options: object) -> tuple[float, float]:
    """(processor time, wall time) of a message, us; `others`: processor time elsewhere, ns."""
    sent = can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False)
    with can.Bus(**options) as a, can.Bus(**options) as b:  # type: ignore[arg-type]
        wall, used = time.perf_counter_ns(), time.process_time_ns() + others()
        for _ in range(messages):
            a.send(sent)
            assert b.recv(5.0) is not None
        used = time.process_time_ns() + others() - used
        return used / messages / 1e3, (time.perf_counter_ns() - wall) / messages / 1e3


def print_costs(messages: int, repeat: int) -> None:
    """Print a table of the interfaces, each measured `repeat` times with `messages` messages."""
    print("| python-can interface | processor time, us per message | wall time, us |")
    print("|---|---|---|")

    def row(name: str, others: Callable[[], int], **options: object) -> None:
        measured = [cost(messages, others, **options) for _ in range(repeat)]
        used, wall = (statistics.median(column) for column in zip(*measured, strict=True))
        print(f"| {name} | {used:.0f} | {wall:.0f} |", flush=True)

    row("virtual", int, interface="virtual", channel="bench")
    row("cosim, one process, simulated time", int, interface="cosim", channel="bench", **BUS)
    with TemporaryDirectory() as folder:
        for name, place in (("Unix socket", str(Path(folder) / "bus")), ("TCP", "127.0.0.1:0")):
            pipe, end = multiprocessing.Pipe()
            server = multiprocessing.get_context("spawn").Process(target=serve, args=(end, place))
            server.start()

            def theirs(pipe: Connection = pipe) -> int:
                pipe.send(True)
                return int(pipe.recv())

            channel = f"bench@{pipe.recv()}"
            row(
                f"cosim, served by {name}, both processes",
                theirs,
                interface="cosim",
                channel=channel,
            )
            pipe.send(False)
            server.join()
    if "vcan0" in (name for _, name in socket.if_nameindex()):
        row("socketcan on vcan0", int, interface="socketcan", channel="vcan0")
