"""One FMU for any number of joints: the bytes of one made for it, within the standard."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

import cosim
from cosim.base.errors import FmuError
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.file.validation import problems
from cosim.scenario.models import load_alike
from cosim.scenario.spec import ComponentSpec
from fmus.build.archive import ANY_SIZE, find, toolchain
from fmus.build.reference import Values
from fmus.build.shipped import shipped
from fmus.model import Model, any_size
from fmus.models import arm, operator, pd, teleoperation
from tests.fmus.chains import random_chain

pytestmark = pytest.mark.usefixtures("compiled_once")


def fmu(name: str) -> Path:
    return find(any_size(import_module(f"fmus.models.{name}").model), "3.0")


def start_values(name: str, n: int) -> Values:
    """Of a random arm, where the model has a table."""
    rng = np.random.default_rng(n)
    values: Values = {}
    if name.startswith("arm"):
        table = random_chain(rng, n).values()
        values |= {k: np.asarray(v, dtype=np.float64) for k, v in table.items()}
    if name == "arm":
        values |= {"q": rng.uniform(-1, 1, n), "dq": rng.uniform(-1, 1, n)}
        values |= {"k_p": rng.uniform(0, 5, n), "friction": rng.uniform(0, 0.5, n)}
    if name == "encoder":
        values["resolution"] = np.full(n, 1e-3)
    return values


def motion(component: FmuComponent, values: Values, n: int) -> bytes:
    """All outputs of twenty steps with random inputs."""
    rng = np.random.default_rng(n)
    inputs = {
        p.name: np.abs(rng.normal(size=(20, *p.shape))) * (0.1 if p.name == "grip" else 1.0)
        for p in component.inputs
    }
    component.initialize(values)
    rows = [component.initial({k: u[0] for k, u in inputs.items()})]
    rows += [
        component.step(k * 1e-3, 1e-3, {name: u[k] for name, u in inputs.items()})
        for k in range(20)
    ]
    component.close()
    return b"".join(np.asarray(row[name]).tobytes() for row in rows for name in row)


@pytest.mark.parametrize("name", ANY_SIZE)
def test_it_gives_the_bytes_of_one_made_for_this_number(name: str) -> None:
    module = import_module(f"fmus.models.{name}")
    for n in (1, 3) if name not in ("arm", "pd") else (1, 2, 7, 16):
        made = FmuComponent(find(module.model(joints=n), "3.0"))
        served = FmuComponent(fmu(name), options=FmuOptions(sizes={"joints": n}))
        assert [p.shape for p in served.outputs] == [p.shape for p in made.outputs]
        values = start_values(name, n)
        assert motion(served, values, n) == motion(made, values, n), n


def test_a_component_after_one_without_sizes_has_its_own() -> None:
    load = load_alike()
    for name, values, joints in (("a", {}, 2), ("b", {"joints": 3}, 3), ("c", {}, 2)):
        spec = ComponentSpec(model=str(fmu("pd")), parameters=values)
        found = load(name, spec, Path("."), f"components.{name}")[0]
        assert {p.shape for p in found.inputs} == {(joints,)}, name


@pytest.mark.parametrize("name", ANY_SIZE)
def test_it_follows_the_standard(name: str) -> None:
    assert problems(fmu(name)) == []


def test_another_importer_sets_the_number_and_gets_the_same_motion() -> None:
    """FMPy: three joints swing as those of an FMU that was made for three."""
    served = by_fmpy(fmu("arm"), any_size(arm.model), 3)
    made = by_fmpy(find(arm.model(joints=3), "3.0"), arm.model(joints=3), 0)
    assert len(served) == 3 and served == made and max(map(abs, served)) > 0.1


def by_fmpy(path: Path, model: Model, joints: int) -> list[float]:
    """q after 50 steps; `joints` 0: there is no structural parameter."""
    from fmpy import extract, read_model_description
    from fmpy.fmi3 import FMU3Slave

    folder, read = extract(str(path)), read_model_description(str(path))
    slave = FMU3Slave(
        guid=read.guid, unzipDirectory=folder, modelIdentifier=read.coSimulation.modelIdentifier
    )
    place = {v.name: k for k, v in enumerate(model.variables)}
    slave.instantiate()
    if joints:
        slave.enterConfigurationMode()
        slave.setUInt64([place["joints"]], [joints])
        slave.exitConfigurationMode()
    for name, value in start_values("arm", 3).items():
        set_ = slave.setInt32 if name == "joint_type" else slave.setFloat64
        set_([place[name]], np.ravel(value).astype(int if name == "joint_type" else float).tolist())
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for k in range(50):
        slave.doStep(k * 1e-3, 1e-3)
    q: list[float] = slave.getFloat64([place["q"]], nValues=3)
    slave.terminate()
    slave.freeInstance()
    return list(q)


@pytest.mark.parametrize("n", [0, 17])
def test_a_number_out_of_range_is_refused(n: int) -> None:
    component = FmuComponent(fmu("pd"), options=FmuOptions(sizes={"joints": n}))
    with pytest.raises(FmuError, match=f"joints is {n}, expected between 1 and 16|at least one"):
        component.initialize({})


def test_a_state_of_another_number_is_restored_with_it() -> None:
    component = FmuComponent(fmu("encoder"), options=FmuOptions(sizes={"joints": 3}))
    component.initialize({"resolution": np.full(3, 0.1)})
    component.initial({"q": np.ones(3)})
    component.step(0.0, 1e-3, {"q": np.ones(3)})
    saved = component.get_state()
    first = component.step(1e-3, 1e-3, {"q": np.full(3, 1.26)})
    component.set_state(saved)
    again = component.step(1e-3, 1e-3, {"q": np.full(3, 1.26)})
    assert np.array_equal(first["dq_m"], again["dq_m"]) and np.shape(first["q_m"]) == (3,)


def test_a_serialised_state_with_more_joints_than_there_is_room_for_is_refused() -> None:
    """It would be read beyond the end of the arrays."""
    from fmpy import extract, read_model_description
    from fmpy.fmi3 import FMU3Slave

    path = fmu("pd")
    read = read_model_description(str(path))
    slave = FMU3Slave(guid=read.guid, unzipDirectory=extract(str(path)), modelIdentifier="pd_any")
    slave.instantiate()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    state = slave.getFMUState()
    serialised = bytearray(slave.serializeFMUState(state))
    place = 48 + 8 * sum(v.size for v in any_size(pd.model).variables[:-1])
    assert np.frombuffer(serialised, "<f8", 1, place) == 2.0
    assert serialised[-4:] == crc32(serialised[:-4]).to_bytes(4, "little")
    for size in (17.0, 0.0, 2.5, -1.0, np.nan):
        serialised[place : place + 8] = np.array([size], "<f8").tobytes()
        serialised[-4:] = crc32(serialised[:-4]).to_bytes(4, "little")
        with pytest.raises(Exception, match="fmi3DeserializeFMUState failed"):
            slave.deserializeFMUState(bytes(serialised))
    slave.freeFMUState(state)
    slave.freeInstance()


def test_a_model_whose_entries_would_not_lie_together_is_refused() -> None:
    with pytest.raises(FmuError, match=r"operator.q_h: its start values depend on joints"):
        any_size(operator.model)
    with pytest.raises(FmuError, match=r"xi_in: shape .* expected neighbours as its first extent"):
        any_size(lambda neighbours=1: _transposed(neighbours), "neighbours")


def _transposed(neighbours: int):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    model = teleoperation.model(neighbours=neighbours)
    turned = [replace(v, shape=v.shape[::-1]) for v in model.variables]
    return replace(model, variables=tuple(turned))


SCENARIO = """\
[run]
step = "1 ms"
stop = "0.1 s"
[components.plant]
model = "fmus.models.arm"
sizes = { joints = 3 }
start.q = [0.1, 0.2, 0.3]
inputs.tau = "control.tau"
[components.control]
model = "fmus.models.pd"
sizes = { joints = 3 }
inputs = { q = "plant.q", dq = "plant.dq" }
[components.control.start]
q_j = [0.0, 0.0, 0.0]
dq_j = [0.0, 0.0, 0.0]
"""


def test_without_a_compiler_an_installation_runs_any_number_of_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shipped(any_size(arm.model), "3.0") is None:
        pytest.skip("the FMUs of this checkout are older than its sources")
    (tmp_path / "arm.toml").write_text(SCENARIO)
    cosim.run(tmp_path / "arm.toml", out=tmp_path / "a")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
    monkeypatch.setattr(toolchain, "compiler", _none)
    cosim.run(tmp_path / "arm.toml", out=tmp_path / "b")
    same = [tmp_path / run / "trajectories.parquet" for run in "ab"]
    assert same[0].read_bytes() == same[1].read_bytes()


def _none(*_: object) -> None:
    raise toolchain.ToolchainError("no compiler")
