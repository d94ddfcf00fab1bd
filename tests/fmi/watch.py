"""An FMU that writes down its calls: a library of the same functions in front of its own one.

The functions are generated from the headers of the standard (in FMPy), so that no knowledge of the
importer under test is in them. Each call becomes a line of JSON in the file that the environment
variable FMI_CALLS names: function, instance, status, plain arguments, value references, and what
was returned through pointers.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import fmpy

from fmus.build.toolchain import compile_shared, shared_suffix
from tests.cosim.fmi.exporter import FOLDER

HEADERS = Path(fmpy.__file__).parent / "c-code"
_TYPEDEF = re.compile(r"typedef\s+([^;()]*?)\s*\b(fmi\d\w+)TYPE\s*\(([^;]*?)\)\s*;", re.S)
_NUMBERS = (
    *("Real", "Integer", "Boolean", "Status", "Type", "StatusKind", "Float64", "Float32"),
    *("Clock", "IntervalQualifier", "DependencyKind", "ValueReference"),
)
_HEAD = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi{v}FunctionTypes.h"
static void *library(void)
{{
    static void *opened;
    char path[4096];
    Dl_info own;
    if (opened) return opened;
    dladdr((void *)library, &own);
    snprintf(path, sizeof path, "%s.real", own.dli_fname);
    opened = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!opened) fprintf(stderr, "%s\\n", dlerror()), abort();
    return opened;
}}
static FILE *file;
static void finish(void)
{{
    if (file) fclose(file), file = NULL;
}}
static FILE *begin(const char *name, const void *instance, int depth)
{{
    static char open[4096];
    const char *path = getenv("FMI_CALLS");
    if (!path || strcmp(path, open)) finish();
    if (!path) return NULL;
    if (!file) {{
        file = fopen(path, "a");
        snprintf(open, sizeof open, "%s", path);
        if (file) setvbuf(file, NULL, _IOLBF, 1 << 12);
    }}
    if (file) fprintf(file, "{{\\"name\\":\\"%s\\",\\"instance\\":%llu,\\"depth\\":%d", name,
                      (unsigned long long)(size_t)instance, depth);
    return file;
}}
static void handle(FILE *file, const void *state)
{{
    if (file) fprintf(file, ",\\"saved\\":%llu", (unsigned long long)(size_t)state);
}}
static void list(FILE *file, const char *name, const unsigned *values, size_t n)
{{
    if (!file || !values) return;
    fprintf(file, ",\\"%s\\":[", name);
    for (size_t i = 0; i < n; i++) fprintf(file, "%s%u", i ? "," : "", values[i]);
    fprintf(file, "]");
}}
static void flags(FILE *file, const char *name, const bool *values, size_t n)
{{
    if (!file || !values) return;
    fprintf(file, ",\\"%s\\":[", name);
    for (size_t i = 0; i < n; i++) fprintf(file, "%s%d", i ? "," : "", values[i]);
    fprintf(file, "]");
}}
static void number(FILE *file, const char *name, double value)
{{
    if (!file) return;
    if (value != value || value - value != 0) fprintf(file, ",\\"%s\\":null", name);
    else fprintf(file, ",\\"%s\\":%.17g", name, value);
}}
static int depth;
"""


@dataclass(frozen=True, slots=True)
class Argument:
    """One parameter of a function: its C type, its name, and what follows the name."""

    type: str
    name: str
    array: bool

    @property
    def bare(self) -> str:
        return re.sub(r"\bconst\b|\*|\s|fmi\d", "", self.type)

    @property
    def pointer(self) -> bool:
        return "*" in self.type or self.array

    @property
    def number(self) -> bool:
        return self.bare in (*_NUMBERS, "size_t", "int") and not self.pointer

    @property
    def returned(self) -> bool:
        """True if it points to one number that the function gives."""
        one = "*" in self.type and not self.array and "const" not in self.type
        return one and self.bare in (*_NUMBERS, "size_t")


def _arguments(text: str) -> Iterator[Argument]:
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    for i, part in enumerate(p.strip() for p in text.split(",")):
        if part in ("void", ""):
            continue
        match = re.match(r"(.*?)(\w+)\s*(\[\])?$", part, re.S)
        assert match is not None, part
        kind, name, brackets = match[1].strip(), match[2], match[3]
        if not kind:  # only a type: fmi2Byte[] of fmi2SerializeFMUstate
            kind, name = name, f"argument{i}"
        yield Argument(" ".join(kind.split()), name, bool(brackets))


@lru_cache
def functions(version: str) -> dict[str, tuple[str, tuple[Argument, ...]]]:
    """Every function of the header by name: what it returns, and its arguments."""
    text = (HEADERS / f"fmi{version}FunctionTypes.h").read_text()
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.S)
    return {
        name: (" ".join(kind.split()), tuple(_arguments(inside)))
        for kind, name, inside in _TYPEDEF.findall(text)
    }


def _function(name: str, kind: str, arguments: tuple[Argument, ...]) -> str:
    version = name[3]
    shown = ", ".join(f"{a.type} {a.name}{'[]' if a.array else ''}" for a in arguments)
    passed = ", ".join(a.name for a in arguments)
    status = kind.endswith("Status")
    has_instance = arguments and re.fullmatch(r"fmi\d(Component|Instance)", arguments[0].type)
    first = arguments[0].name if has_instance else "NULL"
    short = re.sub(r"fmi\d", "", name)
    lines = [f"FMI_EXPORT {kind} {name}({shown or 'void'})", "{",
             f"    static {name}TYPE *real;"]  # fmt: skip
    if kind != "void":
        lines.append(f"    {kind} result;")
    lines.append(f'    if (!real) real = ({name}TYPE *)dlsym(library(), "{name}");')
    absent = {"void": "", "const char*": f'"{"default" if "Types" in name else version}.0"'}
    lines.append(f"    if (!real) return {absent.get(kind, '3' if status else 'NULL')};")
    lines.append("    depth++;")
    lines.append(f"    {'' if kind == 'void' else 'result = '}real({passed});")
    lines.append("    depth--;")
    made = "result" if "Instantiate" in name else first
    lines.append(f'    file = begin("{short}", {made}, depth);')
    if status:
        lines.append('    number(file, "status", (double)result);')
    for i, a in enumerate(arguments):
        if a.bare == "ValueReference" and a.pointer and "const" in a.type:
            lines.append(f'    list(file, "{a.name}", {a.name}, {arguments[i + 1].name});')
        elif a.bare == "Clock" and a.pointer:
            lines.append(f'    flags(file, "{a.name}", {a.name}, nValueReferences);')
        elif a.number:
            lines.append(f'    number(file, "{a.name}", (double){a.name});')
        elif a.returned:
            lines.append(f'    if ({a.name}) number(file, "{a.name}", (double)*{a.name});')
        elif a.bare.lower() == "fmustate" and "Free" not in name:
            lines.append(f"    handle(file, {'*' if a.pointer else ''}{a.name});")
        elif a.bare == "EventInfo":
            for field in ("newDiscreteStatesNeeded", "terminateSimulation",
                          "nominalsOfContinuousStatesChanged", "valuesOfContinuousStatesChanged",
                          "nextEventTimeDefined", "nextEventTime"):  # fmt: skip
                lines.append(f'    number(file, "{field}", (double){a.name}->{field});')
    lines.append('    if (file) fprintf(file, "}\\n");')
    if short.startswith("Free") and short.endswith("Instance"):
        lines.append("    finish();")  # another one opens it again
    if kind != "void":
        lines.append("    return result;")
    return "\n".join([*lines, "}", ""])


@lru_cache
def wrapper(version: str) -> bytes:
    """The library that forwards and writes down, compiled."""
    source = Path(FOLDER.name) / f"watch{version}.c"
    body = "".join(_function(name, *found) for name, found in functions(version).items())
    head = _HEAD.format(v=version)
    export = '#define FMI_EXPORT __attribute__((visibility("default")))\n'
    source.write_text(head + export + body)
    output = source.with_suffix(shared_suffix())
    return compile_shared([source], output, include=[HEADERS], flags=["-ldl"]).read_bytes()


def watched(fmu: Path, out: Path) -> Path:
    """The same FMU, but its calls are written down."""
    with zipfile.ZipFile(fmu) as archive, zipfile.ZipFile(out, "w") as copy:
        version = "2" if b'fmiVersion="2' in archive.read("modelDescription.xml") else "3"
        for name in archive.namelist():
            data = archive.read(name)
            here = re.match(
                r"binaries/(linux64|x86_64-linux|aarch64-linux|darwin64|\w+-darwin)/", name
            )
            if here and name.endswith(shared_suffix()):
                copy.writestr(f"{name}.real", data)
                data = wrapper(version)
            copy.writestr(name, data)
    return out


@dataclass(frozen=True, slots=True)
class Call:
    """A call: function without ``fmi2``, instance, status (None: it has none), and what it said.

    `depth` is greater than 0 for a call that the importer makes from within another one.
    """

    name: str
    instance: int
    depth: int
    status: int | None
    said: dict[str, Any]

    def __str__(self) -> str:
        return f"{self.name}{self.said}"


def calls(path: Path) -> list[Call]:
    """The calls in a file, in the order in which they ended."""
    found = []
    for line in path.read_text().splitlines():
        data = json.loads(line)
        status = data.pop("status", None)
        name, instance, depth = (data.pop(k) for k in ("name", "instance", "depth"))
        found.append(Call(name, instance, depth, None if status is None else int(status), data))
    return found
