"""An FMU's binary from its C sources (FMI 2.0.5 §2.3, 3.0.2 §2.5.1.4)."""

from __future__ import annotations

import importlib
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

from cosim.base.archive import add_sum
from cosim.base.errors import CosimError, FmuError
from cosim.fmi.archive import Archive


def compile_sources(archive: Archive, fmi: str, identifier: str, output: Path) -> Path:
    """Compile the sources an FMU lists (all there are, if it lists none) into `output`.

    The compiler is the one that our own FMUs are built with. Raises FmuError where there is none,
    a listed file is missing, or it refuses the sources.
    """
    try:
        toolchain = importlib.import_module("fmus.toolchain")
    except ImportError:
        raise FmuError(
            f"{archive.path}: building its sources needs the package fmus, which is not installed"
        ) from None
    folder = archive.folder / "sources"
    files, defines = _listed(archive, fmi)
    sources = [folder / name for name in files] or sorted(folder.glob("*.c"))
    for source in sources:
        if not source.resolve().is_relative_to(folder.resolve()) or not source.is_file():
            raise FmuError(f"{archive.path}: lists the source {source.name!r}, which is not there")
    try:
        toolchain.compile_shared(sources, output, include=[folder], defines=defines)
    except CosimError as error:
        last = str(error).splitlines()
        raise FmuError(f"{archive.path}: its sources do not build: {' '.join(last[:3])}") from None
    with suppress(OSError):  # it is then built again
        add_sum(archive.folder, output)
    return output


def _listed(archive: Archive, fmi: str) -> tuple[list[str], dict[str, str]]:
    """Source files and macros by the model description (2.0) or buildDescription.xml (3.0)."""
    if fmi != "3.0":
        root = ElementTree.parse(archive.folder / "modelDescription.xml").getroot()
        files = root.iterfind("CoSimulation/SourceFiles/File")
        return [f.get("name", "") for f in files], {}
    described = archive.folder / "sources" / "buildDescription.xml"
    if not described.is_file():
        return [], {}
    try:
        root = ElementTree.parse(described).getroot()
    except ElementTree.ParseError as error:
        raise FmuError(
            f"{archive.path}: buildDescription.xml is not well-formed: {error}"
        ) from None
    set_ = root.find("BuildConfiguration/SourceFileSet")
    if set_ is None:
        return [], {}
    macros = {
        m.get("name", ""): m.get("value", "") for m in set_.iterfind("PreprocessorDefinition")
    }
    return [f.get("name", "") for f in set_.iterfind("SourceFile")], macros
