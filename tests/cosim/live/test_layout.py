"""Structs have the sizes and offsets that the compiler gives them in WebAssembly."""

from __future__ import annotations

import ctypes as c
import re
from pathlib import Path

from cosim.live.layout import layout
from cosim.native import structs
from fmus.build import toolchain

HEADERS = Path(__file__).parents[3] / "cosim" / "c"
LIVE = ("engine.h", "start.h", "tables.h", "fmu_log.h")


def test_the_compiler_has_the_same_layout(tmp_path):
    lines = [f'#include "{name}"' for name in LIVE]
    for kind in vars(structs).values():
        named = re.match(r"``(\w+)`` of ([\w.]+)\.", getattr(kind, "__doc__", None) or "")
        if not (isinstance(kind, type) and issubclass(kind, c.Structure) and named):
            continue
        if named[2] not in LIVE:
            continue
        found, name = layout(kind), named[1]
        lines.append(f'_Static_assert(sizeof({name}) == {found.size}, "size of {name}");')
        lines += [
            f'_Static_assert(offsetof({name}, {m}) == {at.offset}, "{name}.{m}");'
            for m, at in found.fields.items()
        ]
    assert len(lines) > 200
    source = tmp_path / "layout.c"
    source.write_text("\n".join(lines) + "\n", encoding="utf-8")
    toolchain.compile_object(
        source, tmp_path / "layout.o", include=[HEADERS], platform=toolchain.WEB
    )
