"""The check of a model as firmware: built, measured, run in an emulator, compared with the FMU."""

from __future__ import annotations

import ctypes
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fmus.build import kernel
from fmus.build.toolchain import ToolchainError
from fmus.firmware.targets import HOSTED, OPTIONS, Compiler, Target, compilers
from fmus.model import Model

#: A step of the check in which the inputs change, every so many.
_EACH = 7
_LINE = re.compile(
    r"digest (\w+) steps \d+ refused (\d+) instructions (\d+) most (\d+) stack (\d+)"
)
_WRITABLE, _ALLOCATED, _EXECUTABLE = 1, 2, 4  # SHF_WRITE, SHF_ALLOC, SHF_EXECINSTR


@dataclass(frozen=True, slots=True)
class Ran:
    """The line that the check prints: `stack` in bytes, `instructions` and `most` per step."""

    digest: str
    refused: int
    instructions: int
    most: int
    stack: int


@dataclass(frozen=True, slots=True)
class Sizes:
    """Bytes of an image; `frames`: of the functions of the model that call each other, at most."""

    text: int
    data: int
    bss: int
    frames: int | None


def obstacle(target: Target) -> str:
    """The reason why nothing can be measured; empty: there is none."""
    if not target.script:
        return f"{target.name} is no processor"
    if not compilers(target):
        return f"neither {target.gcc[0]} nor ziglang is installed"
    if find_spec("elftools") is None:
        return "pyelftools is not installed (pip install 'cosim-bridge[build]')"
    return ""


def build(
    model: Model, target: Target, compiler: Compiler, place: tuple[Path, Path], steps: int
) -> Sizes:
    """Compile the check. `place`: the folder of the sources, and the program to make, with its
    object files beside it. Raises ToolchainError with the compiler's last lines.
    """
    folder, output = place
    output.parent.mkdir(parents=True, exist_ok=True)
    options = [*compiler.command, *(OPTIONS if target.script else HOSTED)]
    own = output.with_name(f"{model.identifier}.o")
    usage = ["-fstack-usage"] if target.script else []
    _run([*options, *usage, "-c", folder / f"{model.identifier}.c", "-o", own])
    others = [folder / name for name in ("check.c", *target.board) if name.endswith(".c")]
    script: list[str | Path] = []
    if target.script:
        script = ["-T", folder / target.script, "-Wl,--gc-sections"]
    define = f"-DSTEPS={steps}"
    _run([*options, define, own, *others, *script, *compiler.libraries, "-o", output])
    return sizes(output, own)


def sizes(program: Path, own: Path) -> Sizes:
    """The sizes of a program, and the stack of the model's object file `own`."""
    from elftools.elf.elffile import ELFFile

    text = data = bss = 0
    with program.open("rb") as file:
        for section in ELFFile(file).iter_sections():
            flags, size = section["sh_flags"], section["sh_size"]
            if not flags & _ALLOCATED:
                continue
            if section["sh_type"] == "SHT_NOBITS":
                bss += size
            elif flags & _WRITABLE and not flags & _EXECUTABLE:
                data += size
            else:
                text += size
    return Sizes(text, data, bss, _frames(own))


def _frames(own: Path) -> int | None:
    """The bytes of stack on the worst path through an object file; None if the compiler does not
    tell. Functions of this project do not call themselves.
    """
    usage = own.with_suffix(".su")
    if not usage.is_file():
        return None
    rows = (line.split("\t") for line in usage.read_text(encoding="utf-8").splitlines())
    frame = {row[0].rpartition(":")[2]: int(row[1]) for row in rows}
    calls = _calls(own)

    def deepest(name: str) -> int:
        below = (deepest(called) for called in calls.get(name, set()) if called != name)
        return frame.get(name, 0) + max(below, default=0)

    return max(map(deepest, frame), default=0)


def _calls(own: Path) -> dict[str, set[str]]:
    """The functions that each function refers to, by the relocations of its section."""
    from elftools.elf.elffile import ELFFile
    from elftools.elf.relocation import RelocationSection
    from elftools.elf.sections import SymbolTableSection

    found: dict[str, set[str]] = {}
    with own.open("rb") as file:
        elf = ELFFile(file)
        for section in elf.iter_sections():
            if not isinstance(section, RelocationSection):
                continue
            name = elf.get_section(section["sh_info"]).name
            symbols = elf.get_section(section["sh_link"])
            if not name.startswith(".text.") or not isinstance(symbols, SymbolTableSection):
                continue
            for relocation in section.iter_relocations():
                symbol = symbols.get_symbol(relocation["r_info_sym"])
                called = symbol.name
                if symbol["st_info"]["type"] == "STT_SECTION":
                    called = elf.get_section(symbol["st_shndx"]).name.removeprefix(".text.")
                found.setdefault(name.removeprefix(".text."), set()).add(called)
    return found


def run(program: Path, target: Target) -> Ran | None:
    """Run the check; None if the emulator is not installed. Raises ToolchainError if it fails."""
    if target.emulator and shutil.which(target.emulator[0]) is None:
        return None
    text = _run([*target.emulator, program.resolve()])
    found = _LINE.search(text)
    if found is None:
        raise ToolchainError(f"the check {program} printed {text!r}; expected its digest")
    digest, *numbers = found.groups()
    return Ran(digest, *map(int, numbers))


def _run(command: Sequence[str | Path]) -> str:
    """The output of a command. Raises ToolchainError with its last lines if it fails."""
    words = [str(word) for word in command]
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            words, capture_output=True, text=True, errors="replace", env=environment
        )
    except OSError as error:
        raise ToolchainError(f"cannot start {words[0]!r}: {error.strerror}") from None
    if done.returncode:
        last = "\n  ".join((done.stdout + done.stderr).strip().splitlines()[-20:])
        raise ToolchainError(
            f"firmware: exit code {done.returncode}:\n  {last}\ncommand: {shlex.join(words)}"
        )
    return done.stdout


def inputs(model: Model) -> list[tuple[int, int]]:
    """(first scalar, number of scalars) of each input of a model."""
    found, offset = [], 0
    for variable in model.variables:
        if variable.causality == "input":
            found.append((offset, variable.size))
        offset += variable.size
    return found


def expected(model: Model, steps: int) -> str:
    """The digest that the check has to print, by the kernel in the model's FMU (``check.c``)."""
    library = kernel.load(kernel.library(model))
    x = np.zeros(library.kernel_size())
    address, bits = x.ctypes.data, x.view(np.uint64)
    places = [first + k for first, size in inputs(model) for k in range(size)]
    state, digest, mask = 1, 0xCBF29CE484222325, (1 << 64) - 1

    def begin() -> None:
        library.kernel_reset(address)
        library.kernel_initial(address)

    begin()
    for i in range(steps):
        if i % _EACH == 0:
            for place in places:
                state = (state * 6364136223846793005 + 1442695040888963407) & mask
                x[place] += 0.25 * ((state >> 11) * 2.0**-52 - 1.0)
        why = library.kernel_step(ctypes.c_void_p(address), i * model.step, model.step)
        for value in bits.tolist():
            digest = ((digest ^ value) * 0x100000001B3) & mask
            digest ^= digest >> 29
        if why:
            begin()
    return f"{digest:016x}"
