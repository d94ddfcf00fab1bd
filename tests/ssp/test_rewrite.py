"""An SSP that was read is written again: nothing of others is lost, and the run is the same."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

import fmpy.ssp
import numpy as np
import pytest
from lxml import etree
from typer.testing import CliRunner

from cosim.cli.commands import app
from cosim.engine.simulate import simulate
from cosim.scenario.assemble import assemble
from cosim.ssp import load
from cosim.ssp.export import write
from tests.cosim.fmi.exporter import export, strict2
from tests.ssp.parts import (
    SPACES,
    bindings,
    component,
    embedded,
    pack,
    part,
    recorded,
    ssd,
    values,
    wire,
)
from tests.ssp.test_published import inner
from tests.ssp.test_read import ARM, BACK, CONTROL, LOOP, START, connections

GEOMETRY = '<ssd:ElementGeometry x1="0" y1="0" x2="10" y2="10" iconSource="icon.svg"/>'
OTHERS = (
    '<ssd:Annotations><ssc:Annotation type="com.example.gui"><gui:Window xmlns:gui="urn:gui" '
    'dark="true">A &amp; B</gui:Window></ssc:Annotation></ssd:Annotations>'
)
BUS = (
    '<ssd:SignalDictionaryReference name="bus" dictionary="d"><ssd:Connectors>'
    '<ssd:Connector name="tau[0]" kind="inout"/><ssd:Connector name="tau[1]" kind="inout"/>'
    "</ssd:Connectors></ssd:SignalDictionaryReference>"
)
DICTIONARY = '<ssd:SignalDictionary name="d" source="resources/d.ssb"/>'


def whole(version: str = "1.0") -> tuple[str, dict[str, str]]:
    """All that an archive can have: a system in a file, sets, a mapping, a bus, others' notes."""
    ports = {f"{p}[{i}]": k for p, k in CONTROL.items() for i in (0, 1)}
    control = part(
        "control", "parts/control.ssd", "", 'type="application/x-ssp-definition"', **ports
    )
    arm = component("arm", "planar2r", GEOMETRY + bindings(embedded(START, unit="rad")), **ARM)
    bound = (
        '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/gains.ssv" prefix="a.">'
        '<ssd:ParameterMapping source="resources/gains.ssm"/></ssd:ParameterBinding>'
        "</ssd:ParameterBindings>"
    )
    back = BACK.replace('endElement="arm"', 'endElement="bus"')
    back += "".join(wire(f"bus.tau[{i}]", f"arm.tau[{i}]") for i in (0, 1))
    system = (
        f"{bound}<!-- the loop --><ssd:Elements>{arm}{control}{BUS}</ssd:Elements>"
        f"{connections(LOOP + back)}<ssd:SignalDictionaries>{DICTIONARY}</ssd:SignalDictionaries>"
    )
    mapping = (
        f'<ssm:ParameterMapping {SPACES} version="{version}"><ssm:MappingEntry source="a.soft" '
        'target="control.pd.K_p[0]"><ssc:LinearTransformation factor="2"/></ssm:MappingEntry>'
        "</ssm:ParameterMapping>"
    )
    dictionary = (
        f'<ssb:SignalDictionary {SPACES} version="{version}"><ssb:DictionaryEntry name="tau[0]">'
        '<ssc:Real unit="N.m"/></ssb:DictionaryEntry></ssb:SignalDictionary>'
    )
    files = {
        "resources/gains.ssv": values({"soft": "10"}), "resources/gains.ssm": mapping,
        "resources/d.ssb": dictionary, "parts/control.ssd": inner(version),
        "documentation/read.me": "theirs",
    }  # fmt: skip
    return ssd(system, version, OTHERS), files


def packed(path: Path, version: str = "1.0") -> Path:
    from tests.ssp.parts import FMUS

    text, files = whole(version)
    return pack(path, text, files, {"parts/resources/pd.fmu": FMUS["pd"]("2.0")})


def entries(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def again(path: Path, out: Path, settings: Sequence[str] = ()) -> list[str]:
    read = load(path, ["run.step='1 ms'", *settings])
    return write(read, assemble(read), out)


def trajectories(path: Path, folder: Path, settings: Sequence[str] = ()) -> bytes:
    found = simulate(load(path, settings), folder).folder
    return (found / "trajectories.parquet").read_bytes()


def valid(path: Path, version: str) -> None:
    """Valid by the schemas of the standard: 1.0 from FMPy, 2.0 from pyssp-standard."""
    folder = Path(fmpy.ssp.__file__).parent / "schema"
    if version == "2.0":
        pyssp = pytest.importorskip("pyssp_standard")
        folder = Path(pyssp.__file__).parent / "resources" / "ssp2"
    schema = etree.XMLSchema(file=str(folder / "SystemStructureDescription.xsd"))
    schema.assertValid(etree.fromstring(entries(path)["SystemStructure.ssd"]))


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_what_is_not_changed_is_the_same_to_the_byte(tmp_path: Path, version: str) -> None:
    path = packed(tmp_path / "in.ssp", version)
    valid(path, version)
    read = load(path)
    assert read.components["control_pd"].parameters["K_p"] == [20.0, 7.0]
    assert not write(read, assemble(read), tmp_path / "out.ssp")
    assert entries(tmp_path / "out.ssp") == entries(path)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_changes_are_added_and_all_else_stays(tmp_path: Path, version: str) -> None:
    path, out = packed(tmp_path / "in.ssp", version), tmp_path / "out.ssp"
    changes = [
        "run.stop=0.3", "components.control_pd.parameters.K_p=[25, 30]",
        "components.arm.parameters.q=['90 deg', -0.25]", "components.control_pd.period='2 ms'",
    ]  # fmt: skip
    notes = again(path, out, changes)
    assert notes == ["other tools step control_pd in every step, not at their own period"]
    before, after = entries(path), entries(out)
    assert {k: v for k, v in before.items() if k != "SystemStructure.ssd"} == {
        k: v for k, v in after.items() if k != "SystemStructure.ssd"
    }
    text = after["SystemStructure.ssd"].decode()
    kept_words = (
        "<!-- the loop -->", "gui:Window", "A &amp; B", "ElementGeometry", "gains.ssm",
        'name="control.pd.K_p[1]"', 'stopTime="0.3"', 'source="parts/control.ssd"',
    )  # fmt: skip
    for kept in kept_words:
        assert kept in text
    assert not re.search(r"\bns\d+:", text)
    valid(out, version)
    ours = trajectories(path, tmp_path / "a", ["run.step='1 ms'", *changes])
    assert trajectories(out, tmp_path / "b") == ours
    assert np.ptp(recorded(load(out))["arm.q[0]"]) > 0.1


def test_written_twice_it_has_one_annotation_of_ours(tmp_path: Path) -> None:
    path = packed(tmp_path / "in.ssp")
    again(path, tmp_path / "one.ssp", ["components.arm.parameters.q=[0.1, 0.2]"])
    again(tmp_path / "one.ssp", tmp_path / "one.ssp", ["run.seed=3"])  # in place
    text = entries(tmp_path / "one.ssp")["SystemStructure.ssd"].decode()
    assert text.count("cosim-bridge.scenario") == 1
    read = load(tmp_path / "one.ssp")
    assert (read.run.seed, read.components["arm"].parameters["q"]) == (3, [0.1, 0.2])


def test_texts_and_values_of_a_system_that_has_none_yet(tmp_path: Path) -> None:
    fmus = {"strict.fmu": export(strict2(), tmp_path / "strict.fmu")}
    one = part("a", "strict.fmu", u="input", y="output")
    path = pack(tmp_path / "in.ssp", ssd(f"<ssd:Elements>{one}</ssd:Elements>"), fmus=fmus)
    changes = ["components.a.start.u=2", "components.a.parameters.how=1"]
    notes = again(path, tmp_path / "out.ssp", changes)
    assert notes == ["other tools find no step in the file, not 0.001 s"]
    valid(tmp_path / "out.ssp", "1.0")
    assert load(tmp_path / "out.ssp").components["a"].parameters == {"u": 2.0, "how": 1.0}


def test_with_other_connections_it_is_written_flat_and_that_is_said(tmp_path: Path) -> None:
    path, out = packed(tmp_path / "in.ssp"), tmp_path / "out.ssp"
    change = 'components.arm.inputs."tau[0]"={from="control_pd.tau[0]", gain=0.5}'
    arguments = ["export", str(path), "--ssp", str(out), "--set", "run.step=0.001", "--set", change]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "note: nested systems are written flattened" in " ".join(result.output.split())
    assert load(out).components["arm"].inputs["tau[0]"].gain == 0.5  # type: ignore[union-attr]
    valid(out, "1.0")


def test_a_table_and_events_travel_with_the_system(tmp_path: Path) -> None:
    """Of a scenario of our own: what SSP has no word for is in the annotation."""
    export(strict2(), tmp_path / "strict.fmu")
    (tmp_path / "u.csv").write_text("time,u\n0,1\n0.2,3\n")
    (tmp_path / "s.toml").write_text(
        '[run]\nstep = 0.1\nstop = 0.5\nalgorithm = "jacobi"\n[components.a]\n'
        'model = "strict.fmu"\n'
        'inputs.u = { table = "u.csv" }\n[components.b]\nmodel = "strict.fmu"\n'
        'inputs.u = "a.y"\n[[events]]\nat = 0.3\nset = { "b.rate" = 2.0 }\n'
    )
    from cosim.loading.files import load as load_scenario

    read = load_scenario(tmp_path / "s.toml")
    (folder := tmp_path / "elsewhere").mkdir()
    write(read, assemble(read), folder / "out.ssp")
    ours = recorded(read)
    (tmp_path / "u.csv").unlink()
    theirs = recorded(load(folder / "out.ssp"))
    assert ours["a.y"][-1] > 1.5 and ours["b.y"][-1] > 1.5
    for name, column in ours.items():
        np.testing.assert_array_equal(theirs[name], column, err_msg=name)
