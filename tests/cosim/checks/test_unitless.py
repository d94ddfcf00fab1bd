"""FMUs of other tools have variables without a unit: they connect, and a check names them."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.checks.preflight import check
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.ssp import load
from tests.cosim.fmi.exporter import export, strict2
from tests.cosim.scenarios import document
from tests.ssp import parts


def found(tmp_path: Path, *, source: str, target: str) -> tuple[list[str], float]:
    """What the check says of a wire in rad to or from a variable without a unit, and its gain."""
    bare = str(export(strict2(), tmp_path / "bare.fmu"))
    components = {"arm": {"model": "fmus.models.planar2r"}, "bare": {"model": bare}}
    name, port = target.split(".")
    components[name]["inputs"] = {port: source}  # type: ignore[assignment]
    scenario = build(document(components), Path("test.toml"))
    plan = assemble(scenario)
    findings = [f for f in check(scenario, plan) if f.rule == "unitless"]
    return [f"{f.where}: {f.reason}" for f in findings], plan.wires[0].gain


def test_a_number_is_taken_as_it_is_and_the_connection_is_named(tmp_path: Path) -> None:
    said, gain = found(tmp_path, source="arm.q[0]", target="bare.u")
    assert gain == 1.0
    (line,) = said
    assert line.startswith("arm.q[0] -> bare.u: the FMU declares no unit for bare.u")
    assert "in [rad] is taken as it is" in line
    (line,) = found(tmp_path, source="bare.y", target="arm.tau[0]")[0]
    assert line.startswith("bare.y -> arm.tau[0]: the FMU declares no unit for bare.y")


def test_a_declared_1_is_a_unit(tmp_path: Path) -> None:
    assert found(tmp_path, source="bare.y", target="arm.grip")[0] == []
    with pytest.raises(
        ScenarioError, match=r"arm.tau_h\[0\] is in \[N.m\], arm.grip expects \[1\]"
    ):
        found(tmp_path, source="arm.tau_h[0]", target="arm.grip")


def test_a_unit_in_a_parameter_set_of_a_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = export(strict2(), tmp_path / "bare.fmu")
    monkeypatch.setitem(parts.FMUS, "bare", lambda version: bare)
    values = parts.bindings(parts.embedded({"gain": "3"}, unit="m"))
    inside = "".join(parts.connector(n, k) for n, k in (("u", "input"), ("y", "output")))
    text = (
        f'<ssd:Elements><ssd:Component name="one" source="resources/bare.fmu" '
        f'type="application/x-fmu-sharedlibrary"><ssd:Connectors>{inside}</ssd:Connectors>{values}'
        "</ssd:Component></ssd:Elements>"
    )
    path = parts.pack(tmp_path / "system.ssp", parts.ssd(text))
    scenario = load(path, ["run.step=0.1"])
    assert dict(assemble(scenario).component("one").values)["gain"] == (3.0,)
