"""The structs, enumerators and functions that a build reads from the C headers."""

from __future__ import annotations

import importlib
import sys
from enum import IntFlag
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.c_probe import differences, members, probe

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "build_backend"))
c_headers = importlib.import_module("c_headers")
c_structs = importlib.import_module("c_structs")
sys.path.remove(str(ROOT / "build_backend"))


def read(folder: Path, text: str) -> Any:
    header = folder / "small.h"
    header.write_text(text)
    return c_headers.read([header], [], folder)


def module_of(folder: Path, text: str, **special: Any) -> ModuleType:
    """``structs.py`` of a header, imported."""
    library = c_structs.Library("small", "", **special)
    made = ModuleType("small")
    exec(c_structs._Structs(library, read(folder, text)).text(), made.__dict__)
    return made


@pytest.mark.parametrize("library", c_structs.LIBRARIES, ids=lambda library: library.package)
def test_a_compiler_sees_the_same(library: Any, tmp_path: Path) -> None:
    found = library.declarations()
    structs = importlib.import_module(f"{library.package}.structs")
    enums = importlib.import_module(f"{library.package}.enums")
    classes = {s.name: getattr(structs, library.class_name(s.name)) for s in found.structs}
    names = [name for enum in found.enums for name in enum.values]
    own = {name: members(struct) for name, struct in classes.items()}
    said = probe(library.own(), own, names, tmp_path)
    assert {name: differences(s, said["structs"][name]) for name, s in classes.items()} == {
        name: [] for name in classes
    }
    here = {name: value for enum in found.enums for name, value in enum.values.items()}
    assert here == said["names"]
    constants = {n: v for e in found.enums if not e.tag for n, v in e.values.items()}
    assert constants.items() <= vars(enums).items()


def test_pointers_arrays_and_structs_in_structs(tmp_path: Path) -> None:
    made = module_of(
        tmp_path,
        "enum { ROWS = 2, ALL = ROWS * 2 + 1 };\n"
        "typedef struct { int32_t a, b[ALL]; /* int c; */ } inner_t;\n"
        "typedef struct node { const inner_t *one, two; char text[ROWS][8]; void *more[3];\n"
        "    int32_t (*call)(void *, double); struct node *next; _Bool on; } node_t;\n",
        pointers=True,
    )
    fields = dict(made.NodeStruct._fields_)
    assert [*fields] == ["one", "two", "text", "more", "call", "next", "on"]
    assert made.InnerStruct.b.size == 20
    assert fields["one"]._type_ is fields["two"] is made.InnerStruct
    assert (made.NodeStruct.text.size, made.NodeStruct.more.size) == (16, 24)


def test_enumerators_count_and_shifts_are_flags(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        "enum state { STATE_OFF, STATE_ON, STATE_BROKEN = -4, STATE_GONE };\n"
        "enum why { WHY_A = 1 << 0, WHY_B = 1 << 4 };\nenum { MOST = 0x20u };\n",
    )
    made: dict[str, Any] = {}
    exec(c_structs._enums(found), made)
    assert {m.name: int(m) for m in made["State"]} == {"OFF": 0, "ON": 1, "BROKEN": -4, "GONE": -3}
    assert issubclass(made["Why"], IntFlag) and made["Why"].B == 16
    assert made["MOST"] == 32


def test_functions_have_the_types_of_their_prototypes(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        "typedef struct { double x; } p_t;\nAPI void give(p_t *p, const double *v, size_t n);\n"
        "static inline int32_t own(int32_t a) { if (a) { return 1; } return 2; }\n"
        "API int64_t count(void);\nAPI void say(const char *format, ...);\n",
    )
    assert [*found.functions] == ["give", "count"]
    result, arguments = found.functions["give"]
    assert (result.type, [(a.type, a.pointers) for a in arguments]) == (
        "void",
        [("p_t", 1), ("double", 1), ("size_t", 0)],
    )


@pytest.mark.parametrize(
    "text",
    ["typedef struct { int32_t a : 3; } x_t;", "typedef struct { int32_t a[MANY]; } x_t;",
     "typedef struct { union { int32_t a; double b; } u; } x_t;", "enum { A = sizeof(int) };"],
)  # fmt: skip
def test_what_is_not_understood_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(c_headers.HeaderError, match=r"small\.h: .*, in: "):
        read(tmp_path, text)
