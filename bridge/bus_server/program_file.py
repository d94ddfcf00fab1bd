"""The file of a program: found as the shell finds it, and checked for LD_PRELOAD."""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Sequence
from pathlib import Path

from cosim.base.errors import CosimError

_INTERPRETER = 3
"""PT_INTERP: the program header that names the loader of a dynamic program (ELF, part 2)."""


class ProgramError(CosimError, ValueError):
    """A program that cannot be run in the time of a bus."""


def check_program(command: Sequence[str]) -> None:
    """Raise ProgramError for a program that is missing, static, or runs with other rights."""
    name = command[0]
    found = shutil.which(name)
    if found is None:
        raise ProgramError(f"{name}: found no such program, expected a file that can be executed")
    path = Path(found)
    status = path.stat()
    if status.st_mode & 0o6000 and status.st_uid != os.geteuid():
        raise ProgramError(
            f"{name}: found a setuid program, into which no library can be preloaded; run it as "
            "its owner, or give it the bus by --socketcand without simulated time"
        )
    head = path.read_bytes()[:4096]
    if head.startswith(b"#!"):
        words = head[2:].split(b"\n", 1)[0].decode("utf-8", "replace").split()
        words = [w for w in words if not w.startswith("-")]
        if words and Path(words[0]).name == "env":
            words = words[1:]
        if words:
            check_program(words[:1])
    elif head.startswith(b"\x7fELF"):
        _check_loader(name, path)


def _check_loader(name: str, path: Path) -> None:
    """Raise ProgramError where an ELF file has no loader, or one that is not glibc's of 64 bits."""
    content = path.read_bytes()
    if content[4] != 2:
        raise ProgramError(f"{name}: found a program of 32 bits, expected one of 64 bits")
    start, size, count = (
        *struct.unpack_from("<Q", content, 32), *struct.unpack_from("<HH", content, 54),
    )  # fmt: skip
    for n in range(count):
        kind, _, offset, _, _, length = struct.unpack_from("<IIQQQQ", content, start + n * size)
        if kind == _INTERPRETER:
            loader = content[offset : offset + length].rstrip(b"\0").decode("utf-8", "replace")
            if "musl" in loader:
                raise ProgramError(f"{name}: found a program for musl, expected one for glibc")
            return
    raise ProgramError(
        f"{name}: found a static program (no PT_INTERP), into which no library can be preloaded; "
        "link it dynamically, or run it beside `cosim bus` on the wall clock"
    )
