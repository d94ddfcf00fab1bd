"""The programs whose digests must be the same everywhere, and the compilers they are built with."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from fmus.build.archive import shipped_models
from fmus.build.source import LANES, sources
from fmus.build.toolchain import WEB, compiler
from fmus.model import Model

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
GOLDEN = HERE / "golden.json"
ZIG = (sys.executable, "-m", "ziglang", "cc")
#: As libraries are built, but for the level of optimisation.
FLAGS = ("-std=c11", "-ffp-contract=off", "-fno-fast-math")


@dataclass(frozen=True, slots=True)
class Toolchain:
    """A compiler with its options; `emulator` runs what it makes, if this machine cannot."""

    name: str
    compiler: tuple[str, ...]
    emulator: tuple[str, ...] = ()

    def missing(self) -> str:
        """The program that is not here; empty: all are."""
        needed = [*self.compiler[:1], *self.emulator[:1]]
        return next((name for name in needed if shutil.which(name) is None), "")


def _zig(machine: str, *options: str, emulated: bool = True) -> Toolchain:
    """A static program of Clang's for another processor."""
    name = f"clang, {machine}{' ' if options else ''}{' '.join(options)}"
    target = (*ZIG, "-target", f"{machine}-linux-musl", "-static", "-O3", *options)
    return Toolchain(name, target, (f"qemu-{machine}-static",) if emulated else ())


def _page(runtime: str) -> Toolchain:
    """A program of WebAssembly, as pages have it."""
    command = compiler(WEB)
    command = command[command.index("cc") + 1 :]
    run = (sys.executable, "-m", "tests.bits.wasi", runtime)
    return Toolchain(f"WebAssembly in {runtime}", (*ZIG, *command, "-O2"), run)


NATIVE = (
    Toolchain("gcc -O0", ("gcc", "-O0")),
    Toolchain("gcc -O2", ("gcc", "-O2")),
    Toolchain("gcc -O3 -march=native", ("gcc", "-O3", "-march=native")),
    Toolchain("clang -O3 -march=native", (*ZIG, "-O3", "-march=native")),
)
EMULATED = (_zig("aarch64"), _zig("riscv64"), _zig("s390x"))
PAGES = (_page("node"), _page("wasmtime"))
#: What must give other bits: products and sums in one rounding.
CONTRACTED = Toolchain(
    "gcc -O3 -mfma -ffp-contract=fast", ("gcc", "-O3", "-mfma", "-ffp-contract=fast")
)


def write_model(model: Model, folder: Path) -> list[Path]:
    """Put the sources of a model into `folder`; returns its C files, without the FMI layer."""
    folder.mkdir(parents=True)
    for name, text in sources(model).items():
        (folder / name).write_text(text, encoding="utf-8")
    shutil.copy(HERE / "digest.h", folder)
    own = {Path(name).name for name in model.sources if name.endswith(".c")}
    own |= {"variables.c", *(name for name in LANES if model.lanes and name.endswith(".c"))}
    return [HERE / "kernel.c", *(folder / name for name in sorted(own))]


def digests(toolchain: Toolchain, folder: Path, names: Sequence[str] = ()) -> dict[str, str]:
    """The digest of each program, by name; `names`: of these only.

    Raises AssertionError with what was printed where a program does not compile or run.
    """
    models = [m for m in shipped_models() if not names or m.identifier in names]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = {}
        for model in models:
            place = folder / model.identifier
            files = write_model(model, place)
            found[model.identifier] = pool.submit(_run, toolchain, files, place, (place,))
        if not names or "engine" in names:
            place = folder / "engine"
            place.mkdir()
            include = (ROOT / "cosim/c", HERE)
            files = [HERE / "plan.c", ROOT / "cosim/c/mailbox.c"]
            found["engine"] = pool.submit(_run, toolchain, files, place, include)
        return {name: made.result() for name, made in found.items()}


def _run(toolchain: Toolchain, files: Sequence[Path], folder: Path, include: Sequence[Path]) -> str:
    program = folder / "program"
    command = [toolchain.compiler[0], *FLAGS, *toolchain.compiler[1:]]
    if toolchain.compiler[: len(ZIG)] == ZIG:
        command = [*ZIG, *FLAGS, *toolchain.compiler[len(ZIG) :]]
    command += [f"-I{path}" for path in include]
    built = subprocess.run(
        [*command, "-o", str(program), *map(str, files), "-lm"], capture_output=True, text=True
    )
    assert built.returncode == 0, f"{toolchain.name}: {built.stderr}"
    ran = subprocess.run(
        [*toolchain.emulator, str(program)], capture_output=True, text=True, cwd=ROOT
    )
    done = ran.returncode == 0 or toolchain is CONTRACTED  # whose lanes differ, too
    assert done, f"{toolchain.name}, {folder.name}: {ran.stdout}{ran.stderr}"
    return ran.stdout.strip()


def golden() -> dict[str, str]:
    """The digests that everyone must get."""
    found: dict[str, str] = json.loads(GOLDEN.read_text(encoding="utf-8"))
    return found
