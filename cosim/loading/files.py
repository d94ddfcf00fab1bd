"""Scenarios read from files: TOML, or the SSP of another tool."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.base import toml
from cosim.base.errors import ScenarioError
from cosim.base.settings import change
from cosim.scenario.spec import Scenario, build


def load(path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Read a scenario, TOML or SSP, and apply ``path=value`` settings. Raises ScenarioError."""
    path = Path(path)
    if path.suffix == ".ssp":
        from cosim import ssp

        return ssp.load(path, settings)
    document = read_document(path)
    for setting in settings:
        change(document, setting)
    return build(document, path)


def read_document(path: str | Path) -> dict[str, Any]:
    """A TOML file, parsed; an SSP in the same words. Raises ScenarioError."""
    path = Path(path)
    if path.suffix == ".fmu":
        raise ScenarioError(
            f"{path}: an FMU is not a scenario; expected a file (.toml, .ssp) that uses it as the "
            f"model of a component (cosim info {path.name} describes it)"
        )
    if path.suffix == ".ssp":
        from cosim.ssp.document import document

        return document(path)
    return toml.read(path)
