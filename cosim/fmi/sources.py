"""An FMU's binary from its C sources (FMI 2.0.5 §2.3, 3.0.2 §2.5.1.4)."""

from __future__ import annotations

import re
import tempfile
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

from cosim.base.archive import add_sum
from cosim.base.errors import CosimError, FmuError
from cosim.base.parts import part
from cosim.fmi.archive import Archive
from cosim.fmi.headers import header_folder

#: For sources that were not written for our own compiler options.
_FLAGS = ("-std=gnu11", "-fvisibility=default", "-w")


def compile_sources(archive: Archive, fmi: str, identifier: str, output: Path) -> Path:
    """Compile the sources an FMU lists (all there are, if it lists none) into `output`.

    The compiler is the one that our own FMUs are built with. The headers of the standard are there,
    and names have no prefix unless the sources insist. Raises FmuError where there is no compiler,
    a listed file is missing, or it refuses the sources.
    """
    toolchain = part("toolchain")
    folder = archive.folder / "sources"
    files, defines = _listed(archive, fmi)
    sources = [folder / name for name in files] or _not_included(sorted(folder.glob("*.c")))
    for source in sources:
        if not source.resolve().is_relative_to(folder.resolve()) or not source.is_file():
            raise FmuError(f"{archive.path}: lists the source {source.name!r}, which is not there")
    with tempfile.TemporaryDirectory(prefix="headers-") as scratch:
        headers = header_folder(fmi, Path(scratch))
        include = [folder, *([headers] if headers else [])]
        try:
            toolchain.compile_shared(
                sources, output, include=include, flags=_FLAGS,
                defines={**_defines(archive, fmi, identifier), **defines},
            )  # fmt: skip
        except CosimError as error:
            last = str(error).splitlines()
            said = " ".join(last[:3])
            raise FmuError(f"{archive.path}: its sources do not build: {said}") from None
    with suppress(OSError):  # it is then built again
        add_sum(archive.folder, output)
    return output


def _defines(archive: Archive, fmi: str, identifier: str) -> dict[str, str | None]:
    """Macros by which a shared library has functions without a prefix, or 1.0 with its own."""
    if fmi == "2.0":
        return {"FMI2_FUNCTION_PREFIX": "", "FMI2_OVERRIDE_FUNCTION_PREFIX": None}
    if fmi == "3.0":
        return {"FMI3_OVERRIDE_FUNCTION_PREFIX": None}
    root = ElementTree.parse(archive.folder / "modelDescription.xml").getroot()
    slave = root.find("Implementation") is not None
    return {"MODEL_IDENTIFIER": identifier, **({"FMI_COSIMULATION": None} if slave else {})}


def _not_included(sources: list[Path]) -> list[Path]:
    """The files without those that others of them include."""
    included = {
        name
        for path in sources
        for name in re.findall(rb'#\s*include\s*"([^"]+\.c)"', path.read_bytes())
    }
    return [path for path in sources if path.name.encode() not in included]


def _listed(archive: Archive, fmi: str) -> tuple[list[str], dict[str, str]]:
    """Source files and macros by the model description (2.0) or buildDescription.xml (3.0)."""
    if fmi != "3.0":
        root = ElementTree.parse(archive.folder / "modelDescription.xml").getroot()
        files = (
            f.get("name", "")
            for interface in ("CoSimulation", "ModelExchange")
            for f in root.iterfind(f"{interface}/SourceFiles/File")
        )
        return list(dict.fromkeys(files)), {}
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
