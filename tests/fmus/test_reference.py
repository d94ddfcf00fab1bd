"""A declaration and a law become a component; laws hold for any number of joints."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from fmus.build.reference import Reference, Values, derive
from fmus.model import Model, Variable
from fmus.models import lee_spong, operator, p_d, pd, tdpa_impedance, wave_admittance, xi


def integrator() -> Model:
    return Model(
        identifier="integrator",
        description="dy/dt = k u",
        kind="continuous",
        variables=(
            Variable("u", "input"),
            Variable("y", "output", settable=True),
            Variable("n", "local"),
            Variable("k", "parameter", start=2.0, minimum=0.0),
        ),
        sources=(),
    )


def law(x: Values, t: float, h: float, u: np.ndarray) -> Values:
    return {"y": x["y"] + h * x["k"] * u, "n": x["n"] + 1}


def start(x: Values, u: np.ndarray) -> Values:
    if x["k"] == 7.0:
        raise ScenarioError("k is 7", "integrator.k")
    return {"y": x["y"], "n": np.array(0.0)}


def test_what_a_law_returns_is_the_state_of_the_next_step() -> None:
    made = Reference(integrator(), law, start)
    made.initialize({"k": 3.0, "y": 1.0})
    assert made.initial({"u": 5.0}) == made.initial({"u": 8.0}) == {"y": 1.0}
    assert made.step(0.0, 0.5, {"u": 2.0}) == {"y": 4.0}  # a local is no output
    kept = made.get_state()
    assert made.step(0.5, 0.5, {"u": 2.0}) == {"y": 7.0}
    made.set_state(kept)
    assert made.step(0.5, 0.5, {"u": 4.0}) == {"y": 10.0}


def test_after_an_error_nothing_has_changed() -> None:
    made = Reference(integrator(), law, start)
    with pytest.raises(ScenarioError, match="k is 7"):
        made.initialize({"k": 7.0})
    made.initial({})
    with pytest.raises(RunError, match="input u is nan"):
        made.step(0.0, 1.0, {"u": np.nan})
    with pytest.raises(RunError, match=r"output y is inf.*diverged"), np.errstate(over="ignore"):
        made.step(0.0, 1e308, {"u": 1e308})
    assert made.step(0.0, 1.0, {"u": 1.0}) == {"y": 2.0}


def test_what_is_derived_takes_the_sizes_of_the_model() -> None:
    def sized(n: int = 1) -> Model:
        return replace(integrator(), variables=(Variable("y", "output", (n,)),))

    derived = derive(sized, lambda x, t, h: {"y": np.zeros(x.get("y", np.zeros(3)).shape)})
    assert derived.reference(n=3).outputs[0].shape == derived.reference(3).outputs[0].shape == (3,)
    with pytest.raises(TypeError, match="unexpected keyword argument 'm'"):
        derived.reference(m=3)


JOINTS = (xi, operator, pd, p_d, lee_spong, wave_admittance, tdpa_impedance)


@pytest.mark.parametrize("module", JOINTS, ids=lambda module: module.__name__.split(".")[-1])
def test_a_law_of_each_joint_holds_for_any_number_of_joints(module: ModuleType) -> None:
    """Joint by joint the numbers are those of the law for two."""

    def wide(v: Variable) -> Variable:
        starts = v.starts[:1] * 5 if v.shape else v.starts
        return replace(v, shape=(5,), start=starts) if v.shape else v

    model = module.model()
    five = replace(model, variables=tuple(map(wide, model.variables)))
    two = replace(five, variables=tuple(replace(v, shape=(2,), start=v.starts[:2]) if v.shape
                                        else v for v in five.variables))  # fmt: skip
    given = {"start": vars(module).get("start")}
    pair, wider = (Reference(each, module.law, **given) for each in (two, five))
    numbers = np.random.default_rng(5)
    for k in range(4):
        u = {port.name: numbers.uniform(-1, 1, port.shape) for port in wider.inputs}
        first = {name: value[:2] for name, value in u.items()}
        if k == 0:
            y, expected = wider.initial(u), pair.initial(first)
        else:
            y, expected = wider.step(k * 5e-3, 5e-3, u), pair.step(k * 5e-3, 5e-3, first)
        for name, value in expected.items():
            assert np.shape(y[name]) == (5,)
            assert np.array_equal(np.asarray(y[name])[:2], value)


def test_declarations_are_read_without_numpy() -> None:
    """An installation builds the FMUs in an environment that has setuptools and nothing else."""
    code = (
        "import sys\n"
        "for name in ('numpy', 'msgspec', 'fmpy', 'typer', 'pyarrow'): sys.modules[name] = None\n"
        "from fmus.build.archive import shipped_models\n"
        "from fmus.build.source import sources\n"
        "from fmus.build.description import model_description\n"
        "for model in shipped_models(): sources(model), model_description(model, '3.0')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
