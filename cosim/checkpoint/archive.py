"""A checkpoint as a file: a line that names the format, a header in JSON, bytes, and a sum.

A file is on the disk before it takes its name, and the one before it keeps another name. So a
process that is killed, or a machine that loses its power, leaves a valid one at any moment.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base.errors import RunError, ScenarioError
from cosim.record.folder import reason

LATEST, PREVIOUS = "latest", "previous"
_MAGIC = b"cosim checkpoint 2\n"
_PART = "latest.part"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The content of a file: `facts` of JSON, and bytes by name."""

    facts: Mapping[str, Any]
    blobs: Mapping[str, bytes]


def write(folder: Path, found: Checkpoint) -> int:
    """Write the latest checkpoint; the one before becomes the previous one. The bytes written.

    Raises RunError with the path.
    """
    sizes = [[name, len(data)] for name, data in found.blobs.items()]
    header = json.dumps({**found.facts, "blobs": sizes}, sort_keys=True).encode()
    pieces = [_MAGIC, len(header).to_bytes(8, "little"), header, *found.blobs.values()]
    total = hashlib.sha256()
    for piece in pieces:
        total.update(piece)
    store(folder, (*pieces, total.digest()))
    return sum(map(len, pieces)) + total.digest_size


def store(folder: Path, pieces: Iterable[bytes]) -> None:
    """Write the bytes of a file as the latest checkpoint. Raises RunError with the path."""
    part, latest = folder / _PART, folder / LATEST
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.writelines(pieces)
            file.flush()
            os.fsync(file.fileno())
        if latest.exists():
            latest.replace(folder / PREVIOUS)
        part.replace(latest)
        sync(folder)
    except OSError as error:
        raise RunError(f"cannot write {latest}: {reason(error)}") from error


def sync(folder: Path) -> None:
    """Bring the names in a folder to the disk. Raises OSError."""
    if os.name == "posix":
        place = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(place)
        finally:
            os.close(place)


def read(path: Path) -> Checkpoint:
    """The checkpoint in a file. Raises ScenarioError for one that is damaged."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError(f"cannot be read: {reason(error)}", str(path)) from error
    start = len(_MAGIC) + 8
    whole = memoryview(data)[:-32]
    if not data.startswith(_MAGIC):
        raise ScenarioError(
            f"begins with {data[: len(_MAGIC)]!r}; expected a checkpoint of this version", str(path)
        )
    if hashlib.sha256(whole).digest() != data[-32:]:
        raise ScenarioError("is damaged: its SHA-256 sum is another one", str(path))
    at = start + int.from_bytes(data[start - 8 : start], "little")
    facts = json.loads(data[start:at])
    blobs = {}
    for name, size in facts.pop("blobs"):
        blobs[name], at = data[at : at + size], at + size
    return Checkpoint(facts, blobs)
