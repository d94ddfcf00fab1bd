"""Python's side of the C headers: ``enums.py`` and ``structs.py`` of each package with a library.

``enums.py`` has an IntEnum (IntFlag, where values are written as shifts) for each enum with a tag,
and the enumerators of the others as constants. ``structs.py`` has a ctypes class for each struct,
and ``declare``, which tells ctypes the types of the functions of a library. `frame_t` is
`FrameStruct`, or `Frame` where Python has no class of that name. Neither file is kept in git: a
build makes both, without a compiler, and mypy reads the types of members in them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from keyword import iskeyword
from pathlib import Path

from c_headers import Declarations, Enum, Member, Struct, read

ROOT = Path(__file__).resolve().parent.parent
_SCALARS = {
    **{f"{u}int{n}_t": f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)},
    **{"double": "double", "float": "float", "char": "char", "int": "int", "long": "long"},
    **{"size_t": "size_t", "_Bool": "bool"},
}
_FIELD = """
if TYPE_CHECKING:
    Read = TypeVar("Read")
    Written = TypeVar("Written")
    Seen = c._CField[Any, Read, Written]"""


@dataclass(frozen=True)
class Library:
    """A shared library: its headers, where its Python side goes, and what is special about that.

    `plain`: structs whose classes do not end in ``Struct``. `bases`: classes with the methods of a
    struct. `pointers`: what points to a struct has its type, and a member keeps what it points to;
    else such members and arguments are addresses.
    """

    package: str
    folder: str
    headers: tuple[str, ...] = ()
    plain: frozenset[str] = frozenset()
    bases: Mapping[str, str] = field(default_factory=dict)
    pointers: bool = False

    def own(self) -> list[Path]:
        """The headers whose structs Python has."""
        folder = ROOT / self.folder
        return [folder / name for name in self.headers] or sorted(folder.glob("*.h"))

    def declarations(self) -> Declarations:
        """Everything that its headers declare. Raises c_headers.HeaderError."""
        folder = ROOT / self.folder
        offered = [*folder.glob("*.[ch]"), *folder.glob("engine/*.c")]
        return read(self.own(), sorted(offered), ROOT / "cosim/c")

    def class_name(self, struct: str) -> str:
        """The name of the class of a struct."""
        return camel(struct.removesuffix("_t")) + ("" if struct in self.plain else "Struct")


LIBRARIES = (
    Library(
        "cosim.native", "cosim/c",
        ("engine.h", "fmu_log.h", "mailbox.h", "mujoco.h", "recording.h", "start.h", "tables.h"),
    ),
    Library("cosim.bus", "cosim/c/bus", ("bus.h", "length.h", "tick.h")),
    Library(
        "bridge.native", "bridge/c",
        plain=frozenset({
            "accept_t", "apart_t", "delay_t", "drive_event_t", "drive_events_t", "epoch_t",
            "fault_t", "faults_t", "field_t", "frame_t", "guard_t", "header_t", "histogram_t",
            "inside_t", "limit_t", "message_t", "motor_fault_t", "peer_t", "receiver_t",
            "reception_t", "services_t",
        }),
        bases={
            "accept_t": "bridge.native.methods.AcceptMethods",
            "frame_t": "bridge.native.methods.FrameMethods",
        },
        pointers=True,
    ),
)  # fmt: skip


def write() -> list[Path]:
    """Make all files; return those that were missing or have changed."""
    made = []
    for library in LIBRARIES:
        found = library.declarations()
        for name, text in (("enums", _enums(found)), ("structs", _Structs(library, found).text())):
            path = ROOT / library.package.replace(".", "/") / f"{name}.py"
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                scratch = path.with_name(f".{name}.{os.getpid()}")
                scratch.write_text(text, encoding="utf-8")
                scratch.replace(path)  # whoever imports it meanwhile reads a whole file
                made.append(path)
    return made


def _head(what: str) -> str:
    return f'"""{what} of the C headers, written by ``build_backend/c_structs.py`` in a build."""\n'


def _enums(found: Declarations) -> str:
    """``enums.py``."""
    lines = [_head("Enumerators"), "from enum import IntEnum, IntFlag", ""]
    lines += [f"{n} = {v}" for e in found.enums if not e.tag for n, v in e.values.items()]
    return "\n".join([*lines, *(line for e in found.enums if e.tag for line in _enum(e)), ""])


def _enum(e: Enum) -> Iterator[str]:
    first, last = min(e.values), max(e.values)
    same = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    prefix = first[: first.rfind("_", 0, same) + 1]
    kind = "IntFlag" if e.flags else "IntEnum"
    yield f'\n\nclass {camel(e.tag)}({kind}):\n    """``{prefix}...`` of {e.header}."""\n'
    yield from (f"    {name.removeprefix(prefix)} = {v}" for name, v in e.values.items())


def camel(name: str) -> str:
    """The name of a class: ``start_call`` is ``StartCall``."""
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


class _Structs:
    """The text of ``structs.py``."""

    def __init__(self, library: Library, found: Declarations) -> None:
        self._library, self._found = library, found
        self._classes: dict[str, str] = {}

    def text(self) -> str:
        lines = [_head("Structs and functions"), "from __future__ import annotations", ""]
        lines += ["import ctypes as c", "from typing import TYPE_CHECKING, Any, TypeVar", ""]
        for base in self._library.bases.values():
            module, _, name = base.rpartition(".")
            lines.append(f"from {module} import {name}")
        lines.append(_FIELD)
        for struct in self._found.structs:
            lines += self._struct(struct)
        return "\n".join([*lines, *self._declare(), ""])

    def _struct(self, struct: Struct) -> Iterator[str]:
        name = self._library.class_name(struct.name)
        base = self._library.bases.get(struct.name, "c.Structure").rpartition(".")[2]
        if base == "Structure":
            base = "c.Structure"
        yield f'\n\nclass {name}({base}):\n    """``{struct.name}`` of {struct.header}."""\n'
        yield "    _fields_ = ("
        yield from (f'        ("{m.name}", {self._type(m)}),' for m in struct.members)
        yield "    )"
        seen = (m for m in struct.members if not iskeyword(m.name))
        yield from (f"    {m.name}: {self._seen(m)}" for m in seen)
        self._classes[struct.name] = name

    def _type(self, m: Member) -> str:
        """The ctypes type of a member."""
        text = self._element(m)
        for size in reversed(m.shape):
            text = f"({text} * {size})"
        return text

    def _element(self, m: Member) -> str:
        if m.pointers == 0:
            return self._scalar(m.type)
        typed = self._library.pointers and m.pointers == 1 and m.type in self._classes
        return f"c.POINTER({self._classes[m.type]})" if typed else "c.c_void_p"

    def _scalar(self, name: str) -> str:
        known = self._classes.get(name)
        return known or f"c.c_{_SCALARS[name]}"

    def _seen(self, m: Member) -> str:
        """The type of a member for mypy: what is read from it, and what may be written to it."""
        if m.pointers and not m.shape:
            return "Seen[Any, Any]"
        if m.shape and (m.type, len(m.shape), m.pointers) == ("char", 1, 0):
            return "Seen[bytes, bytes]"
        if m.shape:
            text = self._element(m) if not m.pointers else "Any"
            for _ in m.shape:
                text = f"c.Array[{text}]"
            return f"Seen[{text}, Any]"
        python = {"double": "float", "float": "float", "_Bool": "bool", "char": "bytes"}
        text = self._classes.get(m.type) or python.get(m.type, "int")
        return f"Seen[{text}, {text}]"

    def _declare(self) -> Iterator[str]:
        yield "\n\ndef declare(library: c.CDLL) -> c.CDLL:"
        yield '    """Tell ctypes the types of the functions of a library; return the library."""'
        yield "    p = c.POINTER"
        yield "    for name, result, arguments in ("
        for name, (result, arguments) in sorted(self._found.functions.items()):
            types = "".join(f"{self._argument(a)}, " for a in arguments)
            yield f'        ("{name}", {self._result(result)}, ({types.rstrip()})),'
        yield "    ):"
        yield "        function = getattr(library, name, None)"
        yield "        if function is not None:"
        yield "            function.restype, function.argtypes = result, arguments"
        yield "    return library"

    def _result(self, m: Member) -> str:
        if m.pointers:
            return "c.c_void_p"
        return "None" if m.type == "void" else self._scalar(m.type)

    def _argument(self, m: Member) -> str:
        if not m.pointers:
            return self._scalar(m.type)
        return self._element(m).replace("c.POINTER", "p")
