"""Every module, function and file that a docstring or a page names is there."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("cosim", "bridge", "fmus")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
GROUPS = set(PROJECT.get("entry-points", {}))  # of entry points: named like modules
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
ROLE = re.compile(r":(?:mod|func|class|meth|data|attr|exc|obj):`~?\.?([\w.]+)(?:\(\))?`")
#: In pages: a dotted name of our packages, and a path of the checkout.
#: Words in capitals stand for any name.
DOTTED = re.compile(r"`((?:cosim|bridge|fmus|tests|benchmarks)(?:\.\w+)+)(?:\(\))?`")
FILE = re.compile(
    r"(?<![\w/.-])((?:cosim|bridge|fmus|tests|benchmarks|examples|build_backend)/[\w/-]+\.(?:py|c|h|md|toml))\b"
)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def names_in(body: list[ast.stmt]) -> Iterator[tuple[str, ast.stmt]]:
    """Names that statements define, also those in an `if` or a `try`."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                yield from ((n.id, node) for n in ast.walk(target) if isinstance(n, ast.Name))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from ((a.asname or a.name.split(".")[0], node) for a in node.names)
        elif isinstance(node, ast.If | ast.Try):
            yield from names_in([*node.body, *node.orelse])


def members(node: ast.ClassDef) -> set[str]:
    """Members of a class: of its body, and attributes of `self`."""
    own = {name for name, _ in names_in(node.body)}
    return own | {
        x.attr
        for x in ast.walk(node)
        if isinstance(x, ast.Attribute) and isinstance(x.value, ast.Name) and x.value.id == "self"
    }


def file_of(parts: list[str]) -> Path | None:
    """The file of a module or a package."""
    place = ROOT.joinpath(*parts)
    if place.with_suffix(".py").is_file():
        return place.with_suffix(".py")
    return place / "__init__.py" if (place / "__init__.py").is_file() else None


def defined(path: Path, parts: list[str]) -> bool:
    """True if a module defines a name, or a class of it a member."""
    if not parts:
        return True
    found = [node for name, node in names_in(tree(path).body) if name == parts[0]]
    if not found or len(parts) == 1:
        return bool(found)
    classes = [node for node in found if isinstance(node, ast.ClassDef)]
    # Of what is imported, and of bases elsewhere, the first name is enough.
    return not classes or any(parts[1] in members(c) or c.bases for c in classes)


def exists(name: str) -> bool:
    """True if a dotted name leads to a module, or to a name in one."""
    parts = name.split(".")
    if (len(parts) == 1 and parts[0] in PACKAGES) or name in GROUPS:
        return True
    for n in range(len(parts), 0, -1):
        path = file_of(parts[:n])
        if path is not None:
            stub = path.with_suffix(".pyi")
            return defined(path, parts[n:]) or (stub.is_file() and defined(stub, parts[n:]))
    return ROOT.joinpath(*parts).is_dir()


def known(name: str, place: Path) -> bool:
    """True if a reference in the docstrings of a file leads somewhere."""
    parts = name.split(".")
    if parts[0] in (*PACKAGES, "tests", "benchmarks"):
        return exists(name)
    own = tree(place)
    if defined(place, parts) or (place.parent / f"{parts[0]}.py").is_file():
        return True
    classes = [node for node in ast.walk(own) if isinstance(node, ast.ClassDef)]
    # Of names of other libraries, the import is enough.
    return any(parts[0] in members(c) for c in classes) or (not file_of([parts[0]]) and "." in name)


def docstrings(place: Path) -> Iterator[str]:
    for node in ast.walk(tree(place)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""


@pytest.mark.parametrize("package", PACKAGES)
def test_what_a_docstring_refers_to_is_there(package: str) -> None:
    lost = [
        f"{place.relative_to(ROOT)}: {name}"
        for place in sorted((ROOT / package).rglob("*.py"))
        for text in docstrings(place)
        for name in ROLE.findall(text)
        if not known(name, place)
    ]
    assert lost == []


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_that_the_text_of_a_room_lists_are_in_it(package: str) -> None:
    lost = []
    for place in sorted((ROOT / package).rglob("*/__init__.py")):
        text = ast.get_docstring(tree(place)) or ""
        listed = re.findall(r"^    ([a-z]\w*(?:, [a-z]\w*)*)  +\S", text, re.MULTILINE)
        for name in (word for words in listed for word in words.split(", ")):
            inside = place.parent / name
            if not (inside.is_dir() or inside.with_suffix(".py").is_file()):
                lost.append(f"{place.relative_to(ROOT)}: {name}")
    assert lost == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    lost = [name for name in DOTTED.findall(text) if not exists(name)]
    lost += [name for name in FILE.findall(text) if not (ROOT / name).is_file()]
    lost = [name for name in lost if not re.search(r"[A-Z]{4}", name)]
    assert lost == []


@pytest.mark.parametrize("folder", [*PACKAGES, "configs", "examples"])
def test_pages_that_code_and_messages_name_are_there(folder: str) -> None:
    places = (p for p in (ROOT / folder).rglob("*") if p.suffix in (".py", ".c", ".h", ".toml"))
    named = {
        (str(place.relative_to(ROOT)), page)
        for place in places
        for page in re.findall(r"docs/[\w/-]+\.md", place.read_text(encoding="utf-8"))
    }
    assert sorted(x for x in named if not (ROOT / x[1]).is_file()) == []


def test_a_name_that_is_not_there_is_noticed() -> None:
    here = ROOT / "cosim" / "base" / "units.py"
    assert not exists("cosim.base.nothing") and not exists("cosim.record.Nothing")
    assert exists("cosim.record.Run") and exists("cosim.record.Run.array")
    assert not known("nothing_here", here) and known("cosim.record.Run", here)
