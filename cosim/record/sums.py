"""SHA-256 sums of the files of a run folder: whether one was altered since it was written.

``SHA256SUMS`` is written last, in the format of `sha256sum`, so that `sha256sum -c SHA256SUMS`
checks a folder as well. Files that were added later are not checked.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from warnings import warn

from cosim.base.errors import RunError, ScenarioError, Unverified
from cosim.base.files import write_file
from cosim.record.folder import METADATA, SUMS, reason

_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)\n")


def seal(folder: str | Path, *, anew: bool = False, changed: Iterable[str] = ()) -> None:
    """Write the sums of all files in `folder` and below it.

    Files that have a sum already keep it, so that a folder may be sealed again when figures have
    come into it; `anew`: every sum is computed; `changed`: names of files whose sum is. Raises
    RunError where a file cannot be read or the sums cannot be written, ScenarioError where there
    are sums that cannot be read.
    """
    folder = Path(folder)
    known = {} if anew or not (folder / SUMS).exists() else dict(_read(folder))
    for name in changed:
        known.pop(name, None)
    try:
        sums = {name: known.get(name) or _sum(folder / name) for name in _files(folder)}
    except OSError as error:
        raise RunError(f"cannot write {folder / SUMS}: {reason(error)}") from error
    text = "".join(f"{sums[name]}  {name}\n" for name in sorted(sums))
    write_file(folder / SUMS, text.encode())


def verify(folder: str | Path) -> None:
    """Raise ScenarioError naming a file that was changed or is missing.

    A folder without sums (of a run that is active, interrupted or recovered) gives the warning
    Unverified. A single file is looked up in the sums of its folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        return
    if not (folder / SUMS).exists():
        if (folder / METADATA).exists():  # else it is no run folder; its reader says so
            text = f"{folder}: no {SUMS}: whether files were altered cannot be told"
            warn(text, Unverified, stacklevel=2)
        return
    for name, expected in _read(folder).items():
        path = folder / name
        try:
            found = _sum(path)
        except OSError as error:
            raise ScenarioError(
                f"cannot be read: {reason(error)}; {SUMS} lists it (use --no-verify to continue)",
                str(path),
            ) from error
        if found != expected:
            raise ScenarioError(
                f"was altered after the run: SHA-256 {found[:12]}..., expected {expected[:12]}... "
                "(use --no-verify to continue)",
                str(path),
            )


def _files(folder: Path) -> list[str]:
    """Every file by its path in the folder, but the sums themselves and hidden ones."""
    found = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        inside = Path(place).relative_to(folder)
        found += [(inside / n).as_posix() for n in names if not n.startswith(".")]
    return [n for n in found if n != SUMS and not n.startswith(f"{SUMS}.")]


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read(folder: Path) -> dict[str, str]:
    """The sums by file. Raises ScenarioError for an invalid list of sums."""
    path = folder / SUMS
    try:
        text = path.read_bytes().decode()
    except (OSError, ValueError) as error:
        raise ScenarioError(
            f"cannot be read: {error} (use --no-verify to continue)", str(path)
        ) from error
    if _LINE.sub("", text):
        raise ScenarioError(
            "was altered: it is not a list of sums (use --no-verify to continue)", str(path)
        )
    return {name: found for found, name in _LINE.findall(text)}
