"""What stopped the systems that others have published, each in a system of its own.

The descriptions are written here after the published ones: units in parameter sets, connections to
variables without a unit, steps in annotations of the Open Simulation Platform and of OMSimulator,
FMUs of both interfaces, systems in files of their own, mappings, names with brackets.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.base.errors import CosimError, ScenarioError
from cosim.cli.commands import app
from cosim.scenario.assemble import assemble
from cosim.ssp import load
from cosim.ssp.document import ignored
from tests.cosim.fmi.exporter import exchange2, export, nasty2, passing3, strict2
from tests.ssp.parts import (
    FMUS,
    SPACES,
    bindings,
    component,
    connect,
    connector,
    embedded,
    pack,
    part,
    recorded,
    ssd,
    values,
    wire,
)
from tests.ssp.test_read import (
    ARM,
    BACK,
    CONTROL,
    LOOP,
    START,
    assert_same,
    by_hand,
    connections,
    elements,
)

IO = {"u": "input", "y": "output"}
OSP = 'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations"'


def two(first: str = "", second: str = "", wires: str = "", rest: str = "", **more: str) -> str:
    """Two FMUs ``strict.fmu`` in a row, with what is inside of each."""
    both = part("a", "strict.fmu", first, **IO) + part("b", "strict.fmu", second, **IO)
    return ssd(f"<ssd:Elements>{both}</ssd:Elements>{connections(wires)}{rest}", **more)


@pytest.fixture
def strict(tmp_path: Path) -> dict[str, Path]:
    return {"strict.fmu": export(strict2(), tmp_path / "strict.fmu")}


def units(u: str = "", gain: str = "") -> str:
    """The FMU with units of its input and its gain."""
    text = strict2()
    for name, unit in (("u", u), ("gain", gain)):
        if unit:
            head, tail = text.split(f'name="{name}"')
            typed = tail.replace("<Real ", f'<Real unit="{unit}" ', 1)
            text = f'{head}name="{name}"{typed}'
    return text


# ---- units --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("own", "given", "expected"),
    [("m", "m", 3.0), ("", "m", 3.0), ("m", "mm", 0.003), ("pu", "pu", 3.0), ("", "pu", 3.0)],
)
def test_a_unit_in_a_parameter_set(tmp_path: Path, own: str, given: str, expected: float) -> None:
    """Also one that is defined nowhere, if the FMU calls its variable's unit the same."""
    fmu = {"strict.fmu": export(units(gain=own), tmp_path / "strict.fmu")}
    text = two(bindings(embedded({"gain": "3"}, unit=given)))
    found = load(pack(tmp_path / "x.ssp", text, fmus=fmu), ["run.step=0.1"])
    assert found.components["a"].parameters["gain"] == pytest.approx(expected, rel=1e-15)


def test_an_unknown_unit_for_a_variable_with_another_is_ignored_with_a_warning(
    tmp_path: Path,
) -> None:
    fmu = {"strict.fmu": export(units(gain="m"), tmp_path / "strict.fmu")}
    path = pack(tmp_path / "x.ssp", two(bindings(embedded({"gain": "3"}, unit="pu"))), fmus=fmu)
    assert load(path, ["run.step=0.1"]).components["a"].parameters["gain"] == 3.0
    (said,) = ignored(path)
    assert "a.gain is given in 'pu' and has the unit 'm': 'pu' is not defined" in said
    path = pack(tmp_path / "x.ssp", two(bindings(embedded({"gain": "3"}, unit="s"))), fmus=fmu)
    with pytest.raises(ScenarioError, match=r"a\.gain: \[s\] cannot feed \[m\]"):
        load(path)


def test_a_wire_to_an_input_without_a_unit_is_a_warning(tmp_path: Path) -> None:
    fmus = {
        "strict.fmu": export(strict2(), tmp_path / "strict.fmu"),
        "metres.fmu": export(units(u="m"), tmp_path / "metres.fmu"),
    }
    text = two(wires=wire("a.y", "b.u")).replace("strict.fmu", "metres.fmu", 2)
    text = text.replace("metres.fmu", "strict.fmu", 1)
    path = pack(tmp_path / "x.ssp", text, fmus=fmus)
    result = CliRunner().invoke(app, ["check", str(path), "--set", "run.step=0.1"])
    assert result.exit_code == 0, result.output
    assert "the FMU declares no unit for a.y" in " ".join(result.output.split())


# ---- the step -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "said",
    [
        '<osp:SimulationInformation><osp:FixedStepAlgorithm baseStepSize="2.5e-3"/>'
        "</osp:SimulationInformation>",
        '<osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="0.0025" numWorkerThreads="-1"/>'
        "</osp:Algorithm>",
        '<osp:SimulationInformation><osp:FixedStepMaster description="FixedStepAlgorithm" '
        'stepSize="0.0025"/></osp:SimulationInformation>',
    ],
    ids=["OSP", "OSP, now", "early OSP and OMSimulator"],
)
def test_the_step_of_an_annotation(tmp_path: Path, strict: dict[str, Path], said: str) -> None:
    inside = (
        f'<ssd:Annotations><ssc:Annotation type="com.opensimulationplatform" {OSP}>{said}'
        "</ssc:Annotation></ssd:Annotations>"
    )
    text = two().replace('stopTime="0.5"/>', f'stopTime="0.5">{inside}</ssd:DefaultExperiment>')
    assert load(pack(tmp_path / "x.ssp", text, fmus=strict)).run.step == 0.0025


def test_a_step_that_is_no_number_is_refused(tmp_path: Path, strict: dict[str, Path]) -> None:
    text = two(rest='<ssd:Annotations><FixedStepAlgorithm baseStepSize="fast"/></ssd:Annotations>')
    with pytest.raises(ScenarioError, match="baseStepSize 'fast' is no number"):
        load(pack(tmp_path / "x.ssp", text, fmus=strict))


# ---- which interface, and which binary ----------------------------------------------------------

BOTH = exchange2(more='<CoSimulation modelIdentifier="exchange2"/>')


@pytest.mark.parametrize(
    ("attributes", "kind"),
    [("", None), ('implementation="any"', None), ('implementation="CoSimulation"', None),
     ('implementation="ModelExchange"', "model exchange")],
)  # fmt: skip
def test_an_fmu_that_declares_model_exchange_as_well(
    tmp_path: Path, attributes: str, kind: str | None
) -> None:
    fmus = {"both.fmu": export(BOTH, tmp_path / "both.fmu")}
    inside = part("a", "both.fmu", "", attributes, x0="output")
    path = pack(tmp_path / "x.ssp", ssd(f"<ssd:Elements>{inside}</ssd:Elements>"), fmus=fmus)
    assert load(path, ["run.step=0.1"]).components["a"].kind == kind


def test_an_interface_that_the_fmu_lacks_is_refused(
    tmp_path: Path, strict: dict[str, Path]
) -> None:
    text = two().replace('source="strict.fmu"', 'source="strict.fmu" implementation="{}"')
    with pytest.raises(CosimError, match=r"[Mm]odel exchange|ModelExchange"):
        load(pack(tmp_path / "x.ssp", text.format("ModelExchange", "any"), fmus=strict))
    only = {"strict.fmu": export(exchange2(), tmp_path / "only.fmu")}
    text = text.replace('name="u"', 'name="x1"').replace('name="y"', 'name="x0"')
    with pytest.raises(ScenarioError, match="'CoSimulation', but the FMU has ModelExchange"):
        load(pack(tmp_path / "y.ssp", text.format("CoSimulation", "any"), fmus=only))
    assert load(pack(tmp_path / "z.ssp", text.format("any", "any"), fmus=only), ["run.step=0.1"])


def windows(path: Path, *, sources: bool) -> Path:
    """An FMU that has a binary for Windows only, and perhaps its source."""
    export(strict2(), path, sources=sources)
    with zipfile.ZipFile(path) as archive:
        kept = {n: archive.read(n) for n in archive.namelist() if "binaries" not in n}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in kept.items():
            archive.writestr(name, data)
        archive.writestr("binaries/win64/strict2.dll", b"MZ")
    return path


def test_an_fmu_for_windows_only_is_built_if_its_sources_are_inside(tmp_path: Path) -> None:
    gain = bindings(embedded({"gain": "3"}))
    path = pack(tmp_path / "x.ssp", two(gain), fmus={
        "strict.fmu": windows(tmp_path / "w.fmu", sources=True)})  # fmt: skip
    read = load(path, ["run.step=0.1", "components.a.start.u=1"])
    assert read.components["a"].build
    assert recorded(read)["a.y"][-1] == pytest.approx(1.0 + 3.0 * 0.5)


def test_an_fmu_for_windows_only_is_named_with_its_platforms(tmp_path: Path) -> None:
    fmus = {"strict.fmu": windows(tmp_path / "w.fmu", sources=False)}
    path = pack(tmp_path / "x.ssp", two(), fmus=fmus)
    result = CliRunner().invoke(app, ["run", str(path), "--set", "run.step=0.1"])
    assert "no binary for this platform" in str(result.exception)
    assert "platforms in the FMU: win64" in str(result.exception)


# ---- systems in files of their own --------------------------------------------------------------


def inner(version: str = "1.0") -> str:
    """The controller of the loop as a system with connectors of its own."""
    ports = "".join(connector(f"{p}[{i}]", k) for p, k in CONTROL.items() for i in (0, 1))
    wires = connect(".q", "pd.q") + connect(".dq", "pd.dq") + connect("pd.tau", ".tau")
    gains = bindings(embedded({"K_p[0]": "20", "K_p[1]": "7"}))
    return (
        f'<ssd:SystemStructureDescription {SPACES} version="{version}" name="inner">'
        f'<ssd:System name="whatever" id="control"><ssd:Connectors>{ports}</ssd:Connectors>'
        f"<ssd:Elements>{component('pd', 'pd', gains, **CONTROL)}</ssd:Elements>"
        f"{connections(wires)}</ssd:System></ssd:SystemStructureDescription>"
    )


def outside(source: str, kind: str) -> str:
    """The loop, its controller in a file of its own, and a gain of it set from outside."""
    gain = bindings(embedded({"pd.K_p[1]": "30"}))
    ports = {f"{p}[{i}]": k for p, k in CONTROL.items() for i in (0, 1)}
    made = part("control", source, gain, f'type="application/x-ssp-{kind}"', **ports)
    arm = component("arm", "planar2r", bindings(embedded(START)), **ARM)
    return ssd(f"<ssd:Elements>{arm}{made}</ssd:Elements>{connections(LOOP + BACK)}")


def test_a_component_is_a_description_of_its_own(tmp_path: Path) -> None:
    """Sources in it are relative to it (SSP 1.0, clause 4.5.2)."""
    path = pack(
        tmp_path / "x.ssp",
        outside("resources/parts/control.ssd", "definition"),
        {"resources/parts/control.ssd": inner()},
        {"resources/parts/resources/pd.fmu": FMUS["pd"]("2.0")},
    )
    assert_same(by_hand(), load(path), {"control": "control_pd"})


@pytest.mark.parametrize("variant", ["", "#other.ssd"])
def test_a_component_is_an_archive_of_its_own(tmp_path: Path, variant: str) -> None:
    fmus = {"resources/pd.fmu": FMUS["pd"]("2.0")}
    whole = tmp_path / "control.ssp"
    if variant:
        pack(whole, "<unused/>", {"other.ssd": inner()}, fmus)
    else:
        pack(whole, inner())
    path = pack(
        tmp_path / "x.ssp",
        outside(f"resources/control.ssp{variant}", "package"),
        fmus={"resources/control.ssp": whole},
    )
    assert_same(by_hand(), load(path), {"control": "control_pd"})


def test_a_component_is_another_system_of_the_same_description(tmp_path: Path) -> None:
    """The system with the id is one element, the component is a second one like it."""
    text = outside("#control", "definition")
    body = inner().split("<ssd:SystemStructureDescription")[1].split(">", 1)[1]
    system = body.removesuffix("</ssd:SystemStructureDescription>")
    text = text.replace("<ssd:Elements>", f"<ssd:Elements>{system}", 1)
    read = load(pack(tmp_path / "x.ssp", text))
    assert set(read.components) == {"arm", "control_pd", "whatever_pd"}
    assert_same(by_hand(), read, {"control": "control_pd"})
    assert read.components["whatever_pd"].parameters["K_p"] == [20.0, 7.0]


def test_a_description_that_contains_itself_is_refused(tmp_path: Path) -> None:
    text = outside("SystemStructure.ssd", "definition")
    with pytest.raises(ScenarioError, match=r"source 'SystemStructure\.ssd' contains itself"):
        load(pack(tmp_path / "x.ssp", text))
    with pytest.raises(ScenarioError, match="no system of this description has the id 'nobody'"):
        load(pack(tmp_path / "y.ssp", outside("#nobody", "definition")))


# ---- parameter sets, mappings, dictionaries -----------------------------------------------------


def test_values_that_belong_to_nobody_are_ignored_with_a_warning(tmp_path: Path) -> None:
    more = bindings(embedded({"K_q": "1", "K_p[0]": "20", "K_p[1]": "30"}))
    text = ssd(
        bindings(embedded({"leg.q": "1"})) + elements(control=more) + connections(LOOP + BACK)
    )
    path = pack(tmp_path / "x.ssp", text)
    assert_same(by_hand(), load(path))
    assert [sentence.split(" (")[0] for sentence in ignored(path)] == [
        "parameter 'leg.q' belongs to no element",
        "no variable of control 'K_q'",
    ]
    result = CliRunner().invoke(app, ["check", str(path)])
    assert "'leg.q' belongs to no element" in " ".join(result.output.split())


def test_a_mapping_that_nobody_has_filled_in_is_ignored_with_a_warning(tmp_path: Path) -> None:
    """As tools export templates of mappings: ``source=""``."""
    mapping = (
        f'<ssd:ParameterMapping><ssm:ParameterMapping {SPACES} version="1.0"><ssm:MappingEntry '
        'source="" target="control.K_q[0]"/><ssm:MappingEntry source="k" '
        'target="control.K_p[0]"/><ssm:MappingEntry source="k" target="control.K_p[1]">'
        '<ssc:LinearTransformation factor="1.5"/></ssm:MappingEntry>'
        "</ssm:ParameterMapping></ssd:ParameterMapping>"
    )
    text = ssd(bindings(embedded({"k": "20"}) + mapping) + elements() + connections(LOOP + BACK))
    path = pack(tmp_path / "x.ssp", text)
    assert_same(by_hand(), load(path))
    (said,) = ignored(path)
    assert said.startswith("the mapping of 'control.K_q[0]' has no source (")


def test_units_of_others_are_read_or_what_is_ignored_is_said(tmp_path: Path) -> None:
    """The gain K_p is in N.m/rad: in brackets, as another multiple, and as what nobody knows."""
    for unit, gain, many in (("[N.m/rad]", 20, 0), ("kN.m/rad", 0.02, 0), ("Nm/rad", 20, 2)):
        given = {f"K_p[{i}]": str(gain * (1, 1.5)[i]) for i in range(2)}
        more = bindings(embedded(given, unit=unit))
        text = ssd(elements(control=more) + connections(LOOP + BACK))
        path = pack(tmp_path / "x.ssp", text)
        assert_same(by_hand(), load(path))
        said = ignored(path)
        assert len(said) == many
        assert all("'Nm/rad' is not defined, so the number is taken as it is" in s for s in said)


def test_a_prefix_stands_before_the_names_that_a_mapping_maps(tmp_path: Path) -> None:
    """SSP 1.0, clause 4.5.1: prepended prior to the mapping rules."""
    mapping = (
        f'<ssd:ParameterMapping><ssm:ParameterMapping {SPACES} version="1.0"><ssm:MappingEntry '
        'source="set.k" target="control.K_p[0]"/><ssm:MappingEntry source="set.k" '
        'target="control.K_p[1]"><ssc:LinearTransformation factor="1.5"/></ssm:MappingEntry>'
        "</ssm:ParameterMapping></ssd:ParameterMapping>"
    )
    bound = bindings(embedded({"k": "20"}) + mapping, attributes=' prefix="set."')
    text = ssd(bound + elements() + connections(LOOP + BACK))
    assert_same(by_hand(), load(pack(tmp_path / "x.ssp", text)))


def test_a_parameter_set_may_be_inside_of_the_fmu(tmp_path: Path) -> None:
    path = export(strict2(), tmp_path / "strict.fmu")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/set.ssv", values({"gain": "3"}))
    bound = (
        '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/set.ssv" '
        'sourceBase="component"/></ssd:ParameterBindings>'
    )
    read = load(pack(tmp_path / "x.ssp", two(bound), fmus={"strict.fmu": path}), ["run.step=0.1"])
    assert read.components["a"].parameters == {"gain": 3.0}
    text = ssd(bound + f"<ssd:Elements>{part('a', 'strict.fmu', **IO)}</ssd:Elements>")
    with pytest.raises(ScenarioError, match="sourceBase is 'component'; expected SSD"):
        load(pack(tmp_path / "y.ssp", text, fmus={"strict.fmu": path}))


@pytest.mark.parametrize("kind", ["Float64", "Float32"])
def test_types_of_ssp_2(tmp_path: Path, strict: dict[str, Path], kind: str) -> None:
    text = two(
        bindings(embedded({"gain": "3"}, kind), embedded({"how": "2"}, "Int32")), version="2.0"
    )
    read = load(pack(tmp_path / "x.ssp", text, fmus=strict), ["run.step=0.1"])
    assert read.components["a"].parameters == {"gain": 3.0, "how": 2.0}


def test_dictionaries_are_looked_up_from_the_inside_out(
    tmp_path: Path, strict: dict[str, Path]
) -> None:
    """Two dictionaries of one name in two systems are two buses."""

    def box(name: str, own: bool) -> str:
        both = part("a", "strict.fmu", **IO) + part("b", "strict.fmu", **IO)
        bus = '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'
        declared = (
            '<ssd:SignalDictionaries><ssd:SignalDictionary name="d"/></ssd:SignalDictionaries>'
        )
        return (
            f'<ssd:System name="{name}"><ssd:Elements>{both}{bus}</ssd:Elements>'
            + connections(wire("a.y", "bus.s") + wire("bus.s", "b.u"))
            + (declared if own else "")
            + "</ssd:System>"
        )

    declared = '<ssd:SignalDictionaries><ssd:SignalDictionary name="d"/></ssd:SignalDictionaries>'
    text = ssd(f"<ssd:Elements>{box('one', True)}{box('two', False)}</ssd:Elements>{declared}")
    read = load(pack(tmp_path / "x.ssp", text, fmus=strict), ["run.step=0.1"])
    fed = {name: spec.inputs for name, spec in read.components.items() if spec.inputs}
    assert fed == {"one_b": {"u": "one_a.y"}, "two_b": {"u": "two_a.y"}}


# ---- transformations of connections -------------------------------------------------------------

MAPS = {
    "Boolean": ("flag", "up", {"true": "false", "false": "true"}, (-1.0, 1.0)),
    "Integer": ("count", "counted", {"0": "5", "1": "7", "2": "9"}, (2.0, 5.0)),
    "Enumeration": ("mode", "chosen", {"slow": "fast", "fast": "slow"}, (-1.0, 3.0)),
}


def mapped(tmp_path: Path, kind: str, entries: dict[str, str]) -> Path:
    given, name, *_ = MAPS[kind]
    inside = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in entries.items())
    tag = f"ssc:{kind}MappingTransformation"
    ports = {given: "input", name: "output"}
    both = part("a", "nasty.fmu", **ports) + part("b", "nasty.fmu", **ports)
    line = wire(f"a.{name}", f"b.{given}", f"<{tag}>{inside}</{tag}>")
    text = ssd(f"<ssd:Elements>{both}</ssd:Elements>{connections(line)}")
    return pack(tmp_path / "x.ssp", text, fmus={
        "nasty.fmu": export(nasty2(), tmp_path / "nasty.fmu")})  # fmt: skip


@pytest.mark.parametrize("kind", MAPS)
def test_a_mapping_of_a_connection_whose_points_are_on_a_line(tmp_path: Path, kind: str) -> None:
    given, _, entries, expected = MAPS[kind]
    read = load(mapped(tmp_path, kind, entries), ["run.step=0.1"])
    found = read.components["b"].inputs[given]
    assert (found.gain, found.offset) == expected  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("entries", "sentence"),
    [({"0": "5", "1": "7", "2": "8"}, "not on one line"), ({"0": "none"}, "is no value of")],
)
def test_another_mapping_of_a_connection_is_refused(
    tmp_path: Path, entries: dict[str, str], sentence: str
) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        load(mapped(tmp_path, "Integer", entries))


# ---- names --------------------------------------------------------------------------------------


def test_names_of_structures_and_single_entries_are_variables(tmp_path: Path) -> None:
    """``force[1].y`` and ``u[3]`` alone, as in the vessel models of OSP."""
    text = strict2().replace('name="y"', 'name="force[1].y"').replace('name="u"', 'name="u[3]"')
    fmus = {"strict.fmu": export(text, tmp_path / "strict.fmu")}
    both = "".join(
        part(name, "strict.fmu", **{"u[3]": "input", "force[1].y": "output"}) for name in "ab"
    )
    wires = connections(wire("a.force[1].y", "b.u[3]"))
    path = pack(tmp_path / "x.ssp", ssd(f"<ssd:Elements>{both}</ssd:Elements>{wires}"), fmus=fmus)
    settings = ["run.step=0.1", 'components.a.start."u[3]"=1']
    found = recorded(load(path, settings))
    assert found["b.u[3]"][-1] == found["a.force[1].y"][-2] > 1.0
    options = [x for setting in settings for x in ("--set", setting)]
    given = ["run", str(path), "--record", "all", "--out", str(tmp_path / "run"), *options]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "run" / "report.html").is_file()
    assert np.ptp(found["b.force[1].y"]) > 0.1


def test_a_local_variable_may_be_the_start_of_a_connection(
    tmp_path: Path, strict: dict[str, Path]
) -> None:
    """Kind ``local`` of SSP 2.0."""
    both = part("a", "strict.fmu", x="local") + part("b", "strict.fmu", **IO)
    text = ssd(f"<ssd:Elements>{both}</ssd:Elements>{connections(wire('a.x', 'b.u'))}", "2.0")
    found = recorded(load(pack(tmp_path / "x.ssp", text, fmus=strict), ["run.step=0.1"]))
    assert found["b.u"][1] == 1.0


def test_texts_are_connected(tmp_path: Path) -> None:
    fmus = {"strict.fmu": export(passing3(), tmp_path / "x.fmu")}
    ports = {"label": "input", "said": "output"}
    both = part("a", "strict.fmu", **ports) + part("b", "strict.fmu", **ports)
    text = ssd(
        f"<ssd:Elements>{both}</ssd:Elements>{connections(wire('a.said', 'b.label'))}", "2.0"
    )
    read = load(pack(tmp_path / "x.ssp", text, fmus=fmus), ["run.step=0.1"])
    assert read.components["b"].inputs == {"label": "a.said"}
    assemble(read)
    scaled = text.replace(
        "></ssd:Connection>", '><ssc:LinearTransformation factor="2"/></ssd:Connection>'
    )
    with pytest.raises(ScenarioError):
        assemble(load(pack(tmp_path / "y.ssp", scaled, fmus=fmus), ["run.step=0.1"]))


def test_the_longest_name_of_an_element_wins(tmp_path: Path, strict: dict[str, Path]) -> None:
    """``a.b.gain`` is of the element ``a.b``, though there is an ``a``."""
    both = part("a", "strict.fmu", **IO) + part("a.b", "strict.fmu", **IO)
    text = ssd(bindings(embedded({"a.b.gain": "3"})) + f"<ssd:Elements>{both}</ssd:Elements>")
    read = load(pack(tmp_path / "x.ssp", text, fmus=strict), ["run.step=0.1"])
    assert [spec.parameters for spec in read.components.values()] == [{}, {"gain": 3.0}]
