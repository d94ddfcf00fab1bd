"""Several simulated buses of this process that others use, as a rehearsal needs them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from bridge.bus_server.lag import BusLag, LagWatch
from bridge.bus_server.listener import listen
from bridge.bus_server.remote_thread import RemoteThreads
from bridge.bus_server.server import BusServer
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOptions
from bridge.simulated_can.protocol import BusAddress
from bridge.simulated_can.shared_time import SharedTime
from cosim.bus.timing import BusTiming

HOST = "127.0.0.1"


@contextmanager
def served_buses(
    buses: Mapping[str, BusTiming], *, simulated: bool, lags: list[BusLag] | None = None
) -> Iterator[dict[str, str]]:
    """Serve a bus of each name on this host; gives the channel of each, ``NAME@HOST:PORT``.

    `simulated`: all buses have one simulated time, which passes when all clients wait; else they
    keep to the wall clock, and where they do not, `lags` is appended to. Raises ServerError where
    this host lets no port be opened.
    """
    time, threads = SharedTime() if simulated else None, RemoteThreads()
    with ExitStack() as stack:
        channels, served = {}, dict[str, Channel]()
        for name, timing in buses.items():
            options = ChannelOptions(timing=timing, fd=timing.fd, data_bitrate=timing.data_bitrate)
            served[name] = Channel(name, options, time)
            server = BusServer(served[name], listen(BusAddress(name, HOST, 0, "")), threads)
            stack.callback(server.close)
            channels[name] = f"{name}@{HOST}:{server.port}"
        if lags is not None and served and not simulated:
            stack.callback(LagWatch(served, lags).close)
        yield channels
