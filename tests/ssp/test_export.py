"""A scenario as SSP: read again it gives the same bytes, and other masters the same numbers."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy.ssp
import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import Parameter, ParameterSet
from lxml import etree

from cosim.base.errors import ScenarioError
from cosim.engine.simulate import simulate
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.ssp import load
from cosim.ssp.container import write as write_container
from cosim.ssp.export import Links, write
from cosim.ssp.parameters import VALUES
from tests.ssp.parts import recorded
from tests.system.runs import Document, scenario, teleoperation

pytestmark = pytest.mark.usefixtures("compiled_once")

needs_tbb = pytest.mark.needs_tbb
STEP = 2.0**-9
CONSTANT = {"law": "constant", "delay": 25 * STEP}
UNIFORM = {"law": "uniform", "low": 0.02, "high": 0.3, "hold": "30 ms"}


def bytes_of(read: Scenario, folder: Path) -> bytes:
    """The trajectories of a run, as the file that holds them."""
    return (simulate(read, folder).folder / "trajectories.parquet").read_bytes()


def exported(read: Scenario, folder: Path, links: Links = "annotation") -> Path:
    """The SSP of a scenario."""
    path = folder / "out.ssp"
    write(read, assemble(read), path, links)
    return path


def synchronous(*delays: Mapping[str, Any], stop: float = 1.0) -> Document:
    """The teleoperator, everybody stepped in every tick, as other masters do it."""
    document = teleoperation(stop=stop)
    for table in document["components"].values():
        table.pop("period", None)
    document["run"] |= {"step": STEP, "algorithm": "jacobi"}
    for link, delay in zip(document["links"], delays, strict=True):
        link["delay"] = dict(delay)
    return document


@pytest.mark.parametrize("links", ["annotation", "fmu"])
def test_export_and_run_give_the_same_bytes(tmp_path: Path, links: Links) -> None:
    document = synchronous(UNIFORM, CONSTANT) if links == "fmu" else teleoperation(stop=1.0)
    read = scenario(document)
    again = load(exported(read, tmp_path, links))
    assert again.components.keys() == read.components.keys()
    assert bytes_of(read, tmp_path / "a") == bytes_of(again, tmp_path / "b")


def test_a_trace_travels_with_the_system(tmp_path: Path) -> None:
    (tmp_path / "wifi.csv").write_text("t_send,delay\n0,0.1\n0.5,0.25\n10,0.1\n")
    trace = {"law": "trace", "file": "wifi.csv"}
    read = scenario(synchronous(trace, CONSTANT), tmp_path / "here.toml")
    path = exported(read, tmp_path)
    (tmp_path / "wifi.csv").rename(tmp_path / "gone.csv")
    (moved := tmp_path / "elsewhere").mkdir()
    again = load(path.rename(moved / "there.ssp"))
    assert again.links[0].delay["file"].endswith("resources/links/wifi.csv")
    assemble(again)


def test_what_another_tool_changes_counts(tmp_path: Path) -> None:
    path = exported(scenario(teleoperation(stop=0.1)), tmp_path)
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    text = content["SystemStructure.ssd"].decode()
    assert 'name="lambda_M"' in text
    content["SystemStructure.ssd"] = text.replace('value="10.0"', 'value="7.5"').encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    assert load(path).components["master_control"].parameters["lambda_M"] == 7.5


def test_the_description_is_valid_by_the_schema(tmp_path: Path) -> None:
    folder = Path(fmpy.ssp.__file__).parent / "schema"
    schema = etree.XMLSchema(file=str(folder / "SystemStructureDescription.xsd"))
    with zipfile.ZipFile(exported(scenario(teleoperation(stop=0.1)), tmp_path)) as archive:
        schema.assertValid(etree.fromstring(archive.read("SystemStructure.ssd")))


# ---- other masters --------------------------------------------------------------------------


def ecos(path: Path, step: float, ticks: int, names: list[str]) -> np.ndarray:
    """Outputs at 0, h, 2 h, ... of Ecos running an SSP, (ticks + 1, names)."""
    from ecospy import EcosLib, EcosSimulation

    EcosLib.set_log_level("warn")
    rows = []
    with EcosSimulation(step, ssp_path=str(path)) as simulation:
        simulation.init(parameter_set=VALUES)
        for k in range(ticks + 1):
            if k:
                simulation.step()
            rows.append([simulation.get_real(n.replace(".", "::", 1)) for n in names])
        simulation.terminate()
    return np.array(rows)


@needs_tbb
@pytest.mark.parametrize(
    "delays", [(CONSTANT, CONSTANT), (UNIFORM, CONSTANT)], ids=["constant", "drawn"]
)
def test_ecos_sees_the_same_latency_to_the_last_bit(
    tmp_path: Path, delays: tuple[Mapping[str, Any], ...]
) -> None:
    read = scenario(synchronous(*delays))
    ours = recorded(read)
    names = [
        f"{side}.{q}[{i}]" for side in ("master", "slave") for q in ("q", "dq") for i in (0, 1)
    ]
    theirs = ecos(exported(read, tmp_path, "fmu"), STEP, 512, names)
    for i, name in enumerate(names):
        assert np.ptp(ours[name]) > 0.02
        np.testing.assert_array_equal(ours[name], theirs[:, i])
    without = ecos(exported(read, tmp_path), STEP, 512, names)
    assert np.abs(without - theirs).max() > 0.01


def test_fmpy_runs_it_to_the_same_trajectory(tmp_path: Path) -> None:
    """Its runner feeds zeros in the first step, so the loop starts where all that is fed is zero.

    It leaves parameter sets of the file alone, and takes one as an argument.
    """
    hand = {"T": 0.4, "q_f[0]": 0.8, "q_f[1]": -0.6}
    target = {"q_j": "hand.q_h", "dq_j": "hand.dq_h"}
    components = {
        "hand": {
            "model": "fmus.models.minimum_jerk",
            "parameters": {"T": 0.4, "q_f": [0.8, -0.6]},
        },
        "plant": {"model": "fmus.models.planar2r", "inputs": {"tau": "control.tau"}},
        "control": {
            "model": "fmus.models.pd",
            "inputs": {"q": "plant.q", "dq": "plant.dq"} | target,
        },
    }
    run = {"step": STEP, "stop": 256 * STEP, "algorithm": "jacobi"}
    read = build({"run": run, "components": components}, tmp_path / "loop.toml")
    path = exported(read, tmp_path)
    chosen = ParameterSet(
        parameters=[Parameter(name=f"hand.{k}", value=v) for k, v in hand.items()]
    )
    theirs = simulate_ssp(str(path), stop_time=256 * STEP, step_size=STEP, parameter_set=chosen)
    ours = recorded(read)
    assert np.ptp(ours["plant.q[0]"]) > 0.02
    assert np.abs(ours["plant.q[0]"][1:] - theirs["plant.q[0]"]).max() == 0.0


def test_a_closed_loop_with_its_latency_is_one_fmu(tmp_path: Path) -> None:
    """A container that fmu-manipulation-toolbox has packed, run here."""
    read = scenario(synchronous(UNIFORM, CONSTANT))
    write_container(read, assemble(read), tmp_path / "loop.fmu")
    run = {"step": STEP, "stop": 1.0}
    loop = build({"run": run, "components": {"loop": {"model": "loop.fmu"}}}, tmp_path / "x.toml")
    ours, inside = recorded(read), recorded(loop)
    for name in ("master.q[0]", "slave.q[1]", "slave.dq[0]", "master_control.tau[0]"):
        assert np.ptp(ours[name]) > 0.02
        np.testing.assert_array_equal(inside[f"loop.{name.replace('.', '_', 1)}"], ours[name])


def multirate(**periods: int) -> Document:
    """The teleoperator in Jacobi's way, components stepping every so many steps."""
    document = synchronous(UNIFORM, CONSTANT)
    for name, period in periods.items():
        document["components"][name]["period"] = period * STEP
    return document


@pytest.mark.parametrize(
    "periods",
    [
        {"master_control": 4, "slave_control": 4},
        {"master_control": 8, "slave_control": 8, "slave": 2},
    ],
)
def test_periods_are_containers_in_a_container(tmp_path: Path, periods: dict[str, int]) -> None:
    read = scenario(multirate(**periods))
    notes = write_container(read, assemble(read), tmp_path / "loop.fmu")
    slow = max(periods.values())
    assert notes == [f"its step is the longest period, {slow * STEP:g} s, or a multiple"]
    run = {"step": slow * STEP, "stop": 1.0}
    loop = build({"run": run, "components": {"loop": {"model": "loop.fmu"}}}, tmp_path / "x.toml")
    ours, inside = recorded(read), recorded(loop)
    for name in ("master.q[0]", "slave.q[1]", "slave.dq[0]", "master_control.tau[0]"):
        assert np.ptp(ours[name]) > 0.02
        found = inside[f"loop.{name.replace('.', '_', 1)}"]
        np.testing.assert_array_equal(found, ours[name][::slow], err_msg=name)


@pytest.mark.parametrize(
    ("periods", "message"),
    [
        ({"master": 2, "slave": 3}, "every 2 and every 3 ticks; in a container a period must"),
        ({"master_control": 4}, "its ends step every 4 and every 1 ticks; expected equal periods"),
    ],
)
def test_periods_that_do_not_nest_are_refused(
    tmp_path: Path, periods: dict[str, int], message: str
) -> None:
    read = scenario(multirate(**periods))
    with pytest.raises(ScenarioError, match=message):
        write_container(read, assemble(read), tmp_path / "x.fmu")


# ---- what cannot be exported ----------------------------------------------------------------


def test_a_python_component_is_refused(tmp_path: Path) -> None:
    document = teleoperation(stop=0.1)
    document["components"]["own"] = {"model": "fmus.models.xi:Xi"}
    read = scenario(document)
    with pytest.raises(ScenarioError, match="is a Python component, but an SSP contains FMUs"):
        write(read, assemble(read), tmp_path / "x.ssp")


def test_arrays_of_fmi_3_are_refused(tmp_path: Path) -> None:
    document = teleoperation(stop=0.1)
    document["components"]["master"]["fmi"] = "3.0"
    read = scenario(document)
    with pytest.raises(ScenarioError, match=r"array of FMI 3.0.*expected fmi = \"2.0\""):
        write(read, assemble(read), tmp_path / "x.ssp")


def test_a_delay_fmu_needs_one_rate_and_a_delay(tmp_path: Path) -> None:
    read = scenario(teleoperation(stop=0.1))
    with pytest.raises(ScenarioError, match="steps every 5 ticks"):
        write(read, assemble(read), tmp_path / "x.ssp", "fmu")
    none = {"law": "constant", "delay": 0.0}
    document = synchronous(none, CONSTANT, stop=STEP * 50)
    read = scenario(document)
    with pytest.raises(ScenarioError, match="expected a delay of at least one step"):
        write(read, assemble(read), tmp_path / "x.ssp", "fmu")


def test_what_other_tools_will_not_see_is_said(tmp_path: Path) -> None:
    read = scenario(teleoperation(stop=0.1))
    notes = write(read, assemble(read), tmp_path / "x.ssp")
    assert [note.split()[0:2] for note in notes] == [["other", "tools"]] * 2
    read = scenario(synchronous(CONSTANT, CONSTANT))
    assert not write(read, assemble(read), tmp_path / "y.ssp", "fmu")
