"""``cosim bus``: a simulated CAN bus that programs of other processes join."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct, field
from cosim.base.copies import asdict
from cosim.cli.options import drawn, finite

if TYPE_CHECKING:
    from bridge.bus_server.programs import Programs
    from bridge.simulated_can.channel import Channel
    from bridge.simulated_can.options import ChannelOptions

_TURN = 0.1
"""Time for which the channel runs before the end is checked again, s of the wall clock."""


class WireOptions(Struct, frozen=True):
    """The wire of the bus, and its time."""

    bitrate: Annotated[float, typer.Option(callback=finite, help="Bit rate, bit/s.")] = 500_000.0
    fd: Annotated[bool, typer.Option("--fd", help="Use CAN FD.")] = False
    data_bitrate: Annotated[
        float | None, typer.Option(callback=finite, help="Bit rate of the data phase, bit/s.")
    ] = None
    error_rate: Annotated[
        float, typer.Option(callback=finite, help="Probability that a bit is inverted.")
    ] = 0.0
    seed: Annotated[int, typer.Option(help="Seed of random traffic and errors.")] = 0
    speed: Annotated[
        str,
        typer.Option(
            "--speed", "--clock", help="Speed relative to the wall clock, or 'simulated'."
        ),
    ] = "1.0"


class TrafficOptions(Struct, frozen=True):
    """The traffic besides that of programs."""

    load: Annotated[
        str, typer.Option(help="Other traffic: a .dbc file, a log, or a bus load such as 30%.")
    ] = ""
    jitter: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Jitter of DBC messages, as a fraction of the period."),
    ] = 0.0


class ServerOptions(Struct, frozen=True):
    """The ways in which programs join."""

    listen: Annotated[
        str,
        typer.Option(help="Address for python-can programs: HOST:PORT or the path of a socket."),
    ] = "127.0.0.1:29530"
    socketcand: Annotated[
        str, typer.Option(help="Address for socketcand clients, HOST:PORT. Default: none.")
    ] = ""
    mirror: Annotated[
        list[str],
        typer.Option(help="SocketCAN interface to mirror, such as vcan0: a node; repeatable."),
    ] = field(default_factory=list)


class ProgramOptions(Struct, frozen=True):
    """The time of programs after ``--``."""

    date: Annotated[
        datetime, typer.Option(help="Date of the programs at time 0 of the bus, UTC.")
    ] = datetime(2026, 1, 1)
    most_computing: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=0.01,
            help="Processor time that a program may compute without waiting, s.",
        ),
    ] = 60.0


class BusEndOptions(Struct, frozen=True):
    """The end of the bus, and what is drawn then."""

    for_: Annotated[
        float | None,
        typer.Option(
            "--for", callback=finite, min=0.001, help="End after this time of the bus, s."
        ),
    ] = None
    picture: Annotated[
        Path | None,
        typer.Option(callback=drawn, help="Write a PNG of the last --window seconds at the end."),
    ] = None
    window: Annotated[
        float, typer.Option(callback=finite, min=1e-4, help="Time in the picture, s.")
    ] = 0.02


def bus(
    wire: WireOptions,
    traffic: TrafficOptions,
    servers: ServerOptions,
    programs: ProgramOptions,
    end: BusEndOptions,
    channel: Annotated[str, typer.Option(help="Name of the bus.")] = "bench",
    command: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[-- PROGRAM [ARGUMENT]... [-- PROGRAM ...]]",
            help="Programs to run in the simulated time of the bus; the last one ends it.",
        ),
    ] = None,
) -> None:
    """Serve a simulated CAN bus to python-can programs, socketcand clients and SocketCAN.

    Programs join with can.Bus(interface="cosim", channel="bench@127.0.0.1:29530"). Ctrl-C ends it
    and prints a summary of the last 10 s: load, response times, errors and losses.

    With --clock simulated, programs after -- run unmodified in the time of the bus: their clocks,
    sleeps and time-outs are those of the bus, which stands still while one of them computes. A
    plain can.Bus() joins; sockets of AF_CAN do on the interface that --channel names.
    """
    from bridge.bus_server.record import BusRecord
    from bridge.simulated_can.options import channel_options

    options = channel_options(channel, **asdict(wire))
    record, status = BusRecord(), 0
    with ExitStack() as stack:
        if command:
            found = _programs(channel, options, command, programs, servers)
            stack.callback(found.close)
            shared = found.channel
        else:
            found, shared = None, _served(channel, options, servers, stack)
        shared.record(record)
        if traffic.load:
            _load(shared, traffic, wire.seed)
        if found is None:
            _run(shared, end.for_)
        else:
            status = _run_programs(found, end.for_)
        shared.record(None)
    for line in record.lines(shared.timing):
        typer.echo(line, err=bool(command))
    if end.picture is not None:
        drawn = record.draw(end.picture, shared.timing, round(end.window * 1e12))
        typer.echo(f"picture: {drawn}", err=bool(command))
    if status:
        raise typer.Exit(128 - status if status < 0 else status)


def _programs(
    channel: str,
    options: ChannelOptions,
    words: list[str],
    wanted: ProgramOptions,
    servers: ServerOptions,
) -> Programs:
    """The programs of the command line, not started yet, on a bus of theirs."""
    from bridge.bus_server.program_file import ProgramError
    from bridge.bus_server.programs import Programs

    if options.speed:
        raise ProgramError(
            f"found programs and --speed {options.speed:g}, expected --clock simulated with them"
        )
    if servers != ServerOptions():
        raise ProgramError(
            "found programs and --listen, --socketcand or --mirror, expected none of these: what "
            "comes from outside has no place in simulated time"
        )
    return Programs(
        channel,
        options,
        separated(words),
        date=wanted.date.replace(tzinfo=UTC).timestamp(),
        most_computing_ns=round(wanted.most_computing * 1e9),
    )


def separated(words: list[str]) -> list[list[str]]:
    """The commands of a command line, which ``--`` separates. Raises ProgramError."""
    from bridge.bus_server.program_file import ProgramError

    found: list[list[str]] = [[]]
    for word in words:
        if word == "--":
            found.append([])
        else:
            found[-1].append(word)
    if not all(found):
        raise ProgramError("found nothing between two --, expected a program and its arguments")
    return found


def _run_programs(found: Programs, seconds: float | None) -> int:
    """Run the programs to their end, or for so many s; the exit status of the last one."""
    from cosim.base.interrupts import until_signal

    found.start()
    status = 0
    with until_signal():
        status = found.run(seconds)
    return status


def _load(shared: Channel, traffic: TrafficOptions, seed: int) -> None:
    """Let other traffic share the bus."""
    from bridge.bus_server.traffic import ChannelLoad, load_sources

    sources = load_sources(traffic.load, shared.timing, traffic.jitter, seed)
    ChannelLoad(shared, *sources)


def _served(
    channel: str, options: ChannelOptions, servers: ServerOptions, stack: ExitStack
) -> Channel:
    """A bus for programs that come by themselves."""
    from bridge.simulated_can.channel import Channel

    shared = Channel(channel, options)
    _serve(shared, stack, servers)
    return shared


def _serve(shared: Channel, stack: ExitStack, wanted: ServerOptions) -> None:
    """Start all servers and print their addresses."""
    from bridge.bus_server.listener import listen as listen_at
    from bridge.bus_server.mirror import BusMirror
    from bridge.bus_server.server import BusServer
    from bridge.bus_server.socketcand import SocketcandServer
    from bridge.simulated_can.protocol import parse_address

    address = parse_address(f"{shared.name}@{wanted.listen}")
    server = BusServer(shared, listen_at(address))
    stack.callback(server.close)
    place = address.path or f"{address.host}:{server.port}"
    typer.echo(f'can.Bus(interface="cosim", channel="{shared.name}@{place}")')
    if wanted.socketcand:
        address = parse_address(f"{shared.name}@{wanted.socketcand}")
        foreign = SocketcandServer(shared, listen_at(address))
        stack.callback(foreign.close)
        typer.echo(f"socketcand at {address.host}:{foreign.port}")
    for interface in wanted.mirror:
        stack.callback(BusMirror(shared, interface).close)
        typer.echo(f"mirrored on {interface}")


def _run(shared: Channel, seconds: float | None) -> None:
    """Let the time of the channel pass, until Ctrl-C or for so many s of it."""
    from cosim.base.clock import sleep
    from cosim.base.interrupts import act_on_signal, until_signal

    with until_signal():
        if seconds is not None:
            shared.sleep(seconds)
        while seconds is None:
            act_on_signal()
            if shared.options.speed:
                shared.sleep(_TURN * shared.options.speed)
            else:  # its time passes when the clients wait
                sleep(_TURN)
