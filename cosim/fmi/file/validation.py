"""Checks an FMU against schema and rules with FMPy (imported here only)."""

from __future__ import annotations

from pathlib import Path


def problems(path: str | Path) -> list[str]:
    """Problems that FMPy finds in an FMU; empty if there are none."""
    path = Path(path)
    from fmpy.validation import validate_fmu

    return [str(p) for p in validate_fmu(str(path))]
