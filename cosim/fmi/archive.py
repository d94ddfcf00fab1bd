"""From an ``.fmu`` file to a folder, once per content: the cache is keyed by the SHA-256."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from cosim.errors import FmuError


@dataclass(frozen=True, slots=True)
class Archive:
    """An unpacked FMU: where it came from, where it lies, and what it hashes to."""

    path: Path
    folder: Path
    sha256: str


def cache_folder() -> Path:
    """Where unpacked FMUs are kept: ``$XDG_CACHE_HOME/cosim`` or ``~/.cache/cosim``."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "cosim"


def unpack(path: Path) -> Archive:
    """Unpack an FMU into the cache unless it is there already.

    Raises FmuError for a missing file, one that is no ZIP archive or is damaged, an archive
    without ``modelDescription.xml``, and entries that would leave the folder.
    """
    if not path.exists():
        raise FmuError(f"{path}: no such file")
    if not path.is_file():
        raise FmuError(f"{path}: is a folder; expected an .fmu file")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    folder = cache_folder() / "unpacked" / sha256[:32]
    if not folder.is_dir():
        _extract(path, folder)
    return Archive(path, folder, sha256)


def _extract(path: Path, folder: Path) -> None:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=folder.parent))
    except OSError as error:
        raise FmuError(f"{path}: cannot unpack into {folder.parent}: {error}") from error
    try:
        with zipfile.ZipFile(path) as archive:
            _check(path, archive)
            archive.extractall(scratch)
        scratch.rename(folder)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        if folder.is_dir():  # another process was faster
            return
        if isinstance(error, FmuError):
            raise
        raise FmuError(f"{path}: not a readable FMU (ZIP archive): {error}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


#: Bytes an FMU may unpack to, and its model description may have.
LARGEST, LARGEST_DESCRIPTION = 8 << 30, 256 << 20


def _check(path: Path, archive: zipfile.ZipFile) -> None:
    names = archive.namelist()
    size = sum(entry.file_size for entry in archive.infolist())
    if size > LARGEST:
        raise FmuError(f"{path}: would unpack to {size} bytes; expected at most {LARGEST}")
    if "modelDescription.xml" not in names:
        raise FmuError(f"{path}: the archive holds no modelDescription.xml; is it an FMU?")
    size = archive.getinfo("modelDescription.xml").file_size
    if size > LARGEST_DESCRIPTION:
        raise FmuError(
            f"{path}: modelDescription.xml has {size} bytes; expected at most {LARGEST_DESCRIPTION}"
        )
    for name in names:
        parts = PurePosixPath(name.replace("\\", "/"))
        if parts.is_absolute() or ".." in parts.parts:
            raise FmuError(f"{path}: entry {name!r} would be written outside of the folder")


_MACHINE = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
_SYSTEM = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}


def binary(archive: Archive, fmi: str, identifier: str, build: bool = False) -> Path:
    """The shared library of this platform, compiled from the FMU's sources if `build` is set.

    Raises FmuError naming the platforms there are.
    """
    folder, suffix = platform_folder(fmi)
    path = archive.folder / "binaries" / folder / f"{identifier}{suffix}"
    if path.is_file():
        return path
    if build and has_sources(archive):
        from cosim.fmi.sources import compile_sources

        return compile_sources(archive, fmi, identifier, path)
    found = sorted(p.name for p in (archive.folder / "binaries").glob("*") if p.is_dir())
    sources = " (it holds sources, which could be built: build = true)"
    there = ", ".join(found) if found else "none"
    raise FmuError(
        f"{archive.path}: no binary for this platform: expected binaries/{folder}/"
        f"{identifier}{suffix}; platforms in the FMU: {there}"
        f"{sources if has_sources(archive) else ''}"
    )


def platform_folder(fmi: str) -> tuple[str, str]:
    """This platform as a version of FMI calls it, and the suffix of its shared libraries."""
    system, suffix = _SYSTEM.get(sys.platform, (sys.platform, ".so"))
    machine = _MACHINE.get(platform.machine().lower(), platform.machine().lower())
    if fmi == "2.0":
        bits = "64" if sys.maxsize > 2**32 else "32"
        old = {"linux": "linux", "darwin": "darwin", "windows": "win"}.get(system, system)
        return old + bits, suffix
    return f"{machine}-{system}", suffix


def has_sources(archive: Archive) -> bool:
    """Whether there is C to compile."""
    return any((archive.folder / "sources").glob("*.c"))
