"""Scenarios read from files: TOML, the SSP of another tool, or an FMU alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.base import toml
from cosim.base.errors import ScenarioError
from cosim.base.toml import change
from cosim.loading import file_kinds
from cosim.scenario.spec import Scenario, build


def load(
    path: str | Path, settings: Sequence[str] = (), table: str | Path | None = None
) -> Scenario:
    """Read a scenario, TOML, SSP or FMU, and apply ``path=value`` settings.

    `table`: a file with columns for the inputs of an FMU. Raises ScenarioError, FmuError.
    """
    path = Path(path)
    if table is not None and path.suffix != ".fmu":
        raise ScenarioError(
            "--input is for a single FMU; in a scenario, an input is fed by"
            ' components.NAME.inputs.INPUT = { table = "FILE" }',
            str(path),
        )
    if path.suffix == ".ssp":
        from cosim import ssp

        return ssp.load(path, settings)
    if path.suffix == ".fmu":
        from cosim.loading import one_fmu

        return build(one_fmu.document(path, settings, table), path)
    document = read_document(path)
    if other := file_kinds.of_document(document, path):
        raise ScenarioError(other, str(path))
    for setting in settings:
        change(document, setting)
    return build(document, path)


def read_document(path: str | Path) -> dict[str, Any]:
    """A TOML file, parsed; an SSP or an FMU in the same words.

    Raises ScenarioError for a file of another kind, CosimError for one that cannot be read.
    """
    path = Path(path)
    if path.suffix == ".fmu":
        from cosim.loading import one_fmu

        return one_fmu.document(path)
    if path.suffix == ".ssp":
        from cosim.ssp.document import document

        return document(path)
    if other := file_kinds.of_path(path):
        raise ScenarioError(other, str(path))
    return toml.read(path)
