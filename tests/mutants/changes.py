"""Places in C and Python sources where one small change makes another program."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: Mutants that no test can notice.
EQUIVALENT = Path(__file__).with_name("equivalent.toml")
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
    """`old` at offset `at` of a file becomes `new`; `file` is relative to the checkout."""

    file: Path
    at: int
    old: str
    new: str

    def apply(self, text: str) -> str:
        """The text of the file with the change."""
        return text[: self.at] + self.new + text[self.at + len(self.old) :]

    def key(self, root: Path) -> str:
        """File, change and line, as ``tests/mutants/equivalent.toml`` names it."""
        place, _, change = self.said(root).partition(": ")
        return f"{place.rpartition(':')[0]}: {change}"

    def said(self, root: Path) -> str:
        """File, number of the line, change and line, in the unchanged checkout `root`."""
        text = (root / self.file).read_text(encoding="utf-8")
        line = text.count("\n", 0, self.at) + 1
        there = text.splitlines()[line - 1].strip()
        change = f"{self.old.strip()!r} to {self.new.strip()!r}"
        return f"{self.file}:{line}: {change} in: {there}"


def masked(text: str) -> str:
    """The text with zeros in place of comments, texts and directives; each offset stays."""
    return _CODE.sub(lambda found: re.sub(r"[^\n]", "\0", found[0]), text)


def mutants(file: Path, root: Path) -> Iterator[Mutant]:
    """All of a file, in the order of their places; none in comments, texts and directives."""
    for found in _SWAP.finditer(masked(file.read_text(encoding="utf-8"))):
        yield Mutant(file.relative_to(root), found.start(), found[0], SWAPS[found[0]])


def equivalent() -> dict[str, str]:
    """The mutants that are the same program as before, by key; of each the reason."""
    with EQUIVALENT.open("rb") as file:
        return {mutant["change"]: mutant["why"] for mutant in tomllib.load(file)["mutant"]}
