"""The compiled parts of a checkout, made again after a change: only what the change reaches.

``build_backend/compiled.py`` decides by contents which library is out of date, and compiles all its
files. Here an object or a library is taken from a folder where what it is made from is as it was
once before.
"""

from __future__ import annotations

import hashlib
import os
import re
import runpy
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def keep(objects: Path) -> None:
    """From now on this process and those forked from it compile and link only what is new.

    `objects`: the folder for objects and libraries, by the contents of what they are made from.
    """
    from fmus import toolchain

    objects.mkdir(exist_ok=True)
    toolchain.compile_object = partial(_compiled, objects, toolchain.compile_object)  # type: ignore[assignment]
    toolchain.link_shared = partial(_linked, objects, toolchain.link_shared)  # type: ignore[assignment]


def build(root: Path) -> None:
    """Make the libraries and FMUs of the checkout `root`.

    Raises fmus.toolchain.ToolchainError where the compiler refuses a source.
    """
    runpy.run_path(str(root / "build_backend" / "compiled.py"))["build"]()


def _compiled(
    objects: Path, compile_object: Callable[..., Path], source: Path | str, output: Path, **how: Any
) -> Path:
    """As ``fmus.toolchain.compile_object``; the compiler runs only for what is not yet there."""
    folders = [Path(source).parent, *map(Path, how.get("include", ()))]
    made_from = texts(Path(source), folders)
    return _kept(
        objects, ".o", how, made_from, Path(output), lambda: compile_object(source, output, **how)
    )


def _linked(
    objects: Path,
    link_shared: Callable[..., Path],
    parts: Iterable[Path],
    output: Path | str,
    **how: Any,
) -> Path:
    """As ``fmus.toolchain.link_shared``; the linker runs only for what is not yet there."""
    given = list(parts)
    made_from = [part.read_bytes() for part in given]
    target = Path(output).resolve()
    return _kept(
        objects, target.name, how, made_from, target, lambda: link_shared(given, output, **how)
    )


def _kept(
    objects: Path,
    name: str,
    how: Mapping[str, Any],
    made_from: Iterable[bytes],
    output: Path,
    make: Callable[[], Path],
) -> Path:
    """The file `output`, copied from the folder of objects or made and put there.

    Each copy appears complete: a process that has an older library mapped keeps it.
    """
    digest = hashlib.sha256(repr((name, how.get("platform"), list(how.get("flags", ())))).encode())
    for text in made_from:
        digest.update(hashlib.sha256(text).digest())
    known = objects / digest.hexdigest()
    if known.is_file():
        _copy(known, output)
    else:
        _copy(make(), known)
    return output


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(dir=target.parent)
    os.close(handle)
    shutil.copy(source, scratch)
    os.replace(scratch, target)


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
