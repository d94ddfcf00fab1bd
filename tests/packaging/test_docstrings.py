"""Docstrings of public functions say what a caller cannot see: shapes, units and errors."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = sorted(
    str(path.relative_to(ROOT))
    for package in ("cosim", "bridge", "fmus")
    for path in (ROOT / package, *(ROOT / package).iterdir())
    if path.is_dir() and any(path.glob("*.py"))
)
#: Folders whose docstrings are not held to this yet.
UNFINISHED = {folder for folder in FOLDERS}

#: A unit, or words that say that there is none.
UNIT = re.compile(
    r"\b(s|ms|us|ns|rad|Hz|kHz|bits?|bytes?|N·m|m|kg|J|W|V|slots?|ticks?|frames|samples|seconds?|"
    r"nanoseconds|milliseconds|times|share|ratio|fraction|percent|probability|factor|gain|"
    r"dimensionless|units?)\b|%|°|1/s|rad/s"
)
#: A shape: (n,), (rows, 2), n × n; or words that say it in full.
SHAPE = re.compile(
    r"\([\w·*+ ]+,[^()]*\)|\w+ × \w+|\bshapes?\b|\bscalar\b|\bper (row|sample|tick)\b"
)
ARRAY = re.compile(r"\b(NDArray|ndarray|ArrayLike|Array)\b")
#: Errors that the type or the framework explains.
PLAIN = {"NotImplementedError", "AssertionError", "StopIteration", "SystemExit"}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(tree: ast.Module) -> Iterator[tuple[Function, str]]:
    """The public functions and methods of a module; the docstring of each, with its class's."""
    for owner in ast.walk(tree):
        if not isinstance(owner, ast.Module | ast.ClassDef) or (
            isinstance(owner, ast.ClassDef) and owner.name.startswith("_")
        ):
            continue
        above = ast.get_docstring(owner) or "" if isinstance(owner, ast.ClassDef) else ""
        for function in owner.body:
            if isinstance(function, Function) and not function.name.startswith("_"):
                yield function, f"{ast.get_docstring(function) or ''}\n{above}"


def own(function: Function) -> Iterator[ast.AST]:
    """The nodes of a function, without those of functions and classes inside it."""
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        yield node
        if not isinstance(node, Function | ast.ClassDef | ast.Lambda):
            waiting.extend(ast.iter_child_nodes(node))


def raised(function: Function) -> set[str]:
    """The names of the errors that a function raises itself."""
    called = (node.exc for node in own(function) if isinstance(node, ast.Raise))
    named = (x.func if isinstance(x, ast.Call) else x for x in called)
    return {x.id for x in named if isinstance(x, ast.Name) and x.id[0].isupper()} - PLAIN


def annotations(function: Function) -> str:
    """The types of the arguments and of the result."""
    given = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    types = [a.annotation for a in given if a.annotation]
    return " ".join(ast.unparse(x) for x in (*types, *filter(None, [function.returns])))


def missing(function: Function, text: str) -> list[str]:
    """What the docstring does not say."""
    types = annotations(function)
    said = []
    if re.search(r"\bfloat\b", types) and not UNIT.search(text):
        said.append("a unit (or that a number has none)")
    if ARRAY.search(types) and not SHAPE.search(text):
        said.append("the shape of an array")
    said += [f"when {error} is raised" for error in sorted(raised(function)) if error not in text]
    return said


def findings(folder: str) -> list[str]:
    """One line for each public function of a folder whose docstring lacks something."""
    return [
        f"{path.relative_to(ROOT)}:{function.lineno}: {function.name} does not say {what}"
        for path in sorted((ROOT / folder).glob("*.py"))
        for function, text in public(ast.parse(path.read_text(encoding="utf-8")))
        for what in missing(function, text)
    ]


@pytest.mark.parametrize("folder", sorted(set(FOLDERS) - UNFINISHED))
def test_docstrings_give_units_shapes_and_errors(folder: str) -> None:
    found = findings(folder)
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        ("def f(x: float): 'Double x.'", "a unit"),
        ("def f(x: float): 'Double x, in seconds.'", ""),
        ("def f(x: NDArray[np.int32]): 'Sum.'", "the shape"),
        ("def f(x: NDArray[np.int32]): 'Sum of x, of shape (n,).'", ""),
        ("def f(x):\n 'Check.'\n raise ConfigError('no')", "when ConfigError"),
        ("def f(x):\n 'Check.\\n\\nRaises:\\n ConfigError: always.'\n raise ConfigError('no')", ""),
        ("def f(x):\n 'Give g.'\n def g():\n  raise ConfigError('no')\n return g", ""),
        ("def _f(x: float): 'Double x.'", ""),
        ("class C:\n def f(self, x: float): 'Double.'", "a unit"),
    ],
)
def test_the_check_finds_what_is_missing(text: str, lacks: str) -> None:
    found = [what for function, doc in public(ast.parse(text)) for what in missing(function, doc)]
    assert (found == []) if not lacks else (len(found) == 1 and found[0].startswith(lacks))
