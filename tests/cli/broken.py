"""FMUs that are broken in one way each, made from a good one."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

from cosim.native import shared
from fmus.models import planar2r

Files = dict[str, bytes]
XML = "modelDescription.xml"


def contents(version: str = "2.0") -> Files:
    """All entries of the good FMU."""
    with zipfile.ZipFile(planar2r.fmu(version)) as archive:  # type: ignore[arg-type]
        return {name: archive.read(name) for name in archive.namelist()}


def written(files: Files, path: Path) -> Path:
    """An archive of these entries."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def edited(files: Files, pattern: str, replacement: str) -> Files:
    """The same with another model description."""
    text, n = re.subn(pattern, replacement, files[XML].decode(), flags=re.DOTALL)
    assert n, f"{pattern!r} is not in {XML}"
    return files | {XML: text.encode()}


def without_description() -> Files:
    """An archive like any other."""
    return {name: data for name, data in contents().items() if name != XML}


def damaged_xml() -> Files:
    """The description ends in the middle."""
    files = contents()
    return files | {XML: files[XML][:2000]}


def fmi1() -> Files:
    """A version that came before co-simulation was part of FMI."""
    return edited(contents(), 'fmiVersion="2.0"', 'fmiVersion="1.0"')


def scheduled() -> Files:
    """For an interface that FMI 2.0 does not have."""
    return edited(
        contents(),
        "<CoSimulation.*?</CoSimulation>",
        '<ScheduledExecution modelIdentifier="planar2r"/>',
    )


def other_platform() -> Files:
    """Binaries for another platform only, and no sources."""
    files = {n: d for n, d in contents().items() if not n.startswith(("binaries/", "sources/"))}
    return files | {"binaries/riscv32-plan9/planar2r.so": b"nothing"}


def sources_only() -> Files:
    """Sources, which could be built."""
    return {n: d for n, d in contents().items() if not n.startswith("binaries/")}


def other_token() -> Files:
    """The binary expects another guid."""
    return edited(contents(), 'guid="[^"]*"', 'guid="{00000000-0000-0000-0000-000000000000}"')


def other_token3() -> Files:
    """The same in FMI 3.0."""
    return edited(contents("3.0"), 'instantiationToken="[^"]*"', 'instantiationToken="another"')


def no_functions() -> Files:
    """A shared library, but not an FMU's."""
    library = shared.library_path().read_bytes()
    return {n: library if _is_binary(n) else d for n, d in contents().items()}


def no_library() -> Files:
    """No shared library at all."""
    return {n: b"#!/bin/sh\n" if _is_binary(n) else d for n, d in contents().items()}


def escaping() -> Files:
    """An entry that would be written outside the folder."""
    return contents() | {"../outside.txt": b""}


def _is_binary(name: str) -> bool:
    return name.startswith("binaries/") and name.endswith((".so", ".dylib", ".dll"))


#: How it is broken, and what the message has to say.
BROKEN: tuple[tuple[Callable[[], Files], str], ...] = (
    (without_description, "contains no modelDescription.xml"),
    (damaged_xml, "modelDescription.xml is not well-formed: "),
    (fmi1, "modelIdentifier is ''; expected a C identifier"),
    (scheduled, "found the interfaces none; expected an FMU exported for co-simulation, model"),
    (other_platform, "platforms in the FMU: riscv32-plan9"),
    (sources_only, "it holds sources, which could be built"),
    (other_token, "the token is '{00000000-0000-0000-0000-000000000000}', expected '{"),
    (other_token3, "the token is 'another', expected '{"),
    (no_functions, "the binary lacks fmi2Instantiate"),
    (no_library, "cannot load planar2r"),
    (escaping, "entry '../outside.txt' would be written outside the folder"),
)
