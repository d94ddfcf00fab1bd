"""Kinds of files and folders, the command that each is for, and what a command expects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

#: Keys at the top that only files of one kind have: what such a file is, and its use. A file with
#: `components` is a scenario, whatever else it has.
_KEYS = {
    "components": ("a scenario", "`cosim run {path}`"),
    "fault": ("a fault script", "`cosim rehearse SCENARIO --faults {path}`"),
    "vary": ("a study", "`cosim sweep {path}`"),
    "sample": ("a study", "`cosim sweep {path}`"),
    "nodes": ("a deployment", "`cosim rehearse SCENARIO --deploy {path}`"),
    "controllers": ("a file of variants", "`cosim compare SCENARIO --variants {path}`"),
    "columns": ("a file of variants", "`cosim compare SCENARIO --variants {path}`"),
}
_SUFFIXES = {
    ".fmu": ("an FMU", "`cosim info {path}` or `cosim run {path}`"),
    ".ssp": ("a scenario", "`cosim run {path}`"),
    ".dbc": ("a DBC file", "dbc in a bus of a deployment, or `cosim bus --load {path}`"),
    ".py": ("a Python file", 'model = "MODULE:CLASS" in a component, or `python {path}`'),
    ".urdf": ("a robot", "`cosim new arm NAME --urdf {path}`"),
    ".parquet": ("a table", "`cosim run X.fmu --input {path}`"),
    ".csv": ("a table", "`cosim run X.fmu --input {path}`"),
    ".ssd": (
        "a description inside of an SSP",
        "its archive (`zip -r ../system.ssp .` in its folder)",
    ),
    ".log": ("a bus log", "`cosim replay --from-log {path}` or `cosim delays from {path}`"),
    **dict.fromkeys(
        (".mcap", ".db3", ".pcap", ".pcapng", ".asc", ".blf"),
        ("a recording", "`cosim delays from {path}`"),
    ),
}
_RUN = ("the folder of a run", "`cosim report {path}` or `cosim show {path}`")
_CAMPAIGN = ("a campaign", "`cosim campaign {path}`")
#: The kinds that commands take as their first file, the one first that a message names.
_SCENARIO, _RUN_FOLDER = ("a scenario", "an FMU"), ("the folder of a run", "a table")
EXPECTED = {
    **dict.fromkeys(("run", "linearize", "fit"), _SCENARIO),
    "check": (*_SCENARIO, "a DBC file"),
    **dict.fromkeys(("compare", "rehearse", "soak"), _SCENARIO[:1]),
    "analyze": ("a scenario", "the folder of a run"),
    **dict.fromkeys(("report", "diff", "replay", "monitor"), _RUN_FOLDER),
    "export": ("a scenario", "the folder of a run"),
    "info": ("an FMU",),
    "sweep": ("a study",),
    "campaign": ("a campaign",),
}


def of_path(path: Path) -> str:
    """The kind of a path that is no scenario, as a sentence with its use; "": not known."""
    kind = _by_name(path)
    return "" if kind is None or kind[0] == "a scenario" else _sentence(path, *kind)


def of_document(document: Mapping[str, Any], path: Path) -> str:
    """The kind of a TOML document that is no scenario; "": not known."""
    kind = _by_keys(document)
    return "" if kind is None or kind[0] == "a scenario" else _sentence(path, *kind)


def misplaced(arguments: Sequence[str]) -> str:
    """The file that a failed command line gave to the wrong command, as a sentence; "" for none.

    `arguments`: the command and what follows it; the file is the argument behind the command.
    """
    if len(arguments) < 2 or arguments[0] not in EXPECTED:
        return ""
    (command, given), path = arguments[:2], Path(arguments[1])
    kind, expected = _kind(path), EXPECTED[command]
    if kind is None or kind[0] in expected:
        return ""
    return f"{given}: {_sentence(path, *kind, expected=expected[0])}"


def use(path: Path) -> str:
    """The command that a file or folder is for; "" where its kind is not known."""
    kind = _kind(path)
    return "" if kind is None else f"is {kind[0]}; it is for {kind[1].format(path=path)}"


def _kind(path: Path) -> tuple[str, str] | None:
    return _by_name(path) or _by_content(path)


def _by_name(path: Path) -> tuple[str, str] | None:
    if (path / "run.json").is_file():
        return _RUN
    return _SUFFIXES.get(path.suffix) if path.is_file() else None


def _by_content(path: Path) -> tuple[str, str] | None:
    from cosim.base import toml
    from cosim.base.errors import CosimError

    if path.suffix != ".toml" or not path.is_file():
        return None
    try:
        return _by_keys(toml.read(path))
    except CosimError:
        return None


def _by_keys(document: Mapping[str, Any]) -> tuple[str, str] | None:
    found = next((_KEYS[key] for key in _KEYS if key in document), None)
    return _CAMPAIGN if found is None and isinstance(document.get("run"), list) else found


def _sentence(path: Path, what: str, use: str, expected: str = "a scenario") -> str:
    return f"is {what}, not {expected}; it is for {use.format(path=path)}"
