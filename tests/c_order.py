"""The order of the C files of a folder: which names functions of which."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
_DEFINED = re.compile(
    r"^(?!static|INLINE|typedef|enum|#)[A-Za-z][^\n;{}=]*?\b(\w+)\([^;{}]*?\)\s*\{", re.M
)
#: Words of a file, without the members of structs.
_WORDS = re.compile(r"(?<![\w.])(?<!->)\w+")


def source(path: Path) -> str:
    """A file without its comments."""
    return re.sub(r"/\*.*?\*/", " ", path.read_text(encoding="utf-8"), flags=re.S)


@cache
def offered(files: Sequence[Path]) -> dict[str, Path]:
    """The file of each function that a file offers to others; several offer none of that name."""
    found = [(name, path) for path in files for name in set(_DEFINED.findall(source(path)))]
    count = Counter(name for name, _ in found)
    return {name: path for name, path in found if count[name] == 1}


@cache
def calls(files: Sequence[Path]) -> dict[Path, set[Path]]:
    """The files whose functions each file names."""
    homes = offered(files)
    return {
        path: {homes[word] for word in _WORDS.findall(source(path)) if word in homes} - {path}
        for path in files
    }


def includes(files: Sequence[Path]) -> dict[Path, set[Path]]:
    """The files among `files` that each of them includes."""
    return {
        path: {
            other
            for name in re.findall(r'#include "([\w./]+)"', source(path))
            for other in files
            if other == (path.parent / name).resolve()
        }
        for path in files
    }


def ordered(graph: Mapping[Path, set[Path]]) -> list[Path]:
    """The files from the bottom up. Raises graphlib.CycleError, which names the circle."""
    return list(TopologicalSorter(graph).static_order())
