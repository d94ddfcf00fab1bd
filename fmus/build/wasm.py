"""WebAssembly of the engine and of models, with which a page computes a run.

``cosim/_engine.wasm`` has the memory; each model is a library that is loaded into it, in the form
of the WebAssembly tool conventions (``DynamicLinking.md``): position-independent, with the section
``dylink.0``. Those of an installation are in one archive next to the FMUs, since they have most of
their bytes in common.
"""

from __future__ import annotations

import io
import lzma
import tarfile
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path, PurePosixPath

from fmus.build import toolchain
from fmus.build.archive import cache_folder
from fmus.build.library import compile_models
from fmus.build.shipped import FOLDER
from fmus.model import Model

#: The archive of the models of an installation.
ARCHIVE = "models.wasm.xz"
#: Functions of the C library that models call; those of the engine are in it anyway.
_LIBC = (
    *("calloc", "free", "malloc", "snprintf", "strcat", "strcmp", "strcpy", "strlen", "vsnprintf"),
    *("memcmp", "memcpy", "memmove", "memset", "strncmp", "strncpy"),
)


def engine(sources: Sequence[Path], output: Path, include: Sequence[Path]) -> Path:
    """Compile the engine of `sources` into `output`. Raises ToolchainError."""
    kept = ["__stack_pointer", *_LIBC]
    flags = ["-fno-PIC", "-mexec-model=reactor", "-s", "-Wl,--export-table", "-Wl,--growable-table"]
    flags += ["-Wl,--export-dynamic"]
    flags += [f"-Wl,--export={name}" for name in kept]
    return toolchain.compile_shared(
        sources, output, include=include, platform=toolchain.WEB, flags=flags
    )


def pack(models: Sequence[Model], target: Path) -> Path:
    """Compile models, and write the archive of their libraries. Raises ToolchainError."""
    built = compile_models(models, [toolchain.WEB])
    named = zip(models, built, strict=True)
    return _write({f"{m.identifier}.wasm": b[toolchain.WEB] for m, b in named}, target)


def _write(content: Mapping[str, bytes], target: Path) -> Path:
    """Write an archive that has the same bytes whenever the content is the same."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name, data in sorted(content.items()):
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    scratch = target.with_name(f".{target.name}")
    scratch.write_bytes(lzma.compress(packed.getvalue()))
    scratch.replace(target)
    return target


@cache
def _archive(folder: Path) -> dict[str, bytes]:
    """The libraries of the models of an installation, by file name; none if it has no archive."""
    if not (folder / ARCHIVE).is_file():
        return {}
    with tarfile.open(folder / ARCHIVE) as archive:
        files = {entry.name: archive.extractfile(entry) for entry in archive}
        return {name: file.read() for name, file in files.items() if file is not None}


def module(fmu: Path, token: str, *, build: bool = True) -> bytes | None:
    """The library of one of our own FMUs, None for another one's.

    `token`: of its description. Models that an installation does not bring are compiled from the
    sources in the FMU, once. Raises ToolchainError if that fails, or if it is needed without
    `build`, FmuError if the cache cannot be written.
    """
    name = f"{fmu.name.split('.')[0]}.wasm"
    if fmu.parent.resolve() == FOLDER.resolve() and name in _archive(FOLDER):
        return _archive(FOLDER)[name]
    with zipfile.ZipFile(fmu) as archive:
        names = [n for n in archive.namelist() if PurePosixPath(n).parent.name == "sources"]
        texts = {PurePosixPath(n).name: archive.read(n) for n in names}
    if token.encode() not in texts.get("variables.c", b""):
        return None
    found = cache_folder(token) / name
    if not found.is_file():
        if not build:
            raise toolchain.ToolchainError(f"{fmu.name} is not compiled to WebAssembly yet")
        with tempfile.TemporaryDirectory(prefix="fmu-") as scratch:
            for file, text in texts.items():
                Path(scratch, file).write_bytes(text)
            units = sorted(Path(scratch).glob("*.c"))
            toolchain.compile_shared(units, found, include=[scratch], platform=toolchain.WEB)
    return found.read_bytes()
