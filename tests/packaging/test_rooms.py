"""The rooms: what each says of itself, the picture of them, and the contracts that keep it true."""

from __future__ import annotations

import ast
import graphlib
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_SPEC = importlib.util.spec_from_file_location("rooms", ROOT / "docs" / "rooms.py")
assert _SPEC is not None and _SPEC.loader is not None
rooms = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(rooms)
#: Modules that are no room: what stands directly in a package.
LOOSE = {"cosim": {"__init__", "__main__"}, "bridge": {"__init__"}}


def test_the_picture_in_the_design_page_is_current():
    assert rooms.PAGE.read_text(encoding="utf-8") == rooms.page(), "python docs/rooms.py writes it"


@pytest.mark.parametrize("package", ["cosim", "bridge"])
def test_every_module_stands_in_a_room(package):
    assert {p.stem for p in (ROOT / package).glob("*.py")} == LOOSE[package]


@pytest.mark.parametrize(
    "path", [f"{p}/{r}/__init__.py" for p in ("cosim", "bridge") for r in rooms.rooms(p)]
)
def test_a_room_says_what_it_is(path):
    text = ast.get_docstring(ast.parse((ROOT / path).read_text(encoding="utf-8")))
    assert text and len(text.split()) >= 8, path


@pytest.mark.parametrize("package", ["cosim", "bridge"])
def test_the_contract_has_all_rooms_and_no_exceptions(package):
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    (layers,) = [c for c in contracts if c.get("containers") == [package]]
    named = sorted(room for layer in layers["layers"] for room in layer.split(" | "))
    assert layers["exhaustive"] and named == rooms.rooms(package)
    assert "ignore_imports" not in layers


def test_bridge_tests_mirror_the_rooms():
    folders = {p.parent.name for p in (ROOT / "tests" / "bridge").glob("*/test_*.py")}
    assert folders <= set(rooms.rooms("bridge"))
    assert not list((ROOT / "tests" / "bridge").glob("test_*.py"))


def imports(packages: tuple[str, ...]) -> dict[str, set[str]]:
    """The modules that each module imports."""
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for package in packages
        for path in (ROOT / package).rglob("*.py")
    }
    return {
        module: {n if n in files else n.rpartition(".")[0] for n in rooms.imported(path)}
        & files.keys() - {module}
        for module, path in files.items()
    }


def test_no_module_comes_back_to_itself_by_its_imports():
    found = imports(("cosim", "bridge", "fmus"))
    assert "cosim.fmi.library" in found["cosim.fmi.fmi2"]
    graphlib.TopologicalSorter(found).prepare()  # CycleError names the modules of a circle


@pytest.mark.parametrize(("package", "above"), [("cosim", "bridge|fmus"), ("fmus", "bridge")])
def test_no_string_names_a_module_of_a_package_above(package: str, above: str) -> None:
    """The import contracts cannot see these: such parts are entry points (cosim.base.parts)."""
    module = re.compile(rf"({above})(\.\w+)+")
    named = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.value}"
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if module.fullmatch(node.value)
    ]
    assert named == []


def test_only_the_fmi_layer_asks_whether_a_component_is_an_fmu():
    """Everybody else uses what `Component` promises: the engine stands behind that seam."""
    asking = [
        str(path.relative_to(ROOT))
        for package in ("cosim", "bridge", "fmus")
        for path in (ROOT / package).rglob("*.py")
        if (ROOT / "cosim" / "fmi") not in path.parents
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"
        if "FmuComponent" in ast.unparse(node.args[1])
    ]
    assert asking == []
