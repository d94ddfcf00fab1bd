"""``cosim new``: files to start from, which run as they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

KINDS = ("controller", "arm")


def new(
    what: Annotated[
        str, typer.Argument(metavar="KIND", help="Kind of template: controller or arm.")
    ],
    name: Annotated[str, typer.Argument(help="Name of the files, a Python identifier.")],
    urdf: Annotated[Path | None, typer.Option(help="For an arm: its URDF file.")] = None,
    base: Annotated[
        str, typer.Option(help="Link where the arm begins.", show_default="the root of the file")
    ] = "",
    tip: Annotated[
        str, typer.Option(help="Link where the arm ends.", show_default="the only end")
    ] = "",
    fixed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=VALUE",
            help="Joint of the arm that is held at a value, rad or m; repeatable.",
        ),
    ] = None,
    dir_: Annotated[Path, typer.Option("--dir", help="Folder to write into.")] = Path("."),
) -> None:
    """Write a scenario, its rehearsal and a test: for your controller or your arm.

    cosim new controller my_law: a controller in Python on a planar arm.
    cosim new arm my_arm --urdf arm.urdf: two arms of the file, coupled over a network.
    """
    from bridge.scaffold import write_arm, write_controller
    from cosim.base.errors import ScenarioError

    if what not in KINDS:
        expected = " or ".join(KINDS)
        raise ScenarioError(f"{what!r} is not a kind of template; expected {expected}", "cosim new")
    if what == "arm" and urdf is None:
        raise ScenarioError("an arm needs its URDF file; expected --urdf FILE", "cosim new")
    if what == "controller" and (urdf or base or tip or fixed):
        raise ScenarioError("--urdf, --base, --tip and --fixed are for an arm", "cosim new")
    missing = ""
    if urdf is None:
        paths = write_controller(name, dir_)
    else:
        paths, missing = write_arm(name, urdf, dir_, base, tip, _held(fixed or []))
    for path in paths:
        typer.echo(str(path))
    if missing:
        typer.echo(f"no deployment was written: {missing}")
    where = "" if dir_ == Path(".") else f"cd {dir_} && "
    typer.echo(f"run it:       {where}cosim run {name}.toml")
    if not missing:
        typer.echo(f"rehearse it:  {where}cosim rehearse {name}.toml")
    typer.echo(f"test it:      {where}pytest test_{name}.py")


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
