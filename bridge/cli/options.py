"""Options shared by several commands of the bridge, and their effect on a deployment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.deployment.changes import interface_settings
from cosim.base.convert import Struct, field
from cosim.base.errors import ScenarioError

if TYPE_CHECKING:
    from bridge.deployment.spec import Deployment

Deploy = Annotated[
    str,
    typer.Option(
        "--deploy",
        show_default=False,
        help="Deployment: a file, or a name in deploy/ next to the scenario. Default: the "
        "scenario's name, or can.",
    ),
]
Interface = Annotated[
    str | None,
    typer.Option(
        "--interface", "-i", help="python-can interface of all CAN buses; cosim: simulated."
    ),
]
Channel = Annotated[
    list[str],
    typer.Option("--channel", "-c", metavar="BUS=CHANNEL", help="Channel of a bus; repeatable."),
]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime/--no-realtime", help="Request real-time priority from the operating system."
    ),
]
#: Options of both ends of a path between nodes.
PingDeployment = Annotated[
    str, typer.Option("--deploy", help="Of a scenario: deployment, file or name.")
]


class BusOptions(Struct, frozen=True):
    """Changes of the CAN buses of a deployment."""

    interface: Interface = None
    channel: Channel = field(default_factory=list)
    bitrate: Annotated[int | None, typer.Option("--bitrate", "-b", help="Bit rate, bit/s.")] = None
    data_bitrate: Annotated[
        int | None, typer.Option(help="Bit rate of CAN FD data phases, bit/s.")
    ] = None
    fd: Annotated[bool | None, typer.Option("--fd/--no-fd", help="CAN FD or classic CAN.")] = None

    def settings(self, deployment: Deployment) -> list[str]:
        """The same as ``deploy.buses.NAME.KEY=VALUE``. Raises ScenarioError."""
        names = [name for name, bus in deployment.buses.items() if bus.kind == "can"]
        fd = None if self.fd is None else str(self.fd).lower()
        changed = {"bitrate": self.bitrate, "data_bitrate": self.data_bitrate, "fd": fd}
        found = interface_settings(deployment, self.interface, channels=not self.channel)
        for name in names:
            at = f"deploy.buses.{name}"
            found += [f"{at}.{key}={value}" for key, value in changed.items() if value is not None]
        return [*found, *(self._channel(text, names) for text in self.channel)]

    @staticmethod
    def _channel(text: str, names: Sequence[str]) -> str:
        """The setting of ``BUS=CHANNEL``, or of one channel for the only bus."""
        bus, equals, channel = text.partition("=")
        if not equals:
            bus, channel = (names[0], text) if len(names) == 1 else ("", text)
        if bus not in names:
            raise ScenarioError(
                f"--channel {text}: expected BUS=CHANNEL, with one of {', '.join(names)}"
            )
        return f'deploy.buses.{bus}.channel="{channel}"'


class ChangeOptions(Struct, frozen=True):
    """Changes of the scenario and the deployment of many rehearsals."""

    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
    ] = field(default_factory=list)
    interface: Interface = None

    def settings(self, deployment: Deployment) -> list[str]:
        """The same as ``PATH=VALUE``. Raises ScenarioError."""
        return [*BusOptions(self.interface).settings(deployment), *self.set_]


class DeployOptions(BusOptions, frozen=True):
    """A deployment, and changes of it and of the scenario."""

    deploy: Deploy = ""
    set_: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change a value of the scenario, or of the deployment: deploy.nodes.…; "
            "repeatable.",
        ),
    ] = field(default_factory=list)


class HardwareOptions(Struct, frozen=True):
    """The permission to move real drives."""

    hardware: Annotated[
        bool,
        typer.Option(
            "--hardware", help="Allow frames that can move real drives; asks for confirmation."
        ),
    ] = False
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False

    def confirm(self, what: str) -> None:
        """Ask whether frames of `what` may move drives, where they can; ends the command if not."""
        from cosim.cli.supervise import allow_terminal_input

        if self.hardware and not self.yes:
            with allow_terminal_input():
                typer.confirm(f"Frames of this {what} may move real drives. Go on?", abort=True)


def refuse_in_simulated_time(deployment: Deployment, **given: bool) -> None:
    """Raise ScenarioError for an option that was `given` and needs the wall clock."""
    for option, said in given.items():
        if said and deployment.clock == "simulated":
            raise ScenarioError(
                f"found --{option} with the simulated clock, expected it with --clock wall only"
            )
