"""Models as firmware: the bits of the FMU in an emulator, no C library, and what is measured.

The whole matrix, with 100 000 steps of each model, is ``python -m tests.fmus.firmware``.
"""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile

from cosim.base.copies import replace
from fmus.build.archive import shipped_models
from fmus.build.toolchain import compile_shared
from fmus.firmware import folder, measure
from fmus.firmware.sources import FOLDER, files
from fmus.firmware.targets import OPTIONS, TARGETS, Compiler, Target, compilers
from fmus.model import Model

MODELS = {model.identifier: model for model in shipped_models()}
M4, M7 = TARGETS["cortex-m4"], TARGETS["cortex-m7"]
STEPS = 50


@pytest.fixture
def emulator() -> None:
    """QEMU for ARM; in CI it must be here."""
    if shutil.which(M4.emulator[0]) is None:
        missing = f"{M4.emulator[0]} is not installed"
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(missing)


def zig(target: Target) -> Compiler:
    return next(compiler for compiler in compilers(target) if compiler.name == "zig cc")


def digest_of(model: Model, target: Target, place: Path, *options: str) -> str:
    """The digest of STEPS steps in the emulator."""
    folder.write(model, target, place, measured=False)
    compiler = zig(target)
    compiler = Compiler(compiler.name, compiler.command, (*compiler.libraries, *options))
    measure.build(model, target, compiler, (place, place / "check.elf"), STEPS)
    ran = measure.run(place / "check.elf", target)
    assert ran is not None
    return ran.digest


@pytest.mark.usefixtures("emulator")
@pytest.mark.parametrize("name", ["teleoperation", "elastic_joint", "tdpa_admittance"])
@pytest.mark.parametrize("target", [M4, M7], ids=lambda target: target.name)
def test_a_microcontroller_has_the_bits_of_the_fmu(
    name: str, target: Target, tmp_path: Path
) -> None:
    assert digest_of(MODELS[name], target, tmp_path) == measure.expected(MODELS[name], STEPS)


@pytest.mark.usefixtures("emulator")
def test_the_check_notices_the_last_bit_of_a_start_value(tmp_path: Path) -> None:
    """The control."""
    model = MODELS["teleoperation"]
    changed = [
        replace(v, start=math.nextafter(v.starts[0], 9.0)) if v.name == "alpha" else v
        for v in model.variables
    ]
    other = replace(model, variables=tuple(changed))
    folder.write(model, M4, tmp_path, measured=False)
    (tmp_path / "teleoperation.c").write_text(files(other)["teleoperation.c"], encoding="utf-8")
    measure.build(model, M4, zig(M4), (tmp_path, tmp_path / "check.elf"), STEPS)
    ran = measure.run(tmp_path / "check.elf", M4)
    assert ran is not None
    assert ran.digest != measure.expected(model, STEPS)


def undefined(path: Path) -> set[str]:
    """The functions that an object file needs of others."""
    with path.open("rb") as file:
        symbols = ELFFile(file).get_section_by_name(".symtab").iter_symbols()
        return {s.name for s in symbols if s["st_shndx"] == "SHN_UNDEF" and s.name}


@pytest.mark.parametrize("name", ["arm_task_turn", "arm", "wave_integral_impedance"])
def test_a_model_needs_memcpy_and_memset_only(name: str, tmp_path: Path) -> None:
    model, output = MODELS[name], tmp_path / "model.o"
    for file, text in files(model).items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    command = [*zig(M4).command, *OPTIONS, "-c", str(tmp_path / f"{name}.c"), "-o", str(output)]
    subprocess.run(command, check=True)
    others = {n for n in undefined(output) if not n.startswith("__aeabi_")}
    assert others <= {"memcpy", "memset"}


def test_two_models_are_in_one_program(tmp_path: Path) -> None:
    """Both have kernels, tables, sine and cosine: names have that of the model before them."""
    text = {k: v for name in ("teleoperation", "planar2r") for k, v in files(MODELS[name]).items()}
    for file, content in text.items():
        (tmp_path / file).write_text(content, encoding="utf-8")
    library = ctypes.CDLL(str(compile_shared(sorted(tmp_path.glob("*.c")), tmp_path / "both.so",
                                             flags=["-fvisibility=default"])))  # fmt: skip
    for name in ("teleoperation", "planar2r"):
        size = sum(v.size for v in MODELS[name].variables)
        x, init = np.full(size, math.nan), getattr(library, f"{name}_init")
        init.restype = ctypes.c_char_p
        assert init(ctypes.c_void_p(x.ctypes.data)) is None
        assert np.isfinite(x).all()
        step = getattr(library, f"{name}_step")
        step.restype, step.argtypes = ctypes.c_char_p, [ctypes.c_void_p, *[ctypes.c_double] * 2]
        assert step(x.ctypes.data, 0.0, 0.0) == b"the step is not a positive finite number"
        first, _ = measure.inputs(MODELS[name])[0]
        x[first] = math.inf
        assert step(x.ctypes.data, 0.0, 0.01) == b"an input is not a finite number"


def test_start_calculates_again_from_changed_parameters(tmp_path: Path) -> None:
    model = MODELS["xi"]
    for file, content in files(model).items():
        (tmp_path / file).write_text(content, encoding="utf-8")
    made = compile_shared([tmp_path / "xi.c"], tmp_path / "xi.so", flags=["-fvisibility=default"])
    library, offset, place = ctypes.CDLL(str(made)), 0, {}
    for v in model.variables:
        place[v.name] = slice(offset, offset := offset + v.size)
    x = np.zeros(offset)
    library.xi_init(ctypes.c_void_p(x.ctypes.data))
    x[place["q"]], x[place["dq"]], x[place["alpha"]] = [1.0, 2.0], [3.0, 4.0], 10.0
    library.xi_start(ctypes.c_void_p(x.ctypes.data))
    assert x[place["xi"]].tolist() == [13.0, 24.0]


def test_the_header_has_all_variables_in_their_order_with_units() -> None:
    header = files(MODELS["teleoperation"])["teleoperation.h"]
    lines = [line.strip() for line in header.splitlines() if line.startswith("    double")]
    assert len(lines) == len(MODELS["teleoperation"].variables)
    assert lines[0] == "double q[2]; /* input, rad: Joint position */"
    assert "double xi_in[1][2]; /* input, rad/s: Received xi, a row a neighbour */" in lines
    assert "#define teleoperation_STEP 0.005 " in header


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_can_be_firmware(name: str) -> None:
    """Nothing is left of other systems, of FMI or of steps of several instances at once."""
    text = files(MODELS[name])[f"{name}.c"]
    included = {line.split()[1] for line in text.splitlines() if line.startswith("#include")}
    math_of_system = {"<math.h>", "<string.h>"}
    assert {n for n in included if n.startswith("<")} <= {
        "<stddef.h>",
        "<stdint.h>",
        *math_of_system,
    }
    assert "TOGETHER == 1" not in text.replace("between #if TOGETHER == 1 and", "")
    assert not any(word in text for word in ("fmi2", "fmi3", "malloc(", "wide_steps"))


ROOTS = (0.0, -0.0, 5e-324, 2.2e-308, 1.0, 2.0, 3.0, 0.1, 1e300, 1.7976931348623157e308, math.inf)


def test_the_square_root_without_a_library_is_that_of_the_system(tmp_path: Path) -> None:
    text = "".join(
        (FOLDER.parent / name).read_text(encoding="utf-8")
        for name in ("real.h", "contact.h", "firmware/library.h")
    )
    text += (FOLDER.parent / "contact.c").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith('#include "')]
    lines = [line for line in lines if line != "#include <string.h>"]  # of contact.c
    lines.append("double root(double x) { return sqrt(x); }")
    (tmp_path / "root.c").write_text("\n".join(lines) + "\n", encoding="utf-8")
    flags = ["-ffreestanding", "-fvisibility=default"]
    library = ctypes.CDLL(
        str(compile_shared([tmp_path / "root.c"], tmp_path / "root.so", flags=flags))
    )
    library.root.restype, library.root.argtypes = ctypes.c_double, [ctypes.c_double]
    drawn = np.random.default_rng(1).integers(0, 0x7FF0 << 48, 2000).view(np.float64)
    for x in (*ROOTS, *drawn.tolist(), 4e-320, 1e-310):
        assert library.root(x).hex() == math.sqrt(x).hex(), x
    assert math.isnan(library.root(-1.0))
    assert math.isnan(library.root(math.nan))


CHAIN = """
void take(int *x);
__attribute__((noinline)) static int leaf(int n) { int x[64]; take(x); return x[n]; }
int middle(int n) { int x[32]; take(x); return x[n] + leaf(n); }
int beside(int n) { int x[40]; take(x); return x[n]; }
"""


def test_the_worst_path_is_the_sum_of_the_frames_on_it(tmp_path: Path) -> None:
    """By what GCC says of each function: middle calls leaf; beside alone has less."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs gcc")
    (tmp_path / "chain.c").write_text(CHAIN, encoding="utf-8")
    output = tmp_path / "chain.o"
    options = ["-O2", "-ffunction-sections", "-fstack-usage", "-c", str(tmp_path / "chain.c")]
    subprocess.run([compiler, *options, "-o", str(output)], check=True)
    frame = {
        line.split("\t")[0].rpartition(":")[2]: int(line.split("\t")[1])
        for line in output.with_suffix(".su").read_text(encoding="utf-8").splitlines()
    }
    assert min(frame.values()) >= 128
    sizes = measure.sizes(output, output)
    assert sizes.frames == frame["middle"] + frame["leaf"] > frame["beside"]
    assert sizes.text > 0
    output.with_suffix(".su").unlink()
    assert measure.sizes(output, output).frames is None


def test_the_makefile_has_the_options_of_the_build(tmp_path: Path) -> None:
    """`make` builds with the same options, by the compiler that it is given."""
    folder.write(MODELS["pd"], M4, tmp_path, measured=False)
    words = ["make", "-n", "CC=some zig cc", "run"]
    if shutil.which("make") is None:
        pytest.skip("needs make")
    text = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert f"some zig cc {' '.join(M4.zig)} -fno-sanitize=undefined {' '.join(OPTIONS)}" in text
    assert " ".join(M4.emulator) in text
    assert measure.expected(MODELS["pd"], folder.STEPS) in text


def test_generic_is_checked_on_this_machine(tmp_path: Path) -> None:
    generic = TARGETS["generic"]
    assert folder.write(MODELS["pd"], generic, tmp_path) == []
    assert "Size and time" not in (tmp_path / "README.md").read_text(encoding="utf-8")
    (compiler, *_) = compilers(generic)
    measure.build(MODELS["pd"], generic, compiler, (tmp_path, tmp_path / "check"), STEPS)
    ran = measure.run(tmp_path / "check", generic)
    assert ran is not None
    assert ran.digest == measure.expected(MODELS["pd"], STEPS)
