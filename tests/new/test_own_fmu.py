"""FMUs of one's own: of a Python class, and of a C source declared anywhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.scaffold import write_controller
from cosim.base.errors import FmuError, ScenarioError
from cosim.fmi.file.validation import problems
from cosim.scenario.spec import build
from fmus.build.archive import build as build_fmu
from fmus.python import build_class, load_module
from tests.ssp.parts import recorded

pytestmark = pytest.mark.usefixtures("compiled_once")

PAGE = (Path(__file__).parents[2] / "docs" / "own-component.md").read_text(encoding="utf-8")
DECLARATION = """\
from pathlib import Path

from fmus.model import Model, Variable


def model():
    return Model(
        identifier="leaky",
        description="y' = (u - y) / T",
        kind="continuous",
        variables=(
            Variable("u", "input", (), "deg", description="Input"),
            Variable("y", "output", (), "rad", 0.0, "Output", settable=True),
            Variable("T", "parameter", (), "s", 0.5, "Time constant", minimum=1e-3),
        ),
        sources=(str(Path(__file__).with_name("leaky.c")),),
    )
"""
SOURCE = """\
#include <stddef.h>
#include "model.h"

const char *model_initial(Model *x) { (void)x; return NULL; }

const char *model_step(Model *x, double t, double h) {
    (void)t;
    x->y += h / x->T * (x->u - x->y);
    return NULL;
}
"""


def loop(control: dict[str, Any]) -> dict[str, Any]:
    """An arm and what controls it."""
    arm = {
        "model": "fmus.models.planar2r",
        "start": {"q": [0.5, -0.5]},
        "inputs": {"tau": "control.tau"},
    }
    wired = {"inputs": {"q": "arm.q", "dq": "arm.dq"}, "period": 5e-3}
    values = {"parameters": {"K": 15.0}, "start": {"q_d": [0.7, -1.0]}}
    run = {"step": 1e-3, "stop": 0.2}
    return {"run": run, "components": {"arm": arm, "control": wired | values | control}}


def test_an_fmu_of_a_python_class_gives_the_numbers_of_the_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_controller("fmu_law", tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    fmu = build_class("fmu_law:FmuLaw", tmp_path)
    assert not problems(fmu)
    place = tmp_path / "x.toml"
    python = recorded(build(loop({"model": "fmu_law:FmuLaw"}), place))
    as_fmu = recorded(build(loop({"model": str(fmu)}), place))
    assert np.ptp(python["arm.q[0]"]) > 0.01
    for name, values in python.items():
        np.testing.assert_array_equal(values, as_fmu[name])


def test_without_pythonfmu_it_is_said_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_controller("other_law", tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(sys.modules, "pythonfmu.builder", None)
    with pytest.raises(FmuError, match="pip install pythonfmu"):
        build_class("other_law:OtherLaw", tmp_path)


@pytest.mark.parametrize("text", ["nowhere:A", "pathlib:Nothing", "pathlib:Path", "pathlib", ":A"])
def test_what_is_no_component_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ScenarioError):
        build_class(text, tmp_path)


def test_a_c_source_declared_anywhere_becomes_an_fmu(tmp_path: Path) -> None:
    (tmp_path / "leaky.py").write_text(DECLARATION)
    (tmp_path / "leaky.c").write_text(SOURCE)
    fmu = build_fmu(load_module(tmp_path / "leaky.py").model(), "2.0", tmp_path)
    assert not problems(fmu)
    run = {"step": 1e-3, "stop": 0.5}
    table = {"model": str(fmu), "start": {"u": 1.0}}
    document = {"run": run, "components": {"leaky": table}}
    y = recorded(build(document, tmp_path / "x.toml"))["leaky.y"]
    assert y[-1] == pytest.approx(1.0 - (1.0 - 2e-3) ** 500, rel=1e-12)


def test_the_c_model_of_the_page_becomes_an_fmu(tmp_path: Path) -> None:
    for language, name in (("py", "my_law_c.py"), ("c", "my_law.c")):
        (block,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
        (tmp_path / name).write_text(block)
    fmu = build_fmu(load_module(tmp_path / "my_law_c.py").model(), "2.0", tmp_path)
    assert not problems(fmu)
    law = {"model": str(fmu), "inputs": {"q": "arm.q"}}
    document = loop({})
    document["components"]["control"] = law
    y = recorded(build(document, tmp_path / "x.toml"))
    np.testing.assert_array_equal(y["control.tau[0]"][:-1], -20.0 * y["arm.q[0]"][:-1])


def test_a_file_that_declares_nothing_is_refused(tmp_path: Path) -> None:
    (path := tmp_path / "x.py").write_text("a = 1")
    with pytest.raises(ScenarioError, match=r"has no function model\(\)"):
        load_module(path)
    path.write_text("a = 1 / 0")  # of another length: bytecode is kept by time and size
    with pytest.raises(ScenarioError, match="ZeroDivisionError"):
        load_module(path)
    with pytest.raises(ScenarioError, match="no such file"):
        load_module(tmp_path / "none.py")
