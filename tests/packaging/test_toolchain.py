"""The toolchain: which compiler, what it is told, and that the numbers do not depend on it."""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import CosimError
from fmus.build import toolchain
from fmus.build.toolchain import (
    PLATFORMS,
    ToolchainError,
    compile_shared,
    compiler,
    host_compiler,
    host_platform,
    shared_suffix,
)

SOURCE = """
#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif
#include "offset.h"
double hidden(double x) { return x + OFFSET; }
API double shifted(double x) { return hidden(x) * FACTOR; }
API double product_plus(double a, double b, double c) { return a * b + c; }
API double total(const double *x, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += x[i];
    return sum;
}
"""
FINITE = st.floats(-1e100, 1e100)
#: First bytes and machine code of each platform's libraries.
SIGNATURES = {
    "x86_64-linux": (b"\x7fELF\x02", b"\x3e\x00", 18),
    "aarch64-linux": (b"\x7fELF\x02", b"\xb7\x00", 18),
    "x86_64-darwin": (b"\xcf\xfa\xed\xfe", b"\x07\x00\x00\x01", 4),
    "aarch64-darwin": (b"\xcf\xfa\xed\xfe", b"\x0c\x00\x00\x01", 4),
    "x86_64-windows": (b"MZ", b"MZ", 0),
}
Build = Callable[..., Path]


@pytest.fixture(autouse=True)
def fresh_search() -> Iterator[None]:
    """Look for a compiler anew in each test, and after it."""
    host_compiler.cache_clear()
    yield
    host_compiler.cache_clear()


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compile SOURCE into a library of its own."""
    folder = tmp_path_factory.mktemp("sources")
    source = folder / "a source.c"
    source.write_text(SOURCE)
    include = folder / "include"
    include.mkdir()
    (include / "offset.h").write_text("#define OFFSET 1.0\n")

    def compiled(output: Path, factor: str = "2.0", **options: object) -> Path:
        defines = {"FACTOR": factor, "UNUSED": None}
        return compile_shared([source], output, include=[include], defines=defines, **options)  # type: ignore[arg-type]

    return compiled


def hide_compilers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    empty = tmp_path / "no-compiler"
    empty.mkdir(exist_ok=True)
    monkeypatch.setenv("PATH", str(empty))


def executable(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o755)
    return path


def shifted(library: Path, x: float) -> float:
    function = ctypes.CDLL(str(library)).shifted
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return float(function(x))


@pytest.mark.parametrize(
    ("machine", "system", "name"),
    [
        ("x86_64", "Linux", "x86_64-linux"),
        ("aarch64", "Linux", "aarch64-linux"),
        ("AMD64", "Windows", "x86_64-windows"),
        ("arm64", "Darwin", "aarch64-darwin"),
        ("riscv64", "Linux", "riscv64-linux"),
    ],
)
def test_platform_names_are_those_of_fmi(
    monkeypatch: pytest.MonkeyPatch, machine: str, system: str, name: str
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(platform, "system", lambda: system)
    assert host_platform() == name


def test_an_unknown_system_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "system", lambda: "Plan9")
    with pytest.raises(ToolchainError, match=r"'Plan9'.*expected one of darwin, linux, windows"):
        host_platform()


def test_suffixes() -> None:
    found = {name: shared_suffix(name) for name in PLATFORMS}
    assert set(found.values()) == {".so", ".dll", ".dylib"}
    assert shared_suffix() == shared_suffix(host_platform())
    with pytest.raises(ToolchainError, match=r"'pdp11-rsx'.*expected one of x86_64-linux"):
        shared_suffix("pdp11-rsx")


def test_errors_are_of_the_project_and_runtime_errors() -> None:
    assert issubclass(ToolchainError, CosimError)
    assert issubclass(ToolchainError, RuntimeError)


def test_cc_is_taken_at_its_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "my-cc -m64")
    assert compiler() == ("my-cc", "-m64")


def test_a_cc_that_does_not_exist_is_named(
    monkeypatch: pytest.MonkeyPatch, build: Build, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", "/no/such/cc")
    with pytest.raises(ToolchainError, match=r"/no/such/cc.*set CC to one that exists"):
        build(tmp_path / "a.so")


def test_a_compiler_that_cannot_build_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    hide_compilers(monkeypatch, tmp_path)
    folder = tmp_path / "no-compiler"
    executable(folder / "cc", "#!/bin/sh\necho 'stdlib.h: no such file' >&2\nexit 1\n")
    assert host_compiler() is None
    good = executable(folder / "gcc", "#!/bin/sh\nexit 0\n")
    host_compiler.cache_clear()
    assert host_compiler() == (str(good),)


def test_without_a_compiler_zig_serves_the_host(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    hide_compilers(monkeypatch, tmp_path)
    assert host_compiler() is None
    command = compiler()
    assert command[:4] == (sys.executable, "-m", "ziglang", "cc")
    assert "-mcpu=baseline" in command
    assert "-fno-sanitize=undefined" in command


def test_a_foreign_platform_is_always_zigs() -> None:
    for name in set(PLATFORMS) - {host_platform()}:
        assert "ziglang" in compiler(name)
    with pytest.raises(ToolchainError, match="unknown platform 'mips-linux'"):
        compiler("mips-linux")


def test_without_any_compiler_the_error_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, build: Build
) -> None:
    hide_compilers(monkeypatch, tmp_path)
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)
    with pytest.raises(ToolchainError, match=r"no C compiler.*'pip install ziglang'"):
        build(tmp_path / "a.so")
    foreign = next(name for name in PLATFORMS if name != host_platform())
    with pytest.raises(ToolchainError, match=f"no compiler for {foreign}.*'pip install ziglang'"):
        compiler(foreign)


def test_a_library_computes_what_its_source_says(build: Build, tmp_path: Path) -> None:
    library = build(tmp_path / "deep" / "folder" / f"a{shared_suffix()}")
    assert library.is_file()
    assert shifted(library, 3.0) == 8.0
    assert list(library.parent.iterdir()) == [library]


def test_only_what_is_exported_is_visible(build: Build, tmp_path: Path) -> None:
    library = ctypes.CDLL(str(build(tmp_path / f"a{shared_suffix()}")))
    with pytest.raises(AttributeError):
        _ = library.hidden


def test_a_mapped_library_lives_on_when_it_is_built_again(build: Build, tmp_path: Path) -> None:
    output = tmp_path / f"a{shared_suffix()}"
    old = ctypes.CDLL(str(build(output))).shifted
    old.restype, old.argtypes = ctypes.c_double, [ctypes.c_double]
    build(output, factor="10.0")
    assert old(3.0) == 8.0
    copy = tmp_path / f"b{shared_suffix()}"
    copy.write_bytes(output.read_bytes())
    assert shifted(copy, 3.0) == 40.0


def test_builds_at_the_same_time_do_not_meet(build: Build, tmp_path: Path) -> None:
    output = tmp_path / f"a{shared_suffix()}"
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: build(output), range(8))) == {output.resolve()}
    assert shifted(output, 3.0) == 8.0
    assert list(tmp_path.iterdir()) == [output]


def test_a_refused_source_is_reported_and_leaves_what_was_there(
    tmp_path: Path, build: Build
) -> None:
    output = build(tmp_path / f"a{shared_suffix()}")
    broken = tmp_path / "broken.c"
    broken.write_text("int f(void) { return undeclared_name; }\n")
    with pytest.raises(ToolchainError, match=r"(?s)broken\.c.*undeclared_name.*command: "):
        compile_shared([broken], output)
    assert shifted(output, 3.0) == 8.0
    assert sorted(tmp_path.iterdir()) == [output, broken]


def test_nothing_is_tuned_to_this_machine() -> None:
    assert not any(flag.startswith(("-march", "-mtune", "-Ofast")) for flag in toolchain.FLAGS)
    assert {"-ffp-contract=off", "-fno-fast-math", "-std=c99"} <= set(toolchain.FLAGS)


@pytest.fixture(scope="session")
def kernels(build: Build, tmp_path_factory: pytest.TempPathFactory) -> list[ctypes.CDLL]:
    """The same source by the host's compiler and by zig, allowed to use FMA where there is one."""
    folder = tmp_path_factory.mktemp("kernels")
    flags = ["-mfma"] if host_platform().startswith("x86_64") else []
    host_compiler.cache_clear()
    libraries = [build(folder / f"host{shared_suffix()}", flags=flags)]
    with pytest.MonkeyPatch.context() as patch:
        host_compiler.cache_clear()
        hide_compilers(patch, folder)
        libraries.append(build(folder / f"zig{shared_suffix()}", flags=flags))
    kernels = [ctypes.CDLL(str(path)) for path in libraries]
    for kernel in kernels:
        kernel.product_plus.argtypes = [ctypes.c_double] * 3
        kernel.total.argtypes = [ctypes.POINTER(ctypes.c_double), ctypes.c_int]
        kernel.product_plus.restype = kernel.total.restype = ctypes.c_double
    return kernels


@pytest.mark.slow
@given(a=FINITE, b=FINITE, c=FINITE)
def test_product_and_sum_are_rounded_one_by_one(
    kernels: list[ctypes.CDLL], a: float, b: float, c: float
) -> None:
    for kernel in kernels:
        assert kernel.product_plus(a, b, c) == a * b + c


@pytest.mark.slow
def test_a_fused_multiply_add_would_be_seen(kernels: list[ctypes.CDLL]) -> None:
    a = 1.0 + 2.0**-30  # a·a = 1 + 2⁻²⁹ + 2⁻⁶⁰, whose last term only a fused operation keeps
    for kernel in kernels:
        assert kernel.product_plus(a, a, -(1.0 + 2.0**-29)) == 0.0


@pytest.mark.slow
@given(st.lists(FINITE, max_size=40))
def test_sums_keep_their_order(kernels: list[ctypes.CDLL], values: list[float]) -> None:
    expected = 0.0
    for value in values:
        expected += value
    array = (ctypes.c_double * len(values))(*values)
    for kernel in kernels:
        assert kernel.total(array, len(values)) == expected


def assert_is_library_for(name: str, library: Path) -> None:
    magic, machine, place = SIGNATURES[name]
    content = library.read_bytes()
    assert content.startswith(magic)
    assert content[place : place + len(machine)] == machine


@pytest.mark.slow
def test_a_library_for_a_mac_is_made_here(build: Build, tmp_path: Path) -> None:
    name = "aarch64-darwin"
    assert_is_library_for(name, build(tmp_path / "a.dylib", platform=name))


@pytest.mark.slow
@pytest.mark.parametrize("name", PLATFORMS)
def test_libraries_for_all_platforms_are_made_here_and_twice_the_same(
    build: Build, tmp_path: Path, name: str
) -> None:
    outputs = [tmp_path / folder / f"a{shared_suffix(name)}" for folder in ("one", "two")]
    for output in outputs:
        build(output, platform=name)
    assert_is_library_for(name, outputs[0])
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


@pytest.mark.slow
def test_zig_needs_no_home_to_keep_its_cache_in(
    build: Build, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    hide_compilers(monkeypatch, tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "nobody"))
    monkeypatch.delenv("ZIG_GLOBAL_CACHE_DIR", raising=False)
    assert shifted(build(tmp_path / "libraries" / f"a{shared_suffix()}"), 3.0) == 8.0
    assert not (tmp_path / "nobody").exists()
