"""``cosim keys``: certificates for trying mutual TLS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def keys(
    nodes: Annotated[
        list[str], typer.Argument(help="Names: the nodes, and others such as operator or router.")
    ],
    folder: Annotated[
        Path, typer.Option("--folder", help="Folder for the keys and certificates.")
    ] = Path("keys"),
    host: Annotated[
        list[str] | None,
        typer.Option("--host", help="Host name or address that nodes listen on; repeatable."),
    ] = None,
    days: Annotated[
        int, typer.Option("--days", min=1, help="Validity of the certificates, days.")
    ] = 365,
) -> None:
    """Create a test authority and one certificate per node, for configs/zenoh/secure.json5."""
    from bridge.zenoh.certificates import HOSTS, make_keys
    from cosim.base.errors import ScenarioError
    from cosim.loading.file_kinds import use

    for name in nodes:
        if (kind := use(Path(name))) or name.endswith(".toml"):
            found = f"{name}, which {kind}" if kind else f"{name}, the name of a file"
            raise ScenarioError(f"found {found}; expected names of nodes: master slave", "NODES")
    for path in make_keys(folder, nodes, tuple(host) if host else HOSTS, days):
        typer.echo(str(path))
    typer.echo(f"keep {folder / 'ca.key'} away from machines that run nodes")
