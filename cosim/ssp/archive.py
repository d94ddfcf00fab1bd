"""The folder of a ``.ssp`` file, unpacked once per content: the cache is keyed by the SHA-256."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote, urlsplit

from cosim.base import archive
from cosim.base.errors import ScenarioError

#: The description every archive holds (SSP 1.0, clause 3).
ROOT = "SystemStructure.ssd"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date a ZIP archive knows


def unpack(path: str | Path) -> Path:
    """The folder an SSP is unpacked into, from the cache where it is there already.

    Raises ScenarioError for one that cannot be unpacked: see :func:`cosim.base.archive.unpack`.
    """
    try:
        return archive.unpack(Path(path), "SSP", ROOT, "ssp")[0]
    except archive.ArchiveError as error:
        raise ScenarioError(str(error), str(path)) from None


def archive_member(folder: Path, source: str, place: str, base: str = "") -> Path:
    """The file that a URI relative to `base` names. Raises ScenarioError at `place`."""
    uri = urlsplit(source)
    if uri.scheme or uri.netloc:
        raise ScenarioError(
            f"source {source!r} is not in the archive; expected a path in it", place
        )
    path = (folder / base / unquote(uri.path)).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ScenarioError(f"source {source!r} leads out of the archive", place)
    if not path.is_file():
        raise ScenarioError(f"the archive holds no {source!r}", place)
    return path


def pack(content: Mapping[str, bytes], out: Path) -> None:
    """Write a ZIP archive of exactly these entries, in one step.

    Raises ScenarioError if it cannot be written.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            packed.writestr(entry, content[name])
    scratch = out.with_name(f".{out.name}.part")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(buffer.getvalue())
        os.replace(scratch, out)
    except OSError as error:
        raise ScenarioError(f"cannot be written: {error.strerror}", str(out)) from None
