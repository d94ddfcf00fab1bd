"""Rivals of serial arms: C and NumPy agree, and the planar arm's table gives the planar law."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from cosim.base.errors import CosimError
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record.run import Run
from fmus.models import (
    abdessameud2014,
    arm_abdessameud2014,
    arm_chopra,
    arm_nuno_adaptive,
    arm_wang2014,
    chopra,
    nuno_adaptive,
    wang2014,
)
from tests.fmus.chains import planar
from tests.fmus.test_arm_teleoperation import H, motion, played, values_of
from tests.fmus.test_conformance_dependencies import Probe, by_variable, declared
from tests.tiers import first_fast

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.usefixtures("compiled_once")
#: The law of a serial arm and the planar one, with the names of their classes.
LAWS = [
    (arm_wang2014, "ArmWang2014", wang2014, "Wang2014"),
    (arm_nuno_adaptive, "ArmNunoAdaptive", nuno_adaptive, "NunoAdaptive"),
    (arm_chopra, "ArmChopra", chopra, "Chopra"),
    (arm_abdessameud2014, "ArmAbdessameud2014", abdessameud2014, "Abdessameud2014"),
]


@pytest.mark.parametrize(("law", "name", "flat", "flat_name"), first_fast(LAWS))
@pytest.mark.parametrize("neighbours", first_fast([1, 2]))
def test_c_equals_numpy(
    law: ModuleType, name: str, flat: ModuleType, flat_name: str, neighbours: int
) -> None:
    reference = getattr(law, name)(joints=4, neighbours=neighbours)
    declared = {p.name for p in (*reference.parameters, *reference.outputs)}
    u = motion(reference, 20, 5)
    for gravity in (0, 1, 2):
        values = values_of(4, np.random.default_rng(gravity), gravity=gravity)
        values["tau_max"] = np.full(4, 20.0 if gravity == 1 else 1e9)  # the first limits
        given = {key: value for key, value in values.items() if key in declared}
        in_numpy = played(reference, given, u)
        in_c = played(law.kernel(joints=4, neighbours=neighbours), given, u)
        assert np.allclose(in_c, in_numpy, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(("law", "name", "flat", "flat_name"), LAWS)
def test_with_the_planar_arm_it_is_the_planar_law(
    law: ModuleType, name: str, flat: ModuleType, flat_name: str
) -> None:
    """The same torques, where the estimates are the same and stand still."""
    theta = np.array([3.34, 1.20, 0.97])
    table = planar(theta, np.zeros(2))
    serial, known = getattr(law, name)(joints=2), getattr(flat, flat_name)()
    u = motion(serial, 15, 9)
    gains = {"K": np.array([5.0, 7.0])}
    serial.initialize(
        gains
        | {"gravity": np.array(0.0), "theta_hat": table.inertia, "Gamma": np.zeros((2, 10))}
        | table.values()
    )
    known.initialize(gains | {"theta_hat": theta, "Gamma": np.zeros(3)})
    assert np.allclose(serial.initial(u[0])["tau"], known.initial(u[0])["tau"], atol=1e-11)
    for k, x in enumerate(u):
        a, b = serial.step(k * H, H, x), known.step(k * H, H, x)
        for port in a.keys() - {"theta_hat"}:
            assert np.allclose(a[port], b[port], rtol=0, atol=1e-11)


def test_a_table_that_cannot_be_is_refused() -> None:
    for make in (arm_wang2014.ArmWang2014, arm_wang2014.kernel):
        component = make(joints=4)
        with pytest.raises(CosimError, match="mass"):
            component.initialize({"inertia": -np.ones((4, 10))})
            component.initial(motion(component, 1, 1)[0])


@pytest.mark.slow
def test_two_arms_under_static_feedback_agree_over_a_constant_delay(tmp_path: Path) -> None:
    """The scenario of the FR3 with the controllers replaced, without an operator."""
    text = (ROOT / "configs" / "robots" / "fr3.toml").read_text()
    text = text.replace("fmus.models.arm_teleoperation", "fmus.models.arm_wang2014:kernel")
    text = text.replace("alpha = 0.5\n", "").replace("lambda_M = 10.0\n", "")
    text = text.replace("lambda = 2.0", "lambda = 1.0").replace(", k_p = 10.0, k_d = 5.0", "")
    head, links = text.split("[[links]]")[0], ""
    for here, there in (("master", "slave"), ("slave", "master")):
        for port in ("q", "dq"):
            ends = f'from = "{there}.{port}"\nto = "{here}_control.{port}_j"'
            links += f'[[links]]\n{ends}\ndelay = {{ law = "constant", delay = "500 ms" }}\n'
    urdf = ROOT / "configs" / "robots" / "fr3.urdf"
    (tmp_path / "s.toml").write_text((head + links).replace('"fr3.urdf"', f'"{urdf}"'))
    simulate(load(tmp_path / "s.toml"), tmp_path / "run")
    run = Run.open(tmp_path / "run")
    apart = np.abs(run.array("master.q") - run.array("slave.q")).max(axis=1)
    assert apart[0] > 0.5
    assert apart[-1] < 1e-2
    assert np.abs(run.array("master.dq")[-1]).max() < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("law", [law for law, *_ in LAWS])
def test_the_dependencies_declared_are_those_there_are(law: ModuleType) -> None:
    model = law.model(joints=3)
    for in_steps, group in ((False, "InitialUnknowns"), (True, "Outputs")):
        seen, said = Probe(model, in_steps).dependencies(), declared(model, group)
        assert seen <= said
        assert by_variable(seen) == by_variable(said)
