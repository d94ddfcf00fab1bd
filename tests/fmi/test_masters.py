"""Each of our models as an FMU, unchanged, in other masters: the same numbers as in our engine.

FMPy, libcosim and Ecos share no code with this project. The step, 2^-9 s, is exact in their times
(tests/system/test_foreign.py has whole systems).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.schedule.plan import Plan
from fmus.build.archive import find, shipped_models
from fmus.model import Model
from tests.cosim.scenarios import plan
from tests.system import foreign
from tests.system.runs import signals

STEPS, H = 16, 2.0**-9
#: Where the defaults are for longer steps.
VALUES = {"reaction": {"reaction": 0.02}}
MASTERS = [
    pytest.param(foreign.fmpy, "2.0", id="FMPy, FMI 2.0"),
    pytest.param(foreign.fmpy, "3.0", id="FMPy, FMI 3.0"),
    pytest.param(foreign.libcosim, "2.0", id="libcosim"),
    pytest.param(foreign.ecos, "2.0", id="Ecos", marks=pytest.mark.needs_tbb),
]


def alone(model: Model, fmi: str) -> Plan:
    """The FMU of a model, stepped in every tick, without connections."""
    path = str(find(model, fmi))  # type: ignore[arg-type]
    values = VALUES.get(model.identifier, {})
    given = {"algorithm": "jacobi", "step": H, "stop": STEPS * H}
    return plan({"x": {"model": path, "kind": "continuous", "parameters": values}}, **given)


@pytest.mark.parametrize(("master", "fmi"), MASTERS)
@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
def test_a_model_gives_the_same_numbers(
    tmp_path: Path, model: Model, master: object, fmi: str
) -> None:
    ours = alone(model, fmi)
    recorded = signals(ours)
    theirs = master(alone(model, fmi), tmp_path)  # type: ignore[operator]
    at = {n: s.start + i for s in ours.components[0].outputs for i, n in enumerate(s.scalars())}
    assert theirs.keys() == at.keys()
    for name, found in theirs.items():
        np.testing.assert_array_equal(found, recorded[-len(found) :, at[name]], err_msg=name)
