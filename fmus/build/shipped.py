"""FMUs of the installation, found without the builder, which makes commands start faster.

``built.json`` next to them records their inputs: a digest of the sources, and the declaration of
each model. If both are unchanged, the FMU is that of the model.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmus.model import Model

PACKAGE = Path(__file__).parents[1]
FOLDER = PACKAGE / "_built"
STAMP = "built.json"


def file_name(model: Model, version: str) -> str:
    """``planar2r.fmi2.fmu``."""
    return f"{model.identifier}.fmi{version[0]}.fmu"


def shipped(model: Model, version: str) -> Path | None:
    """The FMU of `model` of the installation; None if none was built from it as it is now."""
    name = file_name(model, version)
    if _declarations(FOLDER).get(name) != _declaration(model):
        return None
    return FOLDER / name if (FOLDER / name).is_file() else None


def index(built: Iterable[tuple[Model, str]]) -> dict[str, object]:
    """The content of ``built.json`` for FMUs built now, each a model and a version of FMI."""
    declarations = {file_name(*each): _declaration(each[0]) for each in built}
    return {"sources": sources_digest(), "declarations": declarations}


def _declaration(model: Model) -> str:
    """SHA-256 of a declaration, as a hexadecimal number."""
    return hashlib.sha256(repr(model).encode()).hexdigest()


def made_from() -> list[Path]:
    """The files that FMUs are made from: generator, models and C sources."""
    base = PACKAGE.parent / "cosim" / "base"
    rooms = ("model", "build", "arms", "models")
    sources = (path for room in rooms for path in PACKAGE.glob(f"{room}/*.py"))
    files = (PACKAGE / "__init__.py", *sources, *PACKAGE.glob("c/*.[ch]"))
    return sorted((*files, base / "errors.py", base / "units.py"))


def sources_digest() -> str:
    """SHA-256 of the names and contents of :func:`made_from`, as a hexadecimal number."""
    digest = hashlib.sha256()
    for path in made_from():
        digest.update(f"{path.parent.name}/{path.name}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


@cache
def _declarations(folder: Path) -> dict[str, str]:
    """The declarations of the FMUs in `folder` by file; none if the sources changed since."""
    try:
        stamp = json.loads((folder / STAMP).read_bytes())
    except (OSError, ValueError):
        return {}
    found: dict[str, str] = stamp.get("declarations", {})
    return found if stamp.get("sources") == sources_digest() else {}
