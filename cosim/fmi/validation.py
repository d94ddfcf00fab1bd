"""Checks an FMU against schema and rules with FMPy (imported here only)."""

from __future__ import annotations

from pathlib import Path


def problems(path: str | Path) -> list[str]:
    """What FMPy finds wrong with an FMU; empty when nothing is."""
    path = Path(path)
    from fmpy.validation import validate_fmu

    return [str(p) for p in validate_fmu(str(path))]
