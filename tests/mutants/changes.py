"""Places in C and Python sources where one small change makes another program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: What is replaced by what, where it stands in code; sources are formatted, so spaces tell a binary
#: operator from the other uses of its character.
SWAPS = {
    " < ": " <= ",
    " <= ": " < ",
    " > ": " >= ",
    " >= ": " > ",
    " == ": " != ",
    " != ": " == ",
    " + ": " - ",
    " - ": " + ",
    " * ": " / ",
    " += ": " -= ",
    " && ": " || ",
    " || ": " && ",
    " and ": " or ",
    " or ": " and ",
    " is None": " is not None",
    " is not None": " is None",
    "return 0;": "return 1;",
    "return 1;": "return 0;",
    "++;": "--;",
    "(!": "(",
    " not in ": " in ",
}
_CODE = re.compile(
    r'"""[\s\S]*?"""|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])+\'|/\*[\s\S]*?\*/|//[^\n]*'
    r"|^[ \t]*#[^\n]*|(?<=  )#[^\n]*",
    re.MULTILINE,
)
_SWAP = re.compile("|".join(re.escape(text) for text in sorted(SWAPS, key=len, reverse=True)))


@dataclass(frozen=True, slots=True)
class Mutant:
    """`old` at offset `at` of a file becomes `new`."""

    file: Path
    at: int
    old: str
    new: str

    def apply(self, text: str) -> str:
        """The text of the file with the change."""
        return text[: self.at] + self.new + text[self.at + len(self.old) :]

    def said(self, text: str, root: Path) -> str:
        """File, line and what is changed there."""
        line = text.count("\n", 0, self.at) + 1
        there = text.splitlines()[line - 1].strip()
        change = f"{self.old.strip()!r} to {self.new.strip()!r}"
        return f"{self.file.relative_to(root)}:{line}: {change} in: {there}"


def mutants(file: Path) -> Iterator[Mutant]:
    """All of a file, in the order of their places; none in comments, texts and directives."""
    text = file.read_text(encoding="utf-8")
    code = _CODE.sub(lambda found: re.sub(r"[^\n]", "\0", found[0]), text)
    for found in _SWAP.finditer(code):
        yield Mutant(file, found.start(), found[0], SWAPS[found[0]])
