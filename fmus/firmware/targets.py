"""Processors that firmware is built for, and their compilers and emulators."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from dataclasses import dataclass
from importlib.util import find_spec

from fmus.build.toolchain import FLAGS, host_compiler

#: Options of every compiler: as libraries are built, without a C library, each function apart so
#: that the linker leaves out what is not called. A square root sets no errno.
OPTIONS = (
    *FLAGS,
    "-ffreestanding",
    "-fno-math-errno",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-asynchronous-unwind-tables",
    "-Werror=implicit-function-declaration",
)
#: Options of a target with a C library.
HOSTED = tuple(option for option in OPTIONS if option != "-ffreestanding")
_QEMU = ("-display", "none", "-monitor", "none", "-serial", "none")
#: The console of a board is the standard output.
_SEMIHOSTING = (
    *("-chardev", "stdio,id=console"),
    *("-semihosting-config", "enable=on,target=native,chardev=console"),
)


@dataclass(frozen=True, slots=True)
class Target:
    """A processor: its compiler and options, those of zig, the files of its board, its emulator.

    `emulator` without the file to run; empty: the check runs on this machine.
    """

    name: str
    processor: str
    gcc: tuple[str, ...]
    zig: tuple[str, ...]
    board: tuple[str, ...]
    emulator: tuple[str, ...] = ()

    @property
    def script(self) -> str:
        """The file for the linker; empty: none."""
        return next((name for name in self.board if name.endswith(".ld")), "")


@dataclass(frozen=True, slots=True)
class Compiler:
    """A command that compiles for a target, and what it links at the end."""

    name: str
    command: tuple[str, ...]
    libraries: tuple[str, ...] = ()


def _cortex(name: str, machine: str, gcc: str, zig: str) -> Target:
    board = ("cortex_m.c", "cortex_m.ld", "freestanding.c", "board.h")
    icount = ("-icount", "shift=10,sleep=off")
    emulator = ("qemu-system-arm", "-M", machine, *_QEMU, *_SEMIHOSTING, *icount, "-kernel")
    command = ("arm-none-eabi-gcc", "-mthumb", *gcc.split())
    processor = f"{name.title()}, doubles in {'hardware' if 'hard' in gcc else 'software'}"
    return Target(name, processor, command, tuple(zig.split()), board, emulator)


TARGETS = {
    target.name: target
    for target in (
        _cortex(
            *("cortex-m4", "mps2-an386", "-mcpu=cortex-m4 -mfloat-abi=soft"),
            "-target thumb-freestanding-eabi -mcpu=cortex_m4+soft_float",
        ),
        _cortex(
            *("cortex-m7", "mps2-an500", "-mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard"),
            "-target thumb-freestanding-eabihf -mcpu=cortex_m7+fp_armv8d16",
        ),
        Target(
            *("riscv32", "RISC-V RV32IMAC, doubles in software"),
            ("riscv64-unknown-elf-gcc", "-march=rv32imac", "-mabi=ilp32"),
            ("-target", "riscv32-freestanding-none", "-mcpu=generic_rv32+m+a+c", "-mabi=ilp32"),
            ("riscv32.c", "riscv32.ld", "freestanding.c", "board.h"),
            (
                *("qemu-system-riscv32", "-M", "virt", "-bios", "none", *_QEMU, *_SEMIHOSTING),
                *("-icount", "shift=0,sleep=off", "-kernel"),
            ),
        ),
        Target("generic", "any, with an operating system", (), (), ("host.c", "board.h")),
    )
}


def compilers(target: Target) -> list[Compiler]:
    """The compilers for `target` that are here: ``$CC`` alone if it is set, else those known."""
    if not target.gcc:
        host = host_compiler()
        return [] if host is None else [Compiler(os.path.basename(host[0]), host)]
    if os.environ.get("CC", "").strip():
        words = tuple(shlex.split(os.environ["CC"]))
        return [_zig(target, words) if "zig" in " ".join(words) else _gcc(target, words)]
    found = [_gcc(target, target.gcc[:1])] if shutil.which(target.gcc[0]) else []
    if find_spec("ziglang") is not None:
        found.append(_zig(target, (sys.executable, "-m", "ziglang", "cc")))
    return found


def _gcc(target: Target, words: tuple[str, ...]) -> Compiler:
    return Compiler(words[0], (*words, *target.gcc[1:]), ("-nostdlib", "-lgcc"))


def _zig(target: Target, words: tuple[str, ...]) -> Compiler:
    return Compiler("zig cc", (*words, *target.zig, "-fno-sanitize=undefined"))
