"""``cosim export --deploy --nodes``: the nodes of a deployment as network FMUs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer


def write(
    scenario: Path,
    deploy: str,
    folder: Path,
    names: Sequence[str],
    settings: Sequence[str],
    platforms: str,
) -> None:
    """Write ``FOLDER/NODE.fmu`` of the nodes `names`, of all where there is none, and what they
    leave out.

    `platforms`: separated by commas; "": the host's. Raises ScenarioError for a node that cannot be
    a network FMU.
    """
    from bridge.deployment.system import load_system
    from bridge.export.node_fmu import export_nodes, notes

    system = load_system(scenario, deploy, settings)
    chosen = list(dict.fromkeys(names)) or list(system.nodes)
    asked = [name.strip() for name in platforms.split(",") if name.strip()]
    found: dict[str, list[str]] = {}
    for name, path in zip(chosen, export_nodes(system, chosen, folder, asked), strict=True):
        components = ", ".join(c.name for c in system.nodes[name].plan.components)
        terminals = ", ".join(system.buses_of(name))
        typer.echo(f"{path}  FMI 3.0, CAN terminal {terminals}, with {components}")
        for note in notes(system, name):
            found.setdefault(note, []).append(name)
    for note, of in found.items():
        typer.echo(f"note: {', '.join(of)}: {note}")
