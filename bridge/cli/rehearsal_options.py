"""The options of ``cosim rehearse``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bridge.cli.options import Realtime
from cosim.base.convert import field
from cosim.cli.options import OutputOptions


class RehearsalOptions(OutputOptions, frozen=True):
    """The nodes and the clock of a rehearsal, its faults, and what is made of it."""

    seed: Annotated[int | None, typer.Option(help="Seed of links and topology.")] = None
    latency: Annotated[
        bool,
        typer.Option(
            "--latency/--no-latency",
            help="Add the link delays of the scenario to those of the bus.",
        ),
    ] = True
    nodes: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Start these nodes only; the others are already running."),
    ] = None
    outside: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NODE=COMMAND",
            help="Program that runs a node in place of this project's process; repeatable. {BUS} "
            "becomes the channel of a bus. Without =COMMAND, you start it yourself.",
        ),
    ] = None
    clock: Annotated[
        str,
        typer.Option(
            help="Clock: wall, simulated (the time of simulated CAN buses, with -i cosim), or "
            "lockstep (as fast as samples arrive; Zenoh only)."
        ),
    ] = "wall"
    hosts: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Hosts to start the nodes on: by ssh, srun or in network namespaces, in lock-step "
            "(see docs/scale.md).",
        ),
    ] = None
    checkpoint: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="In lock-step, save the state at such intervals of wall time, e.g. 60s.",
        ),
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="Continue the run of this folder from its checkpoint; --hosts: on other hosts.",
        ),
    ] = None
    replace: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="With --checkpoint: how often nodes and hosts that died are replaced before the "
            "next checkpoint; all nodes begin again from the last one.",
        ),
    ] = 3
    faults: Annotated[
        Path | None,
        typer.Option(metavar="SCRIPT", help="Fault script: faults to inject (see docs/faults.md)."),
    ] = None
    firmware: Annotated[
        list[str],
        typer.Option(
            metavar="NODE=IMAGE",
            help="Let an image compute the slots of a node, in QEMU or natively, with --clock "
            "simulated; repeatable (see docs/firmware.md).",
        ),
    ] = field(default_factory=list)
    twin: Annotated[
        bool, typer.Option("--twin/--no-twin", help="Compare with the simulated twin.")
    ] = True
    log: Annotated[
        list[str],
        typer.Option(
            metavar="FORMAT", help="Format of the bus logs: log (candump), blf, asc or mf4."
        ),
    ] = field(default_factory=lambda: ["log"])
    realtime: Realtime = True
