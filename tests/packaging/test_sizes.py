"""Rooms, functions and lists of parameters stay small; the exceptions are listed with a reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("cosim", "bridge", "fmus")
MODULES, LINES, PARAMETERS = 20, 60, 7
GENERATED = {"structs.py", "enums.py"}
#: Larger rooms, with the most modules that each may have.
LARGE_ROOMS = {
    "fmus/models": (47, "one module a model, and their facts"),
}
#: Longer functions, with the reason.
LONG_FUNCTIONS = {
    "cosim/engine/simulate.py": {"simulate"},  # a run from its start to its folder
    "cosim/schedule/plan.py": {"compile_plan"},  # the stages of a plan, in order
    "bridge/monitor/web.py": {"app"},  # the addresses of a server
}
#: Functions with more parameters than PARAMETERS; fewer are welcome.
MANY_PARAMETERS = 33


def modules() -> Iterator[tuple[str, ast.Module]]:
    """Each module of the packages that is written by hand: its path, and its tree."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.name not in GENERATED:
                tree = ast.parse(path.read_text(encoding="utf-8"))
                yield str(path.relative_to(ROOT)), tree


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All functions and methods."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """The number of parameters, `self` included."""
    given = function.args
    return len([*given.posonlyargs, *given.args, *given.kwonlyargs])


@pytest.mark.parametrize(
    "room",
    sorted(
        {str(path.parent.relative_to(ROOT)) for p in PACKAGES for path in (ROOT / p).rglob("*.py")}
    ),
)
def test_a_room_has_few_modules(room: str) -> None:
    there = {path.name for path in (ROOT / room).glob("*.py")} - GENERATED - {"__init__.py"}
    most, _ = LARGE_ROOMS.get(room, (MODULES, ""))
    assert len(there) <= most
    assert room not in LARGE_ROOMS or len(there) > MODULES, "it is small now: leave it out"


def test_functions_are_short() -> None:
    long = {
        (path, function.name)
        for path, tree in modules()
        for function in functions(tree)
        if (function.end_lineno or 0) - function.lineno >= LINES
    }
    assert long == {(path, name) for path, names in LONG_FUNCTIONS.items() for name in names}


def test_functions_have_few_parameters() -> None:
    many = [
        f"{path}: {function.name}"
        for path, tree in modules()
        for function in functions(tree)
        if parameters(function) > PARAMETERS
    ]
    assert len(many) <= MANY_PARAMETERS, many
