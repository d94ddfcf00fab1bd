"""What other rooms ask of components, of which some are FMUs."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from cosim.fmi import components
from fmus.models import planar2r

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def python():
    """A component that is a Python class."""
    return planar2r.Planar2R()


def test_a_python_component_has_nothing_of_an_fmu(python):
    assert components.fmu_of(python) is None and not components.is_fmu(python)
    assert components.facts(python) is None and components.fmus_in([python, python]) == 0
    assert components.model_name(python) == "fmus.build.reference:Reference, Python call-back"
    assert not components.is_text(python, "q") and components.unit_of(python, "rad") == "rad"
    assert components.discrete_inputs(python) == components.sloped_inputs(python) == frozenset()
    assert (
        components.exit_initialization(python) == {} and components.ended_at_start(python) is None
    )
    assert components.terminated_at(python) is None
    assert components.texts(python) == {} and components.log_text(python) == ""
    components.begin_at(python, 1.0)
    components.free_state(python, object())
    components.close([python], 0, 0)


def test_only_fmi_tells_fmus_from_other_components():
    """Elsewhere nobody asks for the class: :mod:`cosim.fmi.components` answers."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for package in ("cosim", "bridge", "fmus")
        for path in sorted((ROOT / package).rglob("*.py"))
        if ROOT / "cosim" / "fmi" not in path.parents
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) == "isinstance"
        and "FmuComponent" in ast.unparse(node.args[1])
    ]
    assert found == []
