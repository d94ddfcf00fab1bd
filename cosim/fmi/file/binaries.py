"""The shared library of an FMU for this platform: shipped with it, or compiled from its sources.

The loader of Linux maps a library that is not whole, and crashes: :func:`missing_bytes` tells.
"""

from __future__ import annotations

import platform
import shutil
import struct
import sys
from pathlib import Path

from cosim.base.errors import FmuError
from cosim.base.extras import require
from cosim.fmi.file.archive import Archive

#: The folder of WebAssembly binaries (FMI Layered Standard for WebAssembly, a draft of 2026).
WASM_FOLDER = "wasm32-wasip2"
_MACHINE = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
_SYSTEM = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}


def binary(fmu: Archive, fmi: str, identifier: str, build: bool = False) -> Path:
    """The shared library of this platform, compiled from the FMU's sources if `build` is set; else
    the WebAssembly component of an FMU of FMI 3.0.

    Raises FmuError naming the platforms there are.
    """
    path = _library(fmu, fmi, identifier)
    if path.is_file():
        return path
    if build and has_sources(fmu):
        from cosim.fmi.file.sources import compile_sources

        return compile_sources(fmu, fmi, identifier, path)
    if fmi == "3.0" and wasm(fmu, identifier) is not None:
        return sandboxed(fmu, identifier)
    sources = " (it holds sources, which could be built: build = true)"
    raise FmuError(
        f"{fmu.path}: no binary for this platform: expected binaries/{path.parent.name}/"
        f"{path.name}; platforms in the FMU: {_platforms(fmu)}"
        f"{sources if has_sources(fmu) else ''}"
    )


def _platforms(fmu: Archive) -> str:
    found = sorted(p.name for p in (fmu.folder / "binaries").glob("*") if p.is_dir())
    return ", ".join(found) if found else "none"


def _library(fmu: Archive, fmi: str, identifier: str) -> Path:
    folder, suffix = platform_folder(fmi)
    return fmu.folder / "binaries" / folder / f"{identifier}{suffix}"


def is_sandboxed(library: Path) -> bool:
    """True if a binary is WebAssembly, which runs in a sandbox on any platform."""
    return library.suffix == ".wasm"


def wasm(fmu: Archive, identifier: str) -> Path | None:
    """The WebAssembly component of an FMU; None: it has none."""
    path = fmu.folder / "binaries" / WASM_FOLDER / f"{identifier}.wasm"
    return path if path.is_file() else None


def sandboxed(fmu: Archive, identifier: str) -> Path:
    """The WebAssembly component of an FMU. Raises FmuError where there is none, ScenarioError where
    the extra is missing that runs it.
    """
    path = wasm(fmu, identifier)
    if path is None:
        raise FmuError(
            f'{fmu.path}: isolate = "wasm" found no binaries/{WASM_FOLDER}/{identifier}.wasm; '
            f"platforms in the FMU: {_platforms(fmu)}; `fmus build --wasm` makes one of FMI 3.0"
        )
    require("wasmtime")
    return path


def shipped(fmu: Archive, fmi: str, identifier: str) -> bool:
    """True if the FMU contains a shared library for this platform, or one was compiled from it."""
    return _library(fmu, fmi, identifier).is_file()


def copied(library: Path, folder: Path) -> Path:
    """A copy of a shared library in an empty folder, with all that is beside it in the FMU:
    libraries that it finds by its own place, and resources.
    """
    platform = library.parent
    for place, kept in ((folder, platform.parent.parent), (folder / "binaries", platform.parent)):
        place.mkdir(exist_ok=True)
        for entry in kept.iterdir():
            if entry not in (platform, platform.parent):
                _link(entry, place / entry.name)
    target = folder / "binaries" / platform.name
    target.mkdir()
    for entry in platform.iterdir():
        if entry != library:
            _link(entry, target / entry.name)
    return Path(shutil.copy2(library, target))


def _link(entry: Path, place: Path) -> None:
    """Have a file or folder in a second place: by a link, or as a copy where links need a right."""
    try:
        place.symlink_to(entry, target_is_directory=entry.is_dir())
    except OSError:
        (shutil.copytree if entry.is_dir() else shutil.copy2)(entry, place)


def platform_folder(fmi: str) -> tuple[str, str]:
    """This platform as a version of FMI calls it, and the suffix of its shared libraries."""
    system, suffix = _SYSTEM.get(sys.platform, (sys.platform, ".so"))
    machine = _MACHINE.get(platform.machine().lower(), platform.machine().lower())
    if fmi != "3.0":
        bits = "64" if sys.maxsize > 2**32 else "32"
        old = {"linux": "linux", "darwin": "darwin", "windows": "win"}.get(system, system)
        return old + bits, suffix
    return f"{machine}-{system}", suffix


def has_sources(fmu: Archive) -> bool:
    """True if there is C to compile."""
    return any(
        path.suffix in (".c", ".cc", ".cpp", ".cxx") or path.name == "buildDescription.xml"
        for path in (fmu.folder / "sources").rglob("*")
    )


#: ELF-64, little-endian: file header up to e_phnum; program header type, offset, size in the file.
_HEADER, _SEGMENT = struct.Struct("<16x16xQQ4x2xHH"), struct.Struct("<I4xQ16xQ16x")
_MAGIC, _LOADED = b"\x7fELF\x02\x01", 1


def missing_bytes(path: Path) -> int:
    """Number of bytes that the segments of a library need beyond its end; 0 for other files."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
        if not header.startswith(_MAGIC):
            return 0
        if len(header) < _HEADER.size:
            return _HEADER.size - len(header)
        table, _, entry, n = _HEADER.unpack(header)
        file.seek(table)
        data = file.read(entry * n)
    if len(data) < entry * n or entry < _SEGMENT.size:
        return entry * n - len(data) or 1
    segments = (_SEGMENT.unpack_from(data, i * entry) for i in range(n))
    ends: list[int] = [at + length for kind, at, length in segments if kind == _LOADED]
    return max(0, *ends, size) - size
