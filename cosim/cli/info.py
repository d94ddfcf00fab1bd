"""``cosim info``: what an FMU is, can do, and needs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cosim.fmi.component import FmuComponent


def info(
    fmu: Annotated[Path, typer.Argument(help="FMU file (.fmu).")],
    validate: Annotated[
        bool, typer.Option("--validate/--no-validate", help="Check it with FMPy as well.")
    ] = True,
) -> None:
    """Print an FMU's variables, units, capabilities and platforms, and validate it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from cosim.fmi import FmuComponent

    component = FmuComponent(fmu)
    console = Console(highlight=False, soft_wrap=True)
    for key, value in _facts(component):
        console.print(f"{key:<14} {value}", markup=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("signal", "causality", "type", "shape", "unit", "start", "description"):
        table.add_column(column, overflow="fold")
    for group in component.groups.values():
        v = group.first
        shape = ",".join(str(n) for n in group.shape)
        table.add_row(
            group.name, v.causality, v.type, shape, v.unit, " ".join(group.start), v.description
        )
    console.print(table)
    if validate:
        _validate(fmu, console.print)


def _facts(component: FmuComponent) -> list[tuple[str, str]]:
    d = component.description
    binaries = component.archive.folder / "binaries"
    platforms = sorted(p.name for p in binaries.glob("*") if p.is_dir())
    flags = sorted(name for name, on in d.flags.items() if on)
    return [
        ("model", f"{d.name} - {d.description}" if d.description else d.name),
        ("FMI", f"{d.fmi} co-simulation"),
        ("kind", component.kind + ("" if d.kind else " (assumed; set `kind` in the scenario)")),
        ("token", d.token),
        ("made by", d.tool or "unknown"),
        ("sha256", component.archive.sha256),
        ("platforms", ", ".join(platforms) or "none"),
        ("step", f"{d.default_step:g} s" if d.default_step else "not stated"),
        ("capabilities", ", ".join(flags) or "none"),
    ]


def _validate(fmu: Path, say: object) -> None:
    from cosim.errors import FmuError
    from cosim.fmi.validation import problems

    found = problems(fmu)
    if found:
        listing = "\n".join(f"  - {p}" for p in found)
        raise FmuError(f"{fmu}: FMPy found {len(found)} problem(s):\n{listing}")
    assert callable(say)
    say("validation     no problems found (FMPy)")
