"""The kind of a file that was given for a scenario, and the command that it is for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: Keys at the top that only files of one kind have: what such a file is, and its use.
_KEYS = {
    "fault": ("a fault script", "cosim rehearse SCENARIO --faults {path}"),
    "vary": ("a study", "cosim sweep {path}"),
    "sample": ("a study", "cosim sweep {path}"),
    "nodes": ("a deployment", "cosim rehearse SCENARIO --deploy {path}"),
    "controllers": ("a file of variants", "cosim compare SCENARIO --variants {path}"),
    "columns": ("a file of variants", "cosim compare SCENARIO --variants {path}"),
}
_SUFFIXES = {
    ".dbc": ("a DBC file", "dbc in a bus of a deployment, or `cosim bus --load {path}`"),
    ".py": ("a Python file", 'model = "MODULE:CLASS" in a component, or `python {path}`'),
    ".urdf": ("a robot", "`cosim new arm NAME --urdf {path}`"),
    ".parquet": ("a table", "`cosim run X.fmu --input {path}`"),
    ".csv": ("a table", "`cosim run X.fmu --input {path}`"),
    ".ssd": (
        "a description inside of an SSP",
        "its archive (`zip -r ../system.ssp .` in its folder)",
    ),
    ".log": ("a bus log", "`cosim replay --from-log {path}`"),
}


def of_path(path: Path) -> str:
    """The kind of a path that is no scenario, as a sentence with its use; "": not known."""
    if (path / "run.json").is_file():
        return _sentence(
            path, "the folder of a run", "`cosim report {path}` or `cosim show {path}`"
        )
    if path.suffix in _SUFFIXES and path.is_file():
        return _sentence(path, *_SUFFIXES[path.suffix])
    return ""


def of_document(document: Mapping[str, Any], path: Path) -> str:
    """The kind of a TOML document that is no scenario; "": not known."""
    if "components" in document:
        return ""
    found = next((_KEYS[key] for key in _KEYS if key in document), None)
    if found is None and isinstance(document.get("run"), list):
        found = ("a campaign", "cosim campaign {path}")
    return "" if found is None else _sentence(path, found[0], f"`{found[1]}`")


def _sentence(path: Path, what: str, use: str) -> str:
    return f"is {what}, not a scenario; it is for {use.format(path=path)}"
