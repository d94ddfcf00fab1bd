"""The compiled parts of a checkout, made again after a change: only what the change reaches.

``build_backend/compiled.py`` decides by contents which library is out of date, and compiles all its
files. Here the object of a file is taken from the folder of objects where the file and the headers
it includes are as they were once before.
"""

from __future__ import annotations

import hashlib
import re
import runpy
import shutil
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def build(root: Path, objects: Path) -> None:
    """Make the libraries and FMUs of the checkout `root`; `objects` is the folder of objects.

    Raises fmus.toolchain.ToolchainError where the compiler refuses a source.
    """
    from fmus import toolchain

    objects.mkdir(exist_ok=True)
    toolchain.compile_object = partial(_kept, objects, toolchain.compile_object)  # type: ignore[assignment]
    runpy.run_path(str(root / "build_backend" / "compiled.py"))["build"]()


def _kept(
    objects: Path, compile_object: Callable[..., Path], source: Path | str, output: Path, **how: Any
) -> Path:
    """As ``fmus.toolchain.compile_object``; the compiler runs only for what is not yet there."""
    folders = [Path(source).parent, *map(Path, how.get("include", ()))]
    digest = hashlib.sha256(repr((how.get("platform"), list(how.get("flags", ())))).encode())
    for text in texts(Path(source), folders):
        digest.update(hashlib.sha256(text).digest())
    known = objects / f"{digest.hexdigest()}.o"
    if not known.is_file():
        shutil.copyfile(compile_object(source, output, **how), known)
    shutil.copyfile(known, output)
    return output


def texts(source: Path, folders: Iterable[Path]) -> list[bytes]:
    """The contents of a C file and of the headers of ours that it includes, directly or not."""
    found: dict[Path, bytes] = {}
    left = [source]
    while left:
        here = left.pop()
        if here in found:
            continue
        found[here] = here.read_bytes()
        for name in _INCLUDE.findall(found[here].decode()):
            left += [folder / name for folder in folders if (folder / name).is_file()][:1]
    return list(found.values())
