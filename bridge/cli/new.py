"""``cosim new``: files to start from, which run as they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from bridge.cli.options import Deploy
from cosim.base.convert import Struct, field

KINDS = ("controller", "arm", "participant")


class ArmOptions(Struct, frozen=True):
    """The arm of ``cosim new arm``."""

    urdf: Annotated[Path | None, typer.Option(help="For an arm: its URDF file.")] = None
    base: Annotated[
        str, typer.Option(help="Link where the arm begins.", show_default="the root of the file")
    ] = ""
    tip: Annotated[
        str, typer.Option(help="Link where the arm ends.", show_default="the only end")
    ] = ""
    fixed: Annotated[
        list[str],
        typer.Option(
            metavar="JOINT=VALUE",
            help="Joint of the arm that is held at a value, rad or m; repeatable.",
        ),
    ] = field(default_factory=list)

    def given(self) -> bool:
        """True if one of them is."""
        return bool(self.urdf or self.base or self.tip or self.fixed)


class ParticipantOptions(Struct, frozen=True):
    """The node that ``cosim new participant`` replaces."""

    scenario: Annotated[
        Path | None, typer.Option(help="For a participant: the scenario file (.toml).")
    ] = None
    deploy: Deploy = ""
    node: Annotated[str, typer.Option(help="For a participant: the node it replaces.")] = ""
    language: Annotated[
        str, typer.Option(help="For a participant: c, c++, python or rust.", show_default="c")
    ] = ""
    set_: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="For a participant: change a value, as of `cosim rehearse`; repeatable.",
        ),
    ] = field(default_factory=list)

    def given(self) -> bool:
        """True if one of them is."""
        return bool(self.scenario or self.deploy or self.node or self.language or self.set_)


def new(
    what: Annotated[
        str,
        typer.Argument(metavar="KIND", help="Kind of template: controller, arm or participant."),
    ],
    name: Annotated[
        str,
        typer.Argument(help="Name of the files, a Python identifier; of a folder (participant)."),
    ],
    arm: ArmOptions,
    participant: ParticipantOptions,
    dir_: Annotated[Path, typer.Option("--dir", help="Folder to write into.")] = Path("."),
) -> None:
    """Write files to start from: for your controller, your arm, or your own node.

    cosim new controller my_law: a controller in Python on a planar arm.
    cosim new arm my_arm --urdf arm.urdf: two arms of the file, coupled over a network.
    cosim new participant mine --scenario FILE --node NODE: a program in place of a node's process.
    """
    from cosim.base.errors import ScenarioError

    if what not in KINDS:
        expected = ", ".join(KINDS[:-1])
        raise ScenarioError(
            f"{what!r} is not a kind of template; expected {expected} or {KINDS[-1]}", "cosim new"
        )
    if what != "arm" and arm.given():
        raise ScenarioError("--urdf, --base, --tip and --fixed are for an arm", "cosim new")
    if what != "participant" and participant.given():
        raise ScenarioError(
            "--scenario, --deploy, --node, --language and --set are for a participant", "cosim new"
        )
    if what == "participant":
        _participant(name, participant, dir_)
        return
    if what == "arm" and arm.urdf is None:
        raise ScenarioError("an arm needs its URDF file; expected --urdf FILE", "cosim new")
    _scenario(name, arm, dir_)


def _scenario(name: str, arm: ArmOptions, folder: Path) -> None:
    """A controller, or an arm if it has a URDF file."""
    from bridge.scaffold import write_arm, write_controller

    missing = ""
    if arm.urdf is None:
        paths = write_controller(name, folder)
    else:
        paths, missing = write_arm(name, arm.urdf, folder, arm.base, arm.tip, _held(arm.fixed))
    for path in paths:
        typer.echo(str(path))
    if missing:
        typer.echo(f"no deployment was written: {missing}")
    where = "" if folder == Path(".") else f"cd {folder} && "
    typer.echo(f"run it:       {where}cosim run {name}.toml")
    if not missing:
        typer.echo(f"rehearse it:  {where}cosim rehearse {name}.toml")
    typer.echo(f"test it:      {where}pytest test_{name}.py")


def _participant(name: str, options: ParticipantOptions, folder: Path) -> None:
    """A folder with the sources and tables of one node."""
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system
    from bridge.sdk import write_participant
    from cosim.base.errors import ScenarioError

    if options.scenario is None or not options.node:
        raise ScenarioError(
            "a participant replaces a node of a deployment; expected --scenario FILE --node NODE",
            "cosim new",
        )
    path = deployments.find(options.scenario, options.deploy)
    system = load_system(options.scenario, str(path), options.set_)
    written = write_participant(system, options.node, options.language or "c", folder / name)
    for found in written.paths:
        typer.echo(str(found))
    if written.build:
        typer.echo(f"build it:     cd {folder / name} && {written.build}")
    rehearsed = f"cosim rehearse {options.scenario} --deploy {path}"
    typer.echo(f"rehearse it:  {rehearsed} --outside {options.node}='{written.start}'")


def _held(given: Sequence[str]) -> dict[str, float | str]:
    """The values at which joints are held: numbers, or texts with a unit. Raises ScenarioError."""
    from cosim.base.errors import ScenarioError

    found: dict[str, float | str] = {}
    for text in given:
        joint, equals, value = text.partition("=")
        if not (joint and equals):
            raise ScenarioError(f"found {text!r}, expected JOINT=VALUE", "--fixed")
        found[joint] = _plain(value)
    return found


def _plain(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
