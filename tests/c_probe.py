"""The C compiler's view of our headers: offsets, sizes and kinds of fields, values of enums.

:func:`probe` compiles a small program that includes the headers and prints them. The tests compare
Python's mirrors (ctypes structs, NumPy rows, IntEnums) with its output.
"""

from __future__ import annotations

import ctypes as c
import enum
import inspect
import json
import re
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

from fmus.build.toolchain import compiler

#: Scalars of C by what ctypes calls them; what is none of these is a pointer.
SCALARS = {
    "int8_t": (c.c_int8,), "uint8_t": (c.c_uint8,), "int16_t": (c.c_int16,),
    "uint16_t": (c.c_uint16,), "int32_t": (c.c_int32,), "uint32_t": (c.c_uint32,),
    "int64_t": (c.c_int64,), "uint64_t": (c.c_uint64,), "double": (c.c_double,),
    "char": (c.c_char,),
}  # fmt: skip
KIND = '#define KIND(x) _Generic((x), {}, default: "other")\n'.format(
    ", ".join(f'{name}: "{name}"' for name in SCALARS)
)


def enums_in(*modules: ModuleType) -> dict[type[enum.IntEnum], str]:
    """The IntEnums and IntFlags that modules define, and the prefix that their docstring says."""
    found = {}
    for module in modules:
        for value in vars(module).values():
            mine = inspect.isclass(value) and value.__module__ == module.__name__
            if mine and issubclass(value, int) and issubclass(value, enum.Enum):
                said = re.search(r"``([A-Z0-9]+_)", value.__doc__ or "")
                assert said, f"{module.__name__}.{value.__name__}: which names of C are these?"
                found[value] = said[1]
    return found


def probe(
    headers: list[Path], fields: dict[str, list[str]], names: list[str], scratch: Path
) -> Any:
    """``{"structs": {name: {"": size, field: [offset, size, kind]}}, "names": {name: value}}``.

    `fields` of each struct (a field may be indexed: ``data[0]``), `names` of enumerators. The kind
    is a name of :data:`SCALARS` or ``other``.
    """
    lines = [f'#include "{header.name}"' for header in headers]
    lines = ["#include <stddef.h>", "#include <stdio.h>", *lines, KIND, "int main(void)", "{"]
    for struct, members in fields.items():
        lines.append(f'    printf("S {struct} %zu\\n", sizeof({struct}));')
        for member in members:
            x = f"(({struct} *)0)->{member}"
            say = f'"F {struct} {member} %zu %zu %s\\n"'
            lines.append(
                f"    printf({say}, offsetof({struct}, {member}), sizeof({x}), KIND({x}));"
            )
    lines += [f'    printf("N {name} %lld\\n", (long long)({name}));' for name in names]
    source, program = scratch / "probe.c", scratch / "probe"
    source.write_text("\n".join([*lines, "    return 0;", "}"]) + "\n", encoding="utf-8")
    shared = Path(__file__).parents[1] / "cosim/c"  # headers of the bridge include some of its
    include = [f"-I{folder}" for folder in {shared, *(header.parent for header in headers)}]
    command = [*compiler(), "-std=c11", "-w", *include, str(source), "-o", str(program)]
    subprocess.run(command, check=True)
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    found: dict[str, Any] = {"structs": {}, "names": {}}
    for line in said.splitlines():
        what, name, *rest = line.split()
        if what == "S":
            found["structs"][name] = {"": int(rest[0])}
        elif what == "F":
            found["structs"][name][rest[0]] = [int(rest[1]), int(rest[2]), rest[3]]
        else:
            found["names"][name] = int(rest[0])
    return json.loads(json.dumps(found))


def kind_of(kind: Any) -> str:
    """The kind that :func:`probe` gives a field of this type of ctypes."""
    for name, types in SCALARS.items():
        if kind in types:
            return name
    return "other"


def members(struct: type[c.Structure]) -> list[str]:
    """Its fields, and of each array its first element, whose kind is compared as well."""
    found = []
    for name, kind in struct._fields_:
        found.append(name)
        at = name
        while issubclass(kind, c.Array):
            at, kind = f"{at}[0]", kind._type_
            found.append(at)
    return found


def differences(struct: type[c.Structure], said: dict[str, Any]) -> list[str]:
    """Differences between a ctypes struct and the struct that the compiler sees."""
    found, end = [], 0
    for name, kind in struct._fields_:
        place = getattr(struct, name)
        offset, size, _ = said[name]
        if (place.offset, place.size) != (offset, size):
            found.append(f"{name}: {place.size} bytes at {place.offset}, C has {size} at {offset}")
        at = name
        while issubclass(kind, c.Array):
            at, kind = f"{at}[0]", kind._type_
        if kind_of(kind) != said[at][2]:
            found.append(f"{at}: {kind.__name__}, C has {said[at][2]}")
        aligned = -(-end // c.alignment(kind)) * c.alignment(kind)
        if offset != aligned:
            found.append(f"before {name}: C has something that is not here")
        end = offset + size
    if c.sizeof(struct) != said[""]:
        found.append(f"{c.sizeof(struct)} bytes, C has {said['']}")
    return found
