"""Writing the files of a template: all of them, or none where one exists."""

from __future__ import annotations

import keyword
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from bridge.can.link_dbc import common, fd, text
from cosim.base.errors import ScenarioError


def write_files(folder: Path, contents: Mapping[str, str]) -> list[Path]:
    """Write texts by their path in `folder`; return the paths written.

    Raises ScenarioError if one of the files exists, or cannot be written.
    """
    paths = {folder / name: text for name, text in contents.items()}
    for path in paths:
        if path.exists():
            raise ScenarioError("exists already; choose another name or --dir", str(path))
    try:
        for path, content in paths.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"cannot be written: {error.strerror}", str(folder)) from None
    return list(paths)


def check_name(name: str, what: str, example: str) -> None:
    """Raise ScenarioError for a name that is no Python identifier; `what` has this name."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise ScenarioError(f"{name!r} is not a valid name of {what}; expected e.g. {example}")
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        raise ScenarioError(f"{name!r} is a word of Python; expected another name, e.g. {example}")


def check_module_name(name: str, example: str) -> None:
    """Raise ScenarioError for a name that a new module cannot have.

    As of :func:`check_name`, or that of a module which Python finds elsewhere: an import would
    find one of the two, by the order of folders.
    """
    check_name(name, "a Python module", example)
    if name in _READ:
        raise ScenarioError(f"{name!r} is read by {_READ[name]}; expected e.g. {example}")
    if _is_module(name):
        raise ScenarioError(
            f"{name!r} is a Python module already, and the new file would be imported in its "
            f"place, or not at all; expected another name, e.g. {example}"
        )


#: Names of modules that programs look for.
_READ = {"conftest": "pytest", "setup": "installers", "sitecustomize": "Python at its start"}


def _is_module(name: str) -> bool:
    """True if Python finds a module of this name elsewhere than in the working directory."""
    from importlib.util import find_spec

    if name in sys.stdlib_module_names or name in sys.modules:
        return True
    spec = find_spec(name)
    if spec is None:
        return False
    places = [spec.origin] if spec.origin else list(spec.submodule_search_locations or ())
    return any(Path(place).absolute().parent != Path.cwd() for place in places)


def bus(name: str) -> str:
    """The table of the CAN FD bus of a template's deployment, with the DBC file `name`."""
    return f"""[buses.bench]
interface = "cosim"
channel = "bench"
bitrate = 1_000_000
data_bitrate = 5_000_000
fd = true
dbc = "../can/{name}.dbc"
"""


def dbc(joints: int, nodes: int, slides: Sequence[bool] = ()) -> str:
    """A DBC file for CAN FD: services, and LINK and STATE of so many joints for nodes 1, 2, ...

    `slides`: of each joint; () if all turn.
    """
    numbers = range(1, nodes + 1)
    messages = common(numbers) + fd(joints, numbers, slides)
    comment = f"CAN FD, {nodes} nodes, arms of {joints} joints."
    return text(messages, "CAN FD", comment, numbers, "cosim new")
