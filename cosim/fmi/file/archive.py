"""The folder of an ``.fmu`` file, unpacked once per content: the cache is keyed by the SHA-256."""

from __future__ import annotations

from pathlib import Path

from cosim.base import archive
from cosim.base.convert import Struct
from cosim.base.errors import FmuError


class Archive(Struct, frozen=True):
    """An unpacked FMU: its source file, its folder and its hash."""

    path: Path
    folder: Path
    sha256: str


def unpack(path: str | Path) -> Archive:
    """Unpack an FMU into the cache unless it is there already.

    Raises FmuError for one that cannot be unpacked: see :func:`cosim.base.archive.unpack`.
    """
    path = Path(path)
    try:
        return Archive(path, *archive.unpack(path, "FMU", "modelDescription.xml", "unpacked"))
    except archive.ArchiveError as error:
        raise FmuError(f"{path}: {error}") from error
