"""Blocks of C code that a test executes: each sets a byte of its own when it begins.

A block is the body of a function, a branch or a loop, between its braces. The bytes lie in a file
that all processes map, so that a node or a command started by a test counts, too. What follows a
``return`` belongs to the block around it: more tests than necessary may be taken, never fewer.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.changes import masked

#: Names of their own for the C library's functions, and no header: a source may define macros that
#: have to come before the first ``#include``, and functions of the same names.
_HEAD = """\
#ifndef MUTANTS_MARK
#define MUTANTS_MARK
extern int mutants_open(const char *, int, ...) __asm__("open");
extern int mutants_close(int) __asm__("close");
extern void *mutants_map(void *, unsigned long, int, int, int, long) __asm__("mmap");
static void mutants_mark(unsigned long n) {
    static volatile char *marks;
    if (!marks) {
        int file = mutants_open("PLACE", 2);
        marks = mutants_map(0, SIZEul, 3, 1, file, 0);
        mutants_close(file);
    }
    if (marks != (char *)-1) marks[n] = 1;
}
#endif
"""
_BRACKET = re.compile(r"[(){}]")
_WORD = re.compile(r"\w*$")


@dataclass(frozen=True, slots=True)
class Block:
    """The code of `file` from offset `begin` up to `end`; `number` counts through all files."""

    file: Path
    begin: int
    end: int
    number: int


def blocks(files: Iterable[Path], root: Path) -> list[Block]:
    """The blocks of C files, file by file, inner ones before those around them."""
    found: list[Block] = []
    for file in files:
        for begin, end in _spans(masked((root / file).read_text(encoding="utf-8"))):
            found.append(Block(file, begin, end, len(found)))
    return found


def block_of(known: Iterable[Block], file: Path, at: int) -> int | None:
    """The number of the innermost block around offset `at` of a file; None outside of all."""
    around = (b for b in known if b.file == file and b.begin <= at < b.end)
    return next((block.number for block in around), None)


def instrumented(text: str, own: Iterable[Block], marks: Marks) -> str:
    """The text of a file whose `own` blocks set their marks."""
    for block in sorted(own, key=lambda block: -block.begin):
        mark = f" mutants_mark({block.number});"
        text = text[: block.begin] + mark + text[block.begin :]
    return _HEAD.replace("PLACE", str(marks.path)).replace("SIZE", str(marks.size)) + text


def _spans(code: str) -> Iterator[tuple[int, int]]:
    """Begin and end of each block, after its brace and before the other, in the order of ends."""
    opened: list[int] = []  # parentheses
    closed = 0  # where the parenthesis closed last was opened
    left: list[int] = []  # begin of the braces that are open; 0 where they hold no statements
    for found in _BRACKET.finditer(code):
        at = found.start()
        if found[0] == "(":
            opened.append(at)
        elif found[0] == ")":
            closed = opened.pop() if opened else 0
        elif found[0] == "{":
            left.append(at + 1 if _holds_statements(code, at, closed) else 0)
        elif left:
            begin = left.pop()
            if begin:
                yield begin, at


def _holds_statements(code: str, at: int, closed: int) -> bool:
    """True if a mark may follow the brace at `at`: not in data, not before the first ``case``."""
    before = code[:at].rstrip(" \t\n\0")
    if before.endswith(")"):
        head = code[:closed].rstrip()
        spaced = len(before) < at  # a compound literal has no space there
        return spaced and str(_WORD.findall(head)[0]) != "switch"
    return str(_WORD.findall(before)[0]) in ("else", "do")


class Marks:
    """A byte for each block, in a file that the processes of the tests map."""

    def __init__(self, path: Path, count: int) -> None:
        self.path, self.size = path, max(1, count)
        path.write_bytes(bytes(self.size))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), self.size)

    def take(self) -> list[int]:
        """The numbers of the blocks executed since the last time."""
        found = [number for number, mark in enumerate(self._memory[:]) if mark]
        self._memory[:] = bytes(self.size)
        return found
