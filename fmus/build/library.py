"""Shared libraries of models: each C file is compiled once for all models that share it.

The FMI layer reads the properties of a model from tables (``fmus/c/declaration.h``). Only the
model's own C file and these tables include generated code; the objects of all other files are
linked into every library.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path
from typing import Any

from fmus.build import toolchain
from fmus.build.source import units
from fmus.model import Model


def compile_model(model: Model, platforms: Sequence[str] | None = None) -> dict[str, bytes]:
    """The shared library for each platform (default: the host's). Raises ToolchainError."""
    return compile_models([model], platforms)[0]


def compile_models(
    models: Sequence[Model], platforms: Sequence[str] | None = None
) -> list[dict[str, bytes]]:
    """The shared libraries of each model for each platform (default: the host's).

    Raises FmuError for a missing source, fmus.build.toolchain.ToolchainError from the compiler.
    """
    targets = platforms or (toolchain.host_platform(),)
    with toolchain.processes() as pool:
        built = {platform: _libraries(models, platform, pool) for platform in targets}
    return [{platform: built[platform][n] for platform in targets} for n in range(len(models))]


def _libraries(models: Sequence[Model], platform: str, pool: ThreadPoolExecutor) -> list[bytes]:
    """The library of each model for one platform; `pool` runs the compilers."""
    objects: dict[Path, Future[Path]] = {}
    links: list[Future[bytes]] = []
    with tempfile.TemporaryDirectory(prefix="fmu-") as scratch:
        try:
            place = partial(_place, Path(scratch))
            needed = [{place(unit): unit for unit in units(model)} for model in models]
            for folders in needed:
                for folder, unit in folders.items():
                    if folder not in objects:
                        objects[folder] = pool.submit(_compile, unit, folder, platform)
            for model, folders in zip(models, needed, strict=True):
                found = [objects[folder].result() for folder in folders]
                links.append(pool.submit(_link, model, found, Path(scratch), platform))
            return [link.result() for link in links]
        finally:
            _end([*objects.values(), *links])  # before the folder that they write in goes


def _end(jobs: Sequence[Future[Any]]) -> None:
    """Wait for the jobs that have begun; the rest does not begin any more."""
    for job in jobs:
        job.cancel()
    wait(jobs)


def _place(scratch: Path, unit: Mapping[str, str]) -> Path:
    """The folder for the object of a unit: the same for the same texts."""
    return scratch / hashlib.sha256(json.dumps(unit).encode()).hexdigest()


def _compile(unit: Mapping[str, str], folder: Path, platform: str) -> Path:
    """The object of a C file, the first of `unit`, and the headers that it includes."""
    folder.mkdir()
    for name, text in unit.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    source = folder / next(iter(unit))
    output = source.with_suffix(".o")
    return toolchain.compile_object(source, output, include=[folder], platform=platform)


def _link(model: Model, objects: Iterable[Path], scratch: Path, platform: str) -> bytes:
    """The content of the shared library of `model`."""
    output = scratch / (model.identifier + toolchain.shared_suffix(platform))
    return toolchain.link_shared(objects, output, platform=platform).read_bytes()
