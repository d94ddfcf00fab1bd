"""The folder of a participant: sources of a language, tables of its node, and a page about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bridge.deployment.system import System
from bridge.scaffold.files import write_files
from bridge.sdk import c_table
from bridge.sdk.amalgamation import SDK, core
from bridge.sdk.laws import law_in_c, law_in_cpp, law_in_python, law_in_rust
from bridge.sdk.page import page
from bridge.sdk.table import LayoutEntry, NodeTable, as_json, node_table
from cosim.base.errors import ScenarioError


@dataclass(frozen=True, slots=True)
class Kit:
    """A language on one kind of bus: how it is built ("": not at all) and started, and its sources.

    `start`: the words of a command, the program of the folder at first. `files` gives the sources
    for a table and the command that builds the program.
    """

    build: str
    start: tuple[str, ...]
    files: Callable[[NodeTable, str], dict[str, str]]


@dataclass(frozen=True, slots=True)
class Written:
    """The files of a participant, and the commands that build and start it; as in :class:`Kit`."""

    paths: list[Path]
    build: str
    start: str


def write_participant(system: System, node: str, language: str, folder: Path) -> Written:
    """Write a participant for a node into `folder`.

    Raises ScenarioError for a node that no participant can replace, and where a file exists.
    """
    table = node_table(system, node)
    kinds = {bus.kind for bus in table.buses}
    if len(kinds) > 1:
        raise ScenarioError(
            "found a node on CAN and on Zenoh, expected one with buses of one kind",
            system.deployment.place("nodes", node),
        )
    kit = _kit(language, kinds.pop())
    start = " ".join(
        (*(word.replace("@folder@", str(folder)) for word in kit.start), *_places(table))
    )
    files = kit.files(table, kit.build)
    files["README.md"] = page(table, system, kit.build, start)
    return Written(write_files(folder, files), kit.build, start)


def _kit(language: str, kind: str) -> Kit:
    """The kit for a language and a kind of bus. Raises ScenarioError for one there is not."""
    if (language, kind) not in KITS:
        expected = ", ".join(name for name, on in KITS if on == kind)
        raise ScenarioError(
            f"found {language!r}, expected one of {expected} for a node on {kind}", "--language"
        )
    return KITS[language, kind]


def _places(table: NodeTable) -> list[str]:
    """The arguments of a program: its buses, as ``cosim rehearse --outside`` fills them in."""
    ends = {"can": ("{{{0}}}",), "zenoh": ('"{{{0}.listen}}"', '"{{{0}.connect}}"')}
    return [end.format(bus.name) for bus in table.buses for end in ends[bus.kind]]


def _c(table: NodeTable, build: str) -> dict[str, str]:
    main = _program(table, "c/main.c", {"build": build, "law": law_in_c(table)})
    return {**_c_sources(table), "main.c": main}


def _cpp(table: NodeTable, build: str) -> dict[str, str]:
    main = _program(table, "cpp/main.cpp", {"build": build, "law": law_in_cpp(table)})
    wrapper = _read("cpp/participant.hpp")
    return {**_c_sources(table), "participant.hpp": wrapper, "main.cpp": main}


def _rust(table: NodeTable, build: str) -> dict[str, str]:
    main = _program(table, "rust/main.rs", {"build": build, "law": law_in_rust(table)})
    return {**_c_sources(table), "main.rs": main}


def _c_sources(table: NodeTable) -> dict[str, str]:
    """The sources in C without the program itself, by name."""
    names = ["linux.h", "linux.c"]
    if table.buses[0].kind == "zenoh":
        names += ["zenoh_pico.h", "zenoh_pico.c"]
    tables = {"table.h": c_table.header(table), "table.c": c_table.source(table)}
    return {**core(), **{name: _read(f"c/{name}") for name in names}, **tables}


def _program(table: NodeTable, name: str, words: Mapping[str, str]) -> str:
    """A template with its words, for the kind of bus of the table."""
    text = _read(name)
    if table.buses[0].kind == "zenoh":
        text = text.replace('"linux.h"', '"zenoh_pico.h"').replace("run_on_can", "run_on_zenoh")
        text = text.replace("CHANNEL ... (a channel for each bus of table.c)", "LISTEN CONNECT")
    for word, value in {**words, "node": table.node}.items():
        text = text.replace(f"    /* @{word}@ */", value).replace(f"@{word}@", value)
    return text


def _read(name: str) -> str:
    return (SDK.parent / name).read_text(encoding="utf-8")


def _python_can(table: NodeTable, build: str) -> dict[str, str]:
    """The program for CAN FD. Raises ScenarioError for messages that it does not know."""
    for name, layout in _layouts(table):
        known = layout.profile == "P05" and layout.fd and layout.time is not None
        places = enumerate(layout.fields)
        if not known or any(
            (f.start, f.bits, f.scale) != (64 + 32 * i, 32, 2**-20) for i, f in places
        ):
            raise ScenarioError(
                f"found message {name}, expected LINK_n or STATE_n of link_fd.dbc in Python; C has "
                "all messages",
                "--language",
            )
    return _python(table, "can.py.txt")


def _layouts(table: NodeTable) -> list[tuple[str, LayoutEntry]]:
    found = [(m.name, m.layout) for m in table.received]
    return [*found, *((m.name, m.layout) for m in table.sent)]


def _python_zenoh(table: NodeTable, build: str) -> dict[str, str]:
    return _python(table, "zenoh.py.txt")


def _python(table: NodeTable, template: str) -> dict[str, str]:
    text = (
        _read(f"python/{template}")
        .replace('    """@law@"""', law_in_python(table))
        .replace("@node@", table.node)
    )
    life = _read("python/life.py.txt").replace("@node@", table.node)
    return {"participant.py": text, "life.py": life, "table.json": as_json(table)}


_PROGRAM = ("@folder@/participant",)
_CC = "cc -std=c99 -O2"
_CPP = f"{_CC} -c *.c && c++ -std=c++17 -O2 -o participant main.cpp *.o"
_RUST = (
    f"{_CC} -c *.c && ar rcs libparticipant.a *.o && rustc --edition 2021 -O -L . "
    "-l static=participant -o participant main.rs"
)
#: Options of the C compiler and of the linker that zenoh-pico needs in addition.
_PICO, _LIBRARY = "-DZENOH_LINUX", "-lzenohpico -lpthread"
#: By language and kind of bus.
KITS: Mapping[tuple[str, str], Kit] = {
    ("c", "can"): Kit(f"{_CC} -o participant *.c", _PROGRAM, _c),
    ("c++", "can"): Kit(_CPP, _PROGRAM, _cpp),
    ("python", "can"): Kit("", ("python", "@folder@/participant.py", "socketcan"), _python_can),
    ("rust", "can"): Kit(_RUST, _PROGRAM, _rust),
    ("c", "zenoh"): Kit(f"{_CC} {_PICO} -o participant *.c {_LIBRARY}", _PROGRAM, _c),
    ("c++", "zenoh"): Kit(f"{_CPP.replace(_CC, f'{_CC} {_PICO}')} {_LIBRARY}", _PROGRAM, _cpp),
    ("python", "zenoh"): Kit("", ("python", "@folder@/participant.py"), _python_zenoh),
    ("rust", "zenoh"): Kit(
        f"{_RUST.replace(_CC, f'{_CC} {_PICO}')} {_LIBRARY.replace('-l', '-l ')}", _PROGRAM, _rust
    ),
}
