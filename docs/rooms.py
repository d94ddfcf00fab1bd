"""Write the rooms into ``docs/design.md``, from the imports: ``python docs/rooms.py`` in the
checkout.

A room is a package of `cosim` or `bridge`. An arrow goes from a room to one that it imports; arrows
that follow from others are left out. A floor is one above the highest that its rooms import.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "design.md"
BEGIN, END = "<!-- rooms: python docs/rooms.py -->", "<!-- end of rooms -->"

Graph = Mapping[str, frozenset[str]]


def rooms(package: str) -> list[str]:
    """Packages with Python files directly below a package."""
    return sorted(p.parent.name for p in (ROOT / package).glob("*/__init__.py"))


def graph(package: str) -> Graph:
    """Which other rooms each room imports."""
    names = rooms(package)
    found: dict[str, set[str]] = {name: set() for name in names}
    for name in names:
        for path in (ROOT / package / name).rglob("*.py"):
            found[name].update(set(_imported_rooms(path, package)) & found.keys())
    return {a: frozenset(to - {a}) for a, to in found.items()}


@cache
def imported(path: Path) -> tuple[str, ...]:
    """Names that a file imports, with their modules: at its top, in functions, for types only."""
    return tuple(_imported(ast.parse(path.read_text(encoding="utf-8"))))


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _imported_rooms(path: Path, package: str) -> Iterator[str]:
    """Second parts of the names that a file imports from the package."""
    for name in imported(path):
        parts = name.split(".")
        if parts[0] == package and len(parts) > 1:
            yield parts[1]


def below(found: Graph, room: str) -> frozenset[str]:
    """All rooms that a room imports, directly or by way of others."""
    return found[room].union(*(below(found, other) for other in found[room]))


def reduced(found: Graph) -> dict[str, list[str]]:
    """The arrows that do not follow from others."""
    under = {room: below(found, room) for room in found}
    return {
        a: sorted(b for b in to if not any(b in under[c] for c in to - {b}))
        for a, to in found.items()
    }


def floors(found: Graph) -> list[list[str]]:
    """Rooms by floor, the lowest first."""
    level: dict[str, int] = {}

    def of(room: str) -> int:
        if room not in level:
            level[room] = 1 + max((of(other) for other in found[room]), default=-1)
        return level[room]

    for room in found:
        of(room)
    return [[r for r in found if level[r] == n] for n in range(max(level.values()) + 1)]


def picture(package: str) -> list[str]:
    """A package's rooms as a graph in Mermaid, and a row for each."""
    found = graph(package)
    arrows = reduced(found)
    lines = ["```mermaid", "flowchart TD"]
    lines += [f"    {a} --> {b}" for a in found for b in arrows[a]]
    lines += ["```", "", "| floor | room | purpose |", "|---|---|---|"]
    ordered = [(n, room) for n, floor in enumerate(floors(found)) for room in floor]
    for n, room in reversed(ordered):
        lines.append(f"| {n} | `{package}/{room}/` | {_said(package, room)} |")
    return lines


def _said(package: str, room: str) -> str:
    text = ast.get_docstring(
        ast.parse((ROOT / package / room / "__init__.py").read_text(encoding="utf-8"))
    )
    first = (text or "").split("\n\n")[0].replace("\n", " ")
    first = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", first).replace("``", "`")
    return first.rstrip(":").removesuffix(".").replace("|", "\\|")


def section() -> str:
    """All between the two marks."""
    lines = []
    for package in ("cosim", "bridge"):
        found = graph(package)
        lines += [
            f"### `{package}/`: {len(found)} rooms on {len(floors(found))} floors",
            "",
            *picture(package),
            "",
        ]
    return "\n".join(lines)


def page() -> str:
    """The page with the section as it has to be."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n\n{section()}\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
