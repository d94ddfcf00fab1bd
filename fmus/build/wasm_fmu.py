"""WebAssembly binaries of FMUs, by the draft FMI Layered Standard for WebAssembly.

An FMU's sources, with ``fmus/c/wasm``, become one module, and the module a component of the world
``co-simulation-fmu``. The component around the module is the same for every FMU: ``world.bin``,
whose origin is in ``fmus/c/wasm/README.md``. Nothing but ziglang is needed.
"""

from __future__ import annotations

import tempfile
import zipfile
from math import prod
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from cosim.base.errors import CosimError, FmuError
from cosim.fmi.file.archive import Archive, unpack
from cosim.fmi.file.binaries import WASM_FOLDER, has_sources
from cosim.fmi.file.description import Description, read_cached
from cosim.fmi.file.sources import source_calls
from fmus.build import toolchain
from fmus.build.archive import write_archive
from fmus.build.description import xml_text

_FOLDER = Path(__file__).parents[1] / "c"
#: A module without `main`, with 1 MiB of stack.
_LINKED = ("-mexec-model=reactor", "-s", "-Wl,--gc-sections", "-Wl,-z,stack-size=1048576")
_MANIFEST = "extra/org.modelica.fmi-ls-wasm/manifest.xml"
#: The kind of a section with a module, and one with an empty module.
_MODULE, _EMPTY = b"\x01", b"\x01\x08\x00asm\x01\x00\x00\x00"


def add_wasm(path: Path) -> Path:
    """Give an FMU of FMI 3.0 for co-simulation a WebAssembly binary, made from the sources in it.

    It keeps everything else that it has. Returns `path`. Raises FmuError for another FMU, and for
    one without sources in C or C++; ToolchainError without ziglang.
    """
    archive = unpack(path)
    found = read_cached(archive.folder, path)
    if found.fmi != "3.0" or found.interface != "CoSimulation":
        raise FmuError(
            f"{path}: found FMI {found.fmi} for {found.interface}; expected FMI 3.0 for "
            "CoSimulation, which is what has a WebAssembly binary"
        )
    if not has_sources(archive):
        raise FmuError(f"{path}: found no sources; expected C, from which the binary is made")
    with zipfile.ZipFile(path) as file:
        content = {name: file.read(name) for name in file.namelist() if not name.endswith("/")}
    content[f"binaries/{WASM_FOLDER}/{found.identifier}.wasm"] = component(archive, found)
    content[_MANIFEST] = xml_text(_manifest()).encode()
    write_archive(content, path)
    return path


def component(archive: Archive, description: Description) -> bytes:
    """The component of an FMU, compiled from the sources in it.

    Raises FmuError for sources that do not build, ToolchainError without ziglang.
    """
    with tempfile.TemporaryDirectory(prefix="wasm-") as scratch:
        folder = Path(scratch)
        (folder / "sizes.h").write_text(
            _sizes(archive.folder / "modelDescription.xml"), encoding="utf-8"
        )
        headers = folder / "headers"
        headers.mkdir()
        calls, _ = source_calls(archive, "3.0", description.identifier, toolchain.WEB, headers)
        own = [folder, _FOLDER]
        calls += [(path, own, []) for path in sorted((_FOLDER / "wasm").glob("*.c"))]
        with toolchain.processes() as pool:
            jobs = [
                pool.submit(
                    toolchain.compile_object, source, folder / f"{n}.o", include=include,
                    platform=toolchain.WEB, flags=[*flags, "-fno-PIC"],
                )
                for n, (source, include, flags) in enumerate(calls)
            ]  # fmt: skip
            try:
                objects = [job.result() for job in jobs]
                module = toolchain.link_shared(
                    objects, folder / "fmu.wasm", platform=toolchain.WEB, flags=_LINKED
                )
            except CosimError as error:
                said = " ".join(str(error).splitlines()[:3])
                raise FmuError(f"{archive.path}: no WebAssembly of its sources: {said}") from None
        return _around(module.read_bytes())


def _around(module: bytes) -> bytes:
    """The component of a module: a section has a kind, a length in LEB128, and a content."""
    world = (_FOLDER / "wasm" / "world.bin").read_bytes()
    left, length = len(module), bytearray()
    while left > 0x7F:
        length.append(left & 0x7F | 0x80)
        left >>= 7
    length.append(left)
    return world.replace(_EMPTY, _MODULE + bytes(length) + module, 1)


def _sizes(description: Path) -> str:
    """``sizes.h``: the arrays, each with a factor and the structural parameters beside it."""
    rows = []
    for variable in ElementTree.parse(description).getroot().iterfind("ModelVariables/*"):
        extents = variable.findall("Dimension")
        factor = prod(int(extent.get("start", "1")) for extent in extents)
        named = [r for r in (extent.get("valueReference") for extent in extents) if r]
        if extents:
            rows.append([variable.get("valueReference", ""), str(factor), *named])
    width = max((len(row) for row in rows), default=3)
    entries = [
        ", ".join(row + ["NO_DIMENSION"] * (width - len(row))) for row in [["0", "0"], *rows]
    ]
    listed = ", ".join(f"{{{entry}}}" for entry in entries)
    return f"enum {{ DIMENSIONS = {width - 2} }};\n#define SIZES {{{listed}}}\n"


def _manifest() -> Element:
    """The mark of an FMU of this layered standard."""
    space = "fmi-ls:fmi-ls-"
    return Element(
        "fmiLayeredStandardManifest",
        {
            "xmlns:fmi-ls": "http://fmi-standard.org/fmi-ls-manifest",
            f"{space}name": "org.modelica.fmi-ls-wasm",
            f"{space}version": "0.1.0",
            f"{space}description": "FMI Layered Standard for WebAssembly",
        },
    )
