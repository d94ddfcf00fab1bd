"""An FMU's binary from its sources in C and C++ (FMI 2.0.5 §2.3, 3.0.2 §2.5.1.4)."""

from __future__ import annotations

import re
import shlex
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

from cosim.base.archive import add_sum
from cosim.base.errors import CosimError, FmuError
from cosim.base.parts import part
from cosim.fmi.file.archive import Archive
from cosim.fmi.file.headers import header_folder

#: For sources that were not written for our own compiler options.
_FLAGS = ("-fvisibility=default", "-w")
#: The language of a file by the end of its name, where it is not C, and what each is compiled with.
_CPP = (".cc", ".cpp", ".cxx", ".c++")
_C_STANDARD, _CPP_STANDARD = "-std=gnu11", ("-x", "c++", "-std=gnu++17")


@dataclass(frozen=True, slots=True)
class SourceFileSet:
    """Sources that are compiled alike; `files` and folders of `include` are below ``sources``."""

    files: tuple[str, ...]
    include: tuple[str, ...] = ()
    defines: Mapping[str, str] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    cpp: bool = False


def compile_sources(archive: Archive, fmi: str, identifier: str, output: Path) -> Path:
    """Compile the sources an FMU lists (all there are, if it lists none) into `output`.

    The compiler is the one that our own FMUs are built with. The headers of the standard are there,
    and names have no prefix unless the sources insist. Raises FmuError where there is no compiler,
    a listed file or folder is missing, a language is unknown, or it refuses the sources.
    """
    toolchain = part("toolchain")
    with tempfile.TemporaryDirectory(prefix="sources-") as scratch:
        host = toolchain.host_platform()
        calls, libraries = source_calls(archive, fmi, identifier, host, Path(scratch))
        cpp = any("c++" in flags for _, _, flags in calls)
        libraries += [_cpp_library(toolchain)] if cpp else []
        try:
            objects = [
                toolchain.compile_object(
                    path, Path(scratch, f"{n}.o"), include=include, flags=flags
                )
                for n, (path, include, flags) in enumerate(calls)
            ]
            toolchain.link_shared(objects, output, flags=_FLAGS, libraries=libraries)
        except CosimError as error:
            said = " ".join(str(error).splitlines()[:3])
            raise FmuError(f"{archive.path}: its sources do not build: {said}") from None
    with suppress(OSError):  # it is then built again
        add_sum(archive.folder, output)
    return output


def source_calls(
    archive: Archive, fmi: str, identifier: str, platform: str, scratch: Path
) -> tuple[list[tuple[Path, list[Path], list[str]]], list[str]]:
    """Files with folders of headers and options, as an FMU's sources are compiled; libraries.

    `scratch`: an empty folder, for the headers of the standard. Raises FmuError for a file or
    folder that is listed and missing, or an unknown language.
    """
    folder = archive.folder / "sources"
    sets, libraries = _listed(archive, fmi, identifier, platform)
    if not any(one.files for one in sets):
        found = _not_included(sorted(x for x in folder.glob("*") if x.suffix in (".c", *_CPP)))
        sets = [SourceFileSet(tuple(path.name for path in found))]
    headers = header_folder(fmi, scratch)
    own = _defines(archive, fmi, identifier)
    calls = [
        call for one in sets for call in _calls(archive, one, own, [headers] if headers else [])
    ]
    return calls, libraries


def _calls(
    archive: Archive, one: SourceFileSet, own: Mapping[str, str | None], headers: Sequence[Path]
) -> Iterator[tuple[Path, list[Path], list[str]]]:
    """The arguments of each call of the compiler: a file, folders of headers, options."""
    folder = archive.folder / "sources"
    include = [_inside(archive, name, "include folder") for name in one.include]
    defines = {**own, **one.defines}
    macros = [f"-D{k}" if v is None else f"-D{k}={v}" for k, v in defines.items()]
    for name in one.files:
        path = _inside(archive, name, "source")
        cpp = one.cpp or path.suffix.lower() in _CPP
        standard = _CPP_STANDARD if cpp else (_C_STANDARD,)
        yield path, [folder, *include, *headers], [*_FLAGS, *standard, *macros, *one.options]


def _inside(archive: Archive, name: str, what: str) -> Path:
    """A path in the folder of the sources. Raises FmuError where there is none."""
    folder = (archive.folder / "sources").resolve()
    path = folder / name
    there = path.is_file() if what == "source" else path.is_dir()
    if not path.resolve().is_relative_to(folder) or not there:
        raise FmuError(f"{archive.path}: lists the {what} {name!r}, which is not there")
    return path


def _cpp_library(toolchain: ModuleType) -> str:
    """The name of the compiler's C++ library."""
    return "c++" if "ziglang" in toolchain.compiler() or sys.platform == "darwin" else "stdc++"


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
        for name in re.findall(rb'#\s*include\s*"([^"]+\.c\w*)"', path.read_bytes())
    }
    return [path for path in sources if path.name.encode() not in included]


def _listed(
    archive: Archive, fmi: str, identifier: str, platform: str
) -> tuple[list[SourceFileSet], list[str]]:
    """Sets of sources and libraries by the model description (2.0) or buildDescription.xml (3.0).

    Raises FmuError for a description that cannot be read, or has nothing for `identifier` on
    `platform`.
    """
    if fmi != "3.0":
        root = ElementTree.parse(archive.folder / "modelDescription.xml").getroot()
        files = (
            f.get("name", "")
            for interface in ("CoSimulation", "ModelExchange")
            for f in root.iterfind(f"{interface}/SourceFiles/File")
        )
        return [SourceFileSet(tuple(dict.fromkeys(files)))], []
    described = archive.folder / "sources" / "buildDescription.xml"
    if not described.is_file():
        return [], []
    try:
        root = ElementTree.parse(described).getroot()
    except ElementTree.ParseError as error:
        raise FmuError(
            f"{archive.path}: buildDescription.xml is not well-formed: {error}"
        ) from None
    offered = list(root.iterfind("BuildConfiguration"))
    fitting = [
        x
        for x in offered
        if x.get("modelIdentifier", identifier) == identifier
        and x.get("platform", platform) == platform
    ]
    if offered and not fitting:
        found = ", ".join(
            f"{x.get('modelIdentifier')} ({x.get('platform', 'any platform')})" for x in offered
        )
        raise FmuError(
            f"{archive.path}: buildDescription.xml builds {found}; expected {identifier} for "
            f"{platform}"
        )
    sets = [_set(archive, x) for c in fitting[:1] for x in c.iterfind("SourceFileSet")]
    return sets, [x.get("name", "") for c in fitting[:1] for x in c.iterfind("Library")]


def _set(archive: Archive, element: ElementTree.Element) -> SourceFileSet:
    """A set of sources of buildDescription.xml. Raises FmuError for other languages than C, C++."""
    language = element.get("language", "C99")
    if not re.fullmatch(r"C(\+\+)?\d*", language):
        raise FmuError(f"{archive.path}: has sources in {language}; expected C or C++")

    def names(tag: str) -> tuple[str, ...]:
        return tuple(x.get("name", "") for x in element.iterfind(tag))

    defined = {
        m.get("name", ""): m.get("value", "") for m in element.iterfind("PreprocessorDefinition")
    }
    return SourceFileSet(
        names("SourceFile"), names("IncludeDirectory"), defined,
        tuple(shlex.split(element.get("compilerOptions", ""))), language.startswith("C++"),
    )  # fmt: skip
