"""Options shared by several commands of the bridge, and their effect on a deployment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.errors import ScenarioError
from cosim.cli.numbers import finite

if TYPE_CHECKING:
    from bridge.deployment.spec import Deployment

#: Options that both ends of a measured path have.
ZenohConfig = Annotated[
    Path | None, typer.Option(help="zenoh: session configuration (JSON5), for TLS.")
]
CanInterface = Annotated[
    str, typer.Option("--interface", "-i", help="can: interface of python-can.")
]
CanBitrate = Annotated[
    float | None, typer.Option(callback=finite, min=1, help="can: bit rate, bit/s.")
]
#: Options of both ends of a path between nodes.
PingDeployment = Annotated[
    str, typer.Option("--deploy", help="Of a scenario: deployment, file or name.")
]
PingSettings = Annotated[
    list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change a value.")
]


def bus_settings(
    deployment: Deployment,
    interface: str | None,
    channels: Sequence[str],
    bitrate: int | None,
    data_bitrate: int | None,
    fd: bool | None,
) -> list[str]:
    """``deploy.buses.NAME.KEY=VALUE`` settings for the options of CAN buses on the command line.

    `channels`: ``BUS=CHANNEL``, or one channel for the only bus. Raises ScenarioError.
    """
    names = [name for name, bus in deployment.buses.items() if bus.kind == "can"]
    said: list[str] = []
    for name in names:
        at = f"deploy.buses.{name}"
        if interface is not None:
            said.append(f'{at}.interface="{interface}"')
            if interface != deployment.buses[name].interface and not channels:
                said.append(f'{at}.channel="{name}"')
        if bitrate is not None:
            said.append(f"{at}.bitrate={bitrate}")
        if data_bitrate is not None:
            said.append(f"{at}.data_bitrate={data_bitrate}")
        if fd is not None:
            said.append(f"{at}.fd={'true' if fd else 'false'}")
    for text in channels:
        bus, equals, channel = text.partition("=")
        if not equals:
            bus, channel = (names[0], text) if len(names) == 1 else ("", text)
        if bus not in names:
            raise ScenarioError(
                f"--channel {text}: expected BUS=CHANNEL, with one of {', '.join(names)}"
            )
        said.append(f'deploy.buses.{bus}.channel="{channel}"')
    return said


def clock_settings(deployment: Deployment, clock: str) -> list[str]:
    """The changes of a deployment for a clock other than the wall's. Raises ScenarioError."""
    if clock == "wall":
        return []
    if clock == "simulated":
        return ['deploy.clock="simulated"']
    if clock != "lockstep":
        raise ScenarioError(f"--clock {clock}: expected wall, simulated or lockstep")
    can = [name for name, bus in deployment.buses.items() if bus.kind == "can"]
    if can:
        raise ScenarioError(
            f"--clock lockstep: {', '.join(can)} is CAN, which may lose frames; expected a "
            "deployment over Zenoh alone",
            str(deployment.path),
        )
    return [f"deploy.buses.{name}.options.lockstep=true" for name in deployment.buses]


def refuse_in_simulated_time(deployment: Deployment, **given: bool) -> None:
    """Raise ScenarioError for an option that was `given` and needs the wall clock."""
    for option, said in given.items():
        if said and deployment.clock == "simulated":
            raise ScenarioError(
                f"found --{option} with the simulated clock, expected it with --clock wall only"
            )


def unused_folder(folder: Path) -> Path:
    """`folder`, or with -2, -3, … behind it."""
    n, path = 1, folder
    while path.exists():
        n += 1
        path = folder.with_name(f"{folder.name}-{n}")
    return path
