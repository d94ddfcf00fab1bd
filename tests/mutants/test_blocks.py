"""Each block of C code that a test executes is marked, and no other; data has no marks."""

from __future__ import annotations

import ctypes
from pathlib import Path

from fmus.build.toolchain import compile_shared
from tests.mutants.blocks import Marks, block_of, blocks, instrumented
from tests.mutants.coverage import code_lines

SOURCE = """\
#define _GNU_SOURCE
#include <fcntl.h>
typedef struct {
    int a[2];
} Pair; /* if (x) { */
#define TWICE(NAME) \\
    int NAME(int x) { \\
        return 2 * x; \\
    }
static Pair made(int a) {
    Pair pair = {
        { a, 0 },
    };
    return pair;
}
TWICE(twice)
int f(int x) {
    switch (x) {
    case 1: return (Pair){ { 1, 2 } }.a[0];
    default: break;
    }
    for (int n = 0; n < x; n++) {
        if (n == 5) {
            return 5;
        } else {
            x--;
        }
    }
    do {
        x += made(1).a[0];
    } while (x < 0);
    return x + 7;
}
"""
#: Of code inside it, the block that it is in, by number; None: in none.
INSIDE = {
    "int a[2]": None,
    "return 2 * x": 0,
    "return pair": 1,
    "return 5": 2,
    "x--": 3,
    "n == 5": 4,
    "made(1)": 5,
    "n < x": 6,
    "x < 0": 6,
    "case 1": 6,
    "x + 7": 6,
}


def test_each_place_belongs_to_the_innermost_block_around_it(tmp_path: Path) -> None:
    (tmp_path / "f.c").write_text(SOURCE)
    found = blocks([Path("f.c")], tmp_path)
    numbers = {text: block_of(found, Path("f.c"), SOURCE.index(text)) for text in INSIDE}
    assert numbers == INSIDE
    assert block_of(found, Path("g.c"), SOURCE.index("x + 7")) is None


def test_what_is_executed_is_marked(tmp_path: Path) -> None:
    (tmp_path / "f.c").write_text(
        SOURCE.replace("int f(", '__attribute__((visibility("default"))) int f(')
    )
    marks = Marks(tmp_path / "marks", 7)
    text = instrumented((tmp_path / "f.c").read_text(), blocks([Path("f.c")], tmp_path), marks)
    (tmp_path / "f.c").write_text(text)
    library = ctypes.CDLL(str(compile_shared([tmp_path / "f.c"], tmp_path / "f.so")))
    executed = []
    for x in (1, 0, 2, 20):
        library.f(x)
        executed.append(marks.take())
    assert executed == [[6], [1, 5, 6], [1, 3, 4, 5, 6], [2, 3, 4, 6]]
    assert marks.take() == []


def test_lines_with_code_count_by_the_innermost_block(tmp_path: Path) -> None:
    text = (
        "int f(int x)\n{\n    int y = 0; /* { */\n\n    if (x) {\n"
        "        y = 1;\n        y++;\n    }\n    // nothing\n    return y;\n}\nint g;\n"
    )
    (tmp_path / "a.c").write_text(text)
    known = blocks([Path("a.c")], tmp_path)
    inner, outer = sorted(known, key=lambda block: block.end - block.begin)
    assert code_lines(text, known, {outer.number}) == (3, 5)
    assert code_lines(text, known, {outer.number, inner.number}) == (5, 5)
    assert code_lines(text, known, set()) == (0, 5)
