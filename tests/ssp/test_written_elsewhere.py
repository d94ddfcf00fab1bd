"""SSP that another tool has written (pyssp-standard): the same run as the scenario by hand."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.cli.commands import app
from cosim.ssp import load
from tests.ssp.parts import FMUS, recorded
from tests.ssp.test_read import START, by_hand

pyssp = pytest.importorskip("pyssp_standard")

KINDS = {
    "control": ("pd", {"q": "input", "dq": "input", "tau": "output"}),
    "arm": ("planar2r", {"q": "output", "dq": "output", "tau": "input"}),
}
#: Values and their unit; without one, the other tool writes none of them.
VALUES = {
    "arm": (START, {"unit": "rad"}),
    "control": ({"K_p[0]": "20", "K_p[1]": "30"}, {"unit": "N.m/rad"}),
}
WIRES = (("arm.q", "control.q"), ("arm.dq", "control.dq"), ("control.tau", "arm.tau"))


def component(name: str) -> object:
    """A component and its connectors, by the other tool's classes."""
    from pyssp_standard.ssd import Component, Connector

    fmu, ports = KINDS[name]
    made = Component()
    made.name, made.source = name, f"resources/{fmu}.fmu"
    made.component_type = "application/x-fmu-sharedlibrary"
    made.connectors = [
        Connector(name=f"{port}[{i}]", kind=kind) for port, kind in ports.items() for i in (0, 1)
    ]
    return made


def binding(name: str, source: str | None) -> object:
    """The values of a component: in the description, or in a file of their own."""
    from pyssp_standard.ssd import ParameterBinding
    from pyssp_standard.ssv import Parameter, ParameterType, SSVElem

    if source is not None:
        return ParameterBinding(source=source)
    values, unit = VALUES[name]
    parameters = [
        Parameter(name=k, type_name="Real", type_value=ParameterType("Real", {"value": v} | unit))
        for k, v in values.items()
    ]
    return ParameterBinding(ssv=SSVElem(parameters=parameters))


def written(folder: Path, version: str, *, apart: bool) -> Path:
    """The loop of an arm and its control as the other tool writes it."""
    from pyssp_standard.ssd import DefaultExperiment, System

    path = folder / "elsewhere.ssp"
    with pyssp.SSP(path, mode="w") as ssp:
        for name, (fmu, _) in KINDS.items():
            ssp.add_resource(Path(shutil.copy(FMUS[fmu]("2.0"), folder / f"{fmu}.fmu")))
            if apart:
                ssp.add_resource(values_file(folder / f"{name}.ssv", name))
        with ssp.system_structure as ssd:
            ssd.name, ssd.version = "elsewhere", version
            ssd.system = System(name="root")
            ssd.system.elements = [component(name) for name in KINDS]
            for each in ssd.system.elements:
                source = f"resources/{each.name}.ssv" if apart else None
                each.parameter_bindings = [binding(each.name, source)]
            connect(ssd)
            ssd.default_experiment = DefaultExperiment()
            ssd.default_experiment.start_time, ssd.default_experiment.stop_time = 0.0, 0.5
            assert ssd.check_connections() == []
    return path


def values_file(path: Path, name: str) -> Path:
    values, unit = VALUES[name]
    with pyssp.SSV(path, mode="w") as ssv:
        for parameter, value in values.items():
            ssv.add_parameter(parameter, "Real", value=float(value), **unit)
    return path


def connect(ssd: Any) -> None:
    from pyssp_standard.ssd import Connection

    for start, end in WIRES:
        (a, x), (b, y) = start.split("."), end.split(".")
        for i in (0, 1):
            ends = {"start_element": a, "start_connector": f"{x}[{i}]"}
            ends |= {"end_element": b, "end_connector": f"{y}[{i}]"}
            ssd.add_connection(Connection(**ends))


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("apart", [False, True])
def test_it_runs_as_the_scenario_by_hand(tmp_path: Path, version: str, apart: bool) -> None:
    system = load(written(tmp_path, version, apart=apart), ["run.step='1 ms'"])
    found = recorded(system)
    expected = recorded(by_hand())
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_the_command_runs_it(tmp_path: Path) -> None:
    path = written(tmp_path, "1.0", apart=False)
    result = CliRunner().invoke(app, ["run", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "trajectories.parquet").exists()


def test_what_we_write_it_reads(tmp_path: Path) -> None:
    from tests.ssp.test_export import exported
    from tests.system.runs import scenario, teleoperation

    path = exported(scenario(teleoperation(stop=0.1)), tmp_path)
    with pyssp.SSP(path, mode="r") as ssp, ssp.system_structure as ssd:
        assert {e.name for e in ssd.system.elements} == {
            "master", "slave", "master_control", "slave_control",
        }  # fmt: skip
        assert ssd.check_connections() == []
        assert len(ssd.connections()) > 10
