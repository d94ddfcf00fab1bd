"""From a ``.ssp`` file to a folder, once per content: the cache is keyed by the SHA-256."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from cosim.errors import ScenarioError
from cosim.fmi.archive import LARGEST, cache_folder

#: The description every archive holds (SSP 1.0, clause 3).
ROOT = "SystemStructure.ssd"
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date a ZIP archive knows


def unpack(path: Path) -> Path:
    """The folder an SSP is unpacked into, from the cache where it is there already.

    Raises ScenarioError for a missing file, one that is no ZIP archive or is damaged, an archive
    without ``SystemStructure.ssd``, one that is too large, and entries that would leave the folder.
    """
    if not path.is_file():
        raise ScenarioError("no such file" if not path.exists() else "is a folder", str(path))
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        folder = cache_folder() / "ssp" / digest[:32]
        if not folder.is_dir():
            _extract(path, folder)
    except OSError as error:
        raise ScenarioError(f"cannot be unpacked: {error}", str(path)) from None
    return folder


def _extract(path: Path, folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(dir=folder.parent))
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            archive.extractall(scratch)
        scratch.rename(folder)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        if not folder.is_dir():  # else another process was faster
            message = f"not a readable SSP (ZIP archive): {error}"
            raise ScenarioError(message, str(path)) from None
    except zipfile.zlib.error as error:  # type: ignore[attr-defined]
        raise ScenarioError(f"not a readable SSP (ZIP archive): {error}", str(path)) from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    size = sum(entry.file_size for entry in archive.infolist())
    if size > LARGEST:
        raise ScenarioError(f"would unpack to {size} bytes; expected at most {LARGEST}", str(path))
    if ROOT not in archive.namelist():
        raise ScenarioError(f"the archive holds no {ROOT}; is it an SSP?", str(path))
    for name in archive.namelist():
        parts = PurePosixPath(name.replace("\\", "/"))
        if parts.is_absolute() or ".." in parts.parts:
            raise ScenarioError(f"entry {name!r} would be written outside of the folder", str(path))


def inside(folder: Path, source: str, place: str) -> Path:
    """The file that a relative URI names in the archive. Raises ScenarioError at `place`."""
    uri = urlsplit(source)
    if uri.scheme or uri.netloc:
        raise ScenarioError(
            f"source {source!r} is not in the archive; expected a path in it", place
        )
    path = (folder / unquote(uri.path)).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ScenarioError(f"source {source!r} leads out of the archive", place)
    if not path.is_file():
        raise ScenarioError(f"the archive holds no {source!r}", place)
    return path


def pack(content: Mapping[str, bytes], out: Path) -> None:
    """A ZIP archive of these entries and nothing else; it appears at once, complete.

    Raises ScenarioError where it cannot be written.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content[name])
    scratch = out.with_name(f".{out.name}.part")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(buffer.getvalue())
        os.replace(scratch, out)
    except OSError as error:
        raise ScenarioError(f"cannot be written: {error.strerror}", str(out)) from None
