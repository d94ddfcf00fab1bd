"""Archives: the same bytes again, everything in its place, sources that give the same numbers."""

from __future__ import annotations

import ctypes
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pytest

from cosim.base.copies import replace
from cosim.base.errors import CosimError, FmuError
from fmus.build import archive as building
from fmus.build import kernel as kernels
from fmus.build.archive import (
    VERSIONS,
    build,
    build_all,
    find,
    installed_models,
    pack,
    shipped_models,
    toolchain,
    versions,
)
from fmus.build.library import compile_model, compile_models
from fmus.build.source import LANES, c_files, sources, token
from fmus.model import Model, Variable
from fmus.models import arm, operator, planar2r, teleoperation, xi
from tests.tiers import first_fast

HAND = operator.model()
STEPS = 200


@pytest.fixture(scope="module")
def hand() -> Mapping[str, bytes]:
    """The operator's library for the host: the quickest to compile."""
    return compile_model(HAND)


def trajectory(path: Path, model: Model) -> bytes:
    """All variables over a run from the kernel of a library, as they lie in memory."""
    kernel = kernels.load(path)
    size = kernel.kernel_size()
    x = np.zeros(size)
    kernel.kernel_reset(x.ctypes.data)
    rng, rows, offset = np.random.default_rng(7), [], 0
    places = {}
    for v in model.variables:
        places[v.name] = slice(offset, offset + v.size)
        offset += v.size
    if "friction" in places:
        x[places["friction"]] = 0.3
    assert kernel.kernel_initial(x.ctypes.data) is None
    for k in range(STEPS):
        for port in model.inputs():
            x[places[port.name]] = rng.uniform(-2, 2, port.size)
        assert kernel.kernel_step(x.ctypes.data, k * model.step, model.step) is None
        rows.append(x.tobytes())
    return b"".join(rows)


# --- the archive -----------------------------------------------------------------------------


def test_the_same_model_gives_the_same_bytes(hand: Mapping[str, bytes], tmp_path: Path) -> None:
    assert compile_model(HAND) == hand
    for version in VERSIONS:
        first, second = (pack(HAND, version, tmp_path / folder, hand) for folder in "ab")
        assert first.name == f"operator.fmi{version[0]}.fmu"
        assert first.read_bytes() == second.read_bytes()


def test_build_compiles_and_packs(tmp_path: Path, hand: Mapping[str, bytes]) -> None:
    path = build(HAND, "2.0", tmp_path / "a")
    assert path.read_bytes() == pack(HAND, "2.0", tmp_path / "b", hand).read_bytes()


def test_the_date_is_the_epochs_or_none(
    hand: Mapping[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    without = read(pack(HAND, "2.0", tmp_path, hand), "modelDescription.xml")
    assert "generationDateAndTime" not in without
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    dated = read(pack(HAND, "2.0", tmp_path, hand), "modelDescription.xml")
    assert 'generationDateAndTime="2023-11-14T22:13:20Z"' in dated


def read(path: Path, name: str) -> str:
    with ZipFile(path) as archive:
        return archive.read(name).decode()


def test_entries_are_sorted_and_without_a_time(hand: Mapping[str, bytes], tmp_path: Path) -> None:
    with ZipFile(pack(HAND, "3.0", tmp_path, hand)) as archive:
        entries = archive.infolist()
    assert [e.filename for e in entries] == sorted(e.filename for e in entries)
    assert {e.date_time for e in entries} == {(1980, 1, 1, 0, 0, 0)}


def test_folders_of_platforms_are_those_of_each_version(
    hand: Mapping[str, bytes], tmp_path: Path
) -> None:
    (binary,) = hand.values()
    binaries = dict.fromkeys(toolchain.PLATFORMS, binary)
    with ZipFile(pack(HAND, "3.0", tmp_path, binaries)) as archive:
        assert {n for n in archive.namelist() if n.startswith("binaries")} == {
            "binaries/x86_64-linux/operator.so",
            "binaries/aarch64-linux/operator.so",
            "binaries/x86_64-windows/operator.dll",
            "binaries/x86_64-darwin/operator.dylib",
            "binaries/aarch64-darwin/operator.dylib",
        }
    with ZipFile(pack(HAND, "2.0", tmp_path, binaries)) as archive:
        assert {n for n in archive.namelist() if n.startswith("binaries")} == {
            "binaries/linux64/operator.so",
            "binaries/aarch64-linux/operator.so",
            "binaries/win64/operator.dll",
            "binaries/darwin64/operator.dylib",
            "binaries/aarch64-darwin/operator.dylib",
        }
    alone = {"aarch64-darwin": binary}
    with ZipFile(pack(HAND, "2.0", tmp_path, alone)) as archive:
        assert "binaries/darwin64/operator.dylib" in archive.namelist()


def test_an_installation_ships_every_model_in_both_versions(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    compiled = []

    def instead(models: list[Model], _: object) -> list[dict[str, bytes]]:
        compiled.extend(model.identifier for model in models)
        return [{toolchain.host_platform(): b"library"} for _ in models]

    monkeypatch.setattr(building, "compile_models", instead)
    names = [path.name for path in build_all(tmp_path)]
    models = installed_models()
    assert compiled == [model.identifier for model in models]  # once each, for both versions
    assert names == [f"{m.identifier}.fmi{v[0]}.fmu" for m in models for v in versions(m)]
    assert {v for m in shipped_models() for v in versions(m)} == {"2.0", "3.0"}
    assert all((tmp_path / name).is_file() for name in names)


@pytest.mark.slow
def test_what_models_share_is_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each model only its own C file, its lanes and its tables, however many models."""
    compiled, compile_object = [], toolchain.compile_object

    def counted(source: Path, *args, **options) -> Path:
        compiled.append(source.name)
        return compile_object(source, *args, **options)

    monkeypatch.setattr(toolchain, "compile_object", counted)
    models = [xi.model(), HAND, teleoperation.model(1)]
    together = compile_models(models)
    lanes = [name for name in LANES if name.endswith(".c")]
    own = ["variables.c"] * 3 + ["operator.c", "teleoperation.c", *lanes, "xi.c"]
    layer = [name for name in c_files(xi.model()) if name not in own]
    assert "fmi3.c" in layer
    assert sorted(compiled) == sorted([*own, *layer, "trig.c"])
    assert together[1] == compile_model(HAND)


# --- sources ---------------------------------------------------------------------------------


@pytest.mark.parametrize("version", first_fast(VERSIONS))
@pytest.mark.parametrize("model", [planar2r.model(), teleoperation.model(1)], ids=["plain", "law"])
def test_the_sources_inside_build_to_the_same_numbers(
    model: Model, version: str, tmp_path: Path
) -> None:
    """With nothing but what the FMU says: files, and in FMI 3.0 the options.

    The C file of the law is that of several models, whose macros are in ``variables.h``.
    """
    with ZipFile(find(model, version)) as archive:
        archive.extractall(tmp_path)
    if version == "3.0":
        root = ElementTree.parse(tmp_path / "sources" / "buildDescription.xml").getroot()
        files = [str(e.get("name")) for e in root.iter("SourceFile")]
        options = next(root.iter("SourceFileSet")).get("compilerOptions", "").split()
    else:
        root = ElementTree.parse(tmp_path / "modelDescription.xml").getroot()
        files = [str(e.get("name")) for e in root.iter("File")]
        options = []
    output = tmp_path / f"rebuilt{toolchain.shared_suffix()}"
    command = [*toolchain.compiler(), *options, "-shared", "-fPIC", "-o", str(output), *files]
    subprocess.run(command, cwd=tmp_path / "sources", check=True)
    assert trajectory(output, model) == trajectory(kernels.library(model), model)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [planar2r.model(), teleoperation.model(2), arm.model()], ids=["planar", "law", "arm"]
)
def test_gcc_and_zig_give_the_same_bits(model: Model, tmp_path: Path) -> None:
    zig = tmp_path / f"zig{toolchain.shared_suffix()}"
    for name, text in sources(model).items():
        (tmp_path / name).write_text(text)
    files = [str(tmp_path / name) for name in c_files(model)]
    command = [sys.executable, "-m", "ziglang", "cc", *toolchain.FLAGS, "-shared", "-fPIC", "-O3"]
    subprocess.run([*command, "-o", str(zig), *files], check=True)
    assert trajectory(zig, model) == trajectory(kernels.library(model), model)


STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")


@pytest.mark.parametrize("compiler", ["host", pytest.param("zig", marks=pytest.mark.slow)])
def test_the_sources_compile_without_a_warning(
    compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if compiler == "zig":
        zig = (sys.executable, "-m", "ziglang", "cc")
        monkeypatch.setattr(toolchain, "host_compiler", lambda: zig)
    for model in (planar2r.model(), teleoperation.model(3), xi.model(), arm.model()):
        for name, text in sources(model).items():
            (tmp_path / name).write_text(text)
        # the generic layer is the same in all: once is enough
        whole = model.sources[0] == "planar2r.c"
        names = [n for n in c_files(model) if whole or n in model.sources]
        output = tmp_path / f"{model.identifier}{toolchain.shared_suffix()}"
        files = [tmp_path / name for name in names]
        toolchain.compile_shared(files, output, include=[tmp_path], flags=STRICT)


def test_the_token_follows_declaration_and_sources(tmp_path: Path) -> None:
    assert token(HAND) == token(operator.model())
    others = [
        replace(HAND, version="1.1"),
        replace(HAND, step=1e-3),
        replace(HAND, variables=(replace(HAND.variables[0], unit="deg"), *HAND.variables[1:])),
    ]
    source = tmp_path / "operator.c"
    source.write_text(sources(HAND)["operator.c"] + "/* changed */\n")
    others.append(replace(HAND, sources=(str(source),)))
    assert len({token(model) for model in [HAND, *others]}) == 5
    source = tmp_path / "elsewhere" / "operator.c"
    source.parent.mkdir()
    source.write_text(sources(HAND)["operator.c"])
    assert token(replace(HAND, sources=(str(source),))) == token(HAND)


# --- other platforms -------------------------------------------------------------------------

MAGIC = {
    "x86_64-linux": (b"\x7fELF", 18, 62),
    "aarch64-linux": (b"\x7fELF", 18, 183),
    "x86_64-windows": (b"MZ", None, 0x8664),
    "x86_64-darwin": (b"\xcf\xfa\xed\xfe", 4, 7),
    "aarch64-darwin": (b"\xcf\xfa\xed\xfe", 4, 12),
}


@pytest.mark.slow
@pytest.mark.parametrize("platform", toolchain.PLATFORMS)
def test_every_platform_gets_a_library_of_its_machine(platform: str) -> None:
    binary = compile_model(HAND, [platform])[platform]
    magic, place, machine = MAGIC[platform]
    assert binary.startswith(magic)
    if place is None:  # the machine of a DLL stands behind the pointer at 0x3c
        place = struct.unpack_from("<I", binary, 0x3C)[0] + 4
    assert struct.unpack_from("<H", binary, place)[0] == machine
    for name in (b"fmi2DoStep", b"fmi3DoStep", b"kernel_step"):
        assert name in binary


# --- what cannot be --------------------------------------------------------------------------


@pytest.mark.parametrize("make", [build, lambda m, v, _: find(m, v)])
def test_an_unknown_version_is_refused(make, tmp_path: Path) -> None:
    with pytest.raises(FmuError, match=r"'1\.0'; expected one of 2\.0, 3\.0"):
        make(HAND, "1.0", tmp_path)


def port(name: str, **options) -> Variable:
    return Variable(name, "output", **options)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (replace(HAND, identifier="two words"), "'two words' is not a valid C name"),
        (replace(HAND, variables=(port("x y"),)), "'x y' is not a valid C name"),
        (replace(HAND, variables=(port("y"), port("y"))), r"operator\.y: declared twice"),
        (replace(HAND, variables=(port("time"),)), "'time' is reserved"),
        (
            replace(HAND, variables=(port("y", shape=(3,), start=(1.0,)),)),
            "1 start values, expected 3",
        ),
        (replace(HAND, variables=(port("y", depends=("u",)),)), "'u', which is not declared"),
        (replace(HAND, sources=("nowhere.c",)), r"nowhere\.c: No such file"),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(
    model: Model, message: str, tmp_path: Path
) -> None:
    with pytest.raises(FmuError, match=message):
        build(model, "2.0", tmp_path)


def test_what_the_compiler_says_is_passed_on(tmp_path: Path) -> None:
    source = tmp_path / "broken.c"
    source.write_text(
        '#include "model.h"\nconst char *model_step(Model *x) { return x->nothing; }\n'
    )
    with pytest.raises(CosimError, match="nothing"):
        build(replace(HAND, sources=(str(source),)), "2.0", tmp_path)


def test_a_library_that_is_no_kernel_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "empty.c"
    source.write_text("int nothing;\n")
    output = tmp_path / f"empty{toolchain.shared_suffix()}"
    toolchain.compile_shared([source], output)
    with pytest.raises(FmuError, match="cannot be loaded as a kernel"):
        kernels.load(output)
    assert ctypes.CDLL(str(output))


def test_a_model_without_terminals_has_no_file_of_them(tmp_path: Path) -> None:
    for each, expected in ((replace(HAND, terminals=()), False), (HAND, True)):
        with ZipFile(pack(each, "3.0", tmp_path, {})) as archive:
            names = archive.namelist()
        assert ("terminalsAndIcons/terminalsAndIcons.xml" in names) is expected


def test_a_failed_compiler_leaves_no_other_at_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder in which all compile goes when the last has ended."""
    at_work, done = threading.Event(), threading.Event()

    def compiled(source: Path, output: Path, **_: object) -> Path:
        if source.name == "broken.c":
            assert at_work.wait(20.0)
            raise toolchain.ToolchainError("broken")
        at_work.set()
        time.sleep(0.1)
        output.write_bytes(b"")
        done.set()
        return output

    monkeypatch.setattr(toolchain, "compile_object", compiled)
    source = tmp_path / "broken.c"
    source.write_text("")
    with pytest.raises(toolchain.ToolchainError, match="broken"):
        build(replace(HAND, sources=(str(source),)), "2.0", tmp_path)
    assert done.is_set()
