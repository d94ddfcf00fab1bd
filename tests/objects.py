"""Objects and libraries by their sources: what was compiled before is not compiled again."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from fmus.build import toolchain

_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def keep(folder: Path, patch: Callable[[object, str, object], None] = setattr) -> None:
    """Compile and link only what is new, in this process and those forked from it.

    `folder`: for objects and libraries, by the contents of what they are made from; `patch` sets an
    attribute of a module.
    """
    folder.mkdir(parents=True, exist_ok=True)
    patch(toolchain, "compile_object", partial(_compiled, folder, toolchain.compile_object))
    patch(toolchain, "link_shared", partial(_linked, folder, toolchain.link_shared))


def _compiled(
    folder: Path, compile_object: Callable[..., Path], source: Path | str, output: Path, **how: Any
) -> Path:
    """``toolchain.compile_object`` that runs the compiler only for what is not yet there."""
    folders = [Path(source).parent, *map(Path, how.get("include", ()))]
    made_from = texts(Path(source), folders)
    return _kept(
        folder, ".o", how, made_from, Path(output), lambda: compile_object(source, output, **how)
    )


def _linked(
    folder: Path,
    link_shared: Callable[..., Path],
    parts: Iterable[Path],
    output: Path | str,
    **how: Any,
) -> Path:
    """``toolchain.link_shared`` that runs the linker only for what is not yet there."""
    given = list(parts)
    made_from = [part.read_bytes() for part in given]
    target = Path(output).resolve()
    return _kept(
        folder, target.name, how, made_from, target, lambda: link_shared(given, output, **how)
    )


def _kept(
    folder: Path,
    name: str,
    how: Mapping[str, Any],
    made_from: Iterable[bytes],
    output: Path,
    make: Callable[[], Path],
) -> Path:
    """The file `output`, copied from the folder or made and put there.

    Each copy appears complete: a process that has an older library mapped keeps it.
    """
    said = {word: list(value or ()) for word, value in how.items() if word != "include"}
    digest = hashlib.sha256(repr((name, sorted(said.items()))).encode())
    for text in made_from:
        digest.update(hashlib.sha256(text).digest())
    known = folder / digest.hexdigest()
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
        here = left.pop().resolve()
        if here in found:
            continue
        found[here] = here.read_bytes()
        for name in _INCLUDE.findall(found[here].decode()):
            places = [here.parent, *folders]
            left += [folder / name for folder in places if (folder / name).is_file()][:1]
    return list(found.values())
