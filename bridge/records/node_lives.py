"""A life of a node: the node, and the number of its process in a run.

A life has one text form, which is used in file names and reports: ``slave`` is the first life of
the node ``slave``, ``slave@2`` the second. Characters that are not allowed in a file name or in the
text form are percent-encoded, so two lives never have the same files. Only this module writes and
parses the text form.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TypeVar, final
from urllib.parse import quote, unquote

T = TypeVar("T")
#: Between the node's name and the number of a later life.
SEPARATOR = "@"
#: What stands in file names as it is, besides letters and digits of any script.
_PLAIN = "_-."


@final
@dataclass(frozen=True, slots=True, order=True)
class Life:
    """One life of a node; `boot`: 1 for the first one of a run, then 2, 3, ..."""

    node: str
    boot: int = 1

    def __str__(self) -> str:
        """The text form: ``slave``, ``slave@2``."""
        later = f"{SEPARATOR}{self.boot}" if self.boot > 1 else ""
        return f"{_encoded(self.node, _PLAIN)}{later}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The life of a text. A text that no life has (``x@one``) raises ValueError."""
        node, separator, boot = text.rpartition(SEPARATOR)
        found = cls(unquote(node), int(boot)) if separator else cls(unquote(text))
        if str(found) != text:
            raise ValueError(f"{text!r} is not a valid name of a life; expected {str(found)!r}")
        return found

    def file(self, kind: str) -> str:
        """The name of its file of a kind: ``slave@2.journal``."""
        return f"{self}.{kind}"

    def frames(self, bus: str) -> str:
        """The name of its log of a bus: ``slave.left.frames``."""
        return f"{self}.{_encoded(bus, '_-')}.frames"


@final
class ByLife(dict[Life, T]):
    """Something by life; a life may be named by its text: ``rows["slave@2"]``."""

    def __missing__(self, key: object) -> T:
        if isinstance(key, str):
            return self[Life.parse(key)]
        raise KeyError(key)


def lives_of(lives: Iterable[Life], node: str) -> list[Life]:
    """The lives of a node, in their order."""
    return sorted(life for life in lives if life.node == node)


def files(folder: Path, kind: str) -> dict[Life, Path]:
    """Files of a kind (``journal``, ``json``, ...) by life, sorted; others are passed over."""
    return dict(sorted(_files(folder, kind)))


def frame_files(folder: Path, bus: str) -> dict[Life, Path]:
    """The logs of a bus by life, sorted."""
    kind = Life("").frames(bus).removeprefix(".")
    return files(folder, kind)


def _files(folder: Path, kind: str) -> Iterator[tuple[Life, Path]]:
    for path in folder.iterdir() if folder.is_dir() else ():
        if not path.name.endswith(f".{kind}"):
            continue
        try:
            yield Life.parse(path.name.removesuffix(f".{kind}")), path
        except ValueError:
            continue  # somebody else's file


def _encoded(name: str, plain: str) -> str:
    """A name, with everything but letters, digits and `plain` as the bytes of its UTF-8."""
    return "".join(x if x.isalnum() or x in plain else quote(x, safe="") for x in name)
