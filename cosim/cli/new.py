"""``cosim new``: files to start from, which run as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def new(
    what: Annotated[
        str, typer.Argument(metavar="controller", help="Kind of template: controller.")
    ],
    name: Annotated[str, typer.Argument(help="Name of the component, a Python identifier.")],
    dir_: Annotated[Path, typer.Option("--dir", help="Folder to write into.")] = Path("."),
) -> None:
    """Write a controller in Python, a scenario it runs in, and a test."""
    from cosim.base.errors import ScenarioError
    from cosim.scaffold import write_controller

    if what != "controller":
        raise ScenarioError(f"{what!r} is not a kind of template; expected controller", "cosim new")
    for path in write_controller(name, dir_):
        typer.echo(str(path))
    where = "" if dir_ == Path(".") else f"cd {dir_} && "
    typer.echo(f"run it: {where}cosim run {name}.toml    test it: {where}pytest test_{name}.py")
