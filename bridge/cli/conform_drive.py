"""``cosim conform --drive``: a drive judged by numbered rules of its vendor's document."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError

if TYPE_CHECKING:
    from bridge.cli.options import BusOptions
    from bridge.conform.drives.kit import DriveProtocol
    from bridge.conform.drives.lines import JudgedLine
    from bridge.conform.rules import ConformityReport, ConformityRule, JudgedRule

DRIVES = ("damiao", "odrive", "cia402")


class DriveConformityOptions(Struct, frozen=True):
    """A drive to judge in place of a participant."""

    drive: Annotated[
        str,
        typer.Option(
            metavar="|".join(DRIVES),
            help="Judge a drive, number --node, on the bus -i, -c; no scenario.",
        ),
    ] = ""
    may_move: Annotated[
        bool,
        typer.Option(
            "--may-move",
            help="With --drive: also rules that enable it, without torque. It may move.",
        ),
    ] = False
    watchdog: Annotated[
        str,
        typer.Option(help="With --drive odrive, cia402: its time-out as configured, '100 ms'."),
    ] = ""
    host: Annotated[
        int, typer.Option(help="With --drive cia402: the node whose heartbeats it waits for.")
    ] = 1
    emulated: Annotated[
        bool,
        typer.Option("--emulated", help="With --drive: our emulated drive, in simulated time."),
    ] = False


def protocol_of(name: str) -> DriveProtocol:
    """The rules of a protocol. Raises ScenarioError for another name."""
    from bridge.conform.drives.cia402 import CIA402
    from bridge.conform.drives.damiao import DAMIAO
    from bridge.conform.drives.odrive import ODRIVE

    known = {protocol.name: protocol for protocol in (DAMIAO, ODRIVE, CIA402)}
    if name not in known:
        raise ScenarioError(f"found {name!r}, expected one of {', '.join(known)}", "--drive")
    return known[name]


def judge_drive(
    options: DriveConformityOptions,
    bus: BusOptions,
    node: str,
    rules: Sequence[ConformityRule],
    say: Callable[[JudgedRule], None],
) -> ConformityReport:
    """The verdicts on a drive. Raises ScenarioError for an option, BusError from the bus."""
    from bridge.conform.drives.bench import DriveBench, DriveSetup
    from bridge.conform.drives.kit import DriveKit
    from bridge.safety.limits import to_si

    most = 63 if options.drive == "odrive" else 127
    if not node.isdigit() or not 0 <= int(node) <= most:
        raise ScenarioError(f"found {node!r}, expected the number of the drive", "--node")
    watchdog = to_si(options.watchdog, "s", "--watchdog") if options.watchdog else 0.0
    if options.emulated and not watchdog:
        watchdog = 0.1
    setup = DriveSetup(int(node), watchdog, options.host, bool(bus.fd))
    line = _line(options, bus, setup.node, watchdog)
    try:
        kit = DriveKit(
            protocol_of(options.drive), DriveBench(line, setup), may_move=options.may_move
        )
        return kit.judge(rules, say)
    finally:
        line.close()


def _line(
    options: DriveConformityOptions, bus: BusOptions, node: int, watchdog: float
) -> JudgedLine:
    from bridge.can.interface import CanBusSpec
    from bridge.conform.drives.lines import CanDriveLine, EmulatedDriveLine
    from bridge.native.vendor import VendorKind

    if options.emulated:
        return EmulatedDriveLine(VendorKind[options.drive.upper()], node, watchdog)
    if len(bus.channel) != 1:
        raise ScenarioError(
            f"found {len(bus.channel)} channels, expected one, such as -i socketcan -c can0,"
            " or --emulated",
            "--channel",
        )
    channel, rate = bus.channel[0].rpartition("=")[2], bus.data_bitrate
    interface = bus.interface or "socketcan"
    return CanDriveLine(CanBusSpec("drive", interface, channel, bool(bus.fd), bus.bitrate, rate))
