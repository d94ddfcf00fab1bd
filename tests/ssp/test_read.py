"""SSP as other tools write it, read as a scenario: the same run as the scenario written by hand."""

from __future__ import annotations

import contextlib
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.errors import CosimError, ScenarioError
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.ssp import load
from cosim.ssp.values import SspValue
from tests.ssp.parts import (
    SPACES,
    bindings,
    component,
    connect,
    connector,
    embedded,
    pack,
    recorded,
    ssd,
    values,
)

CONTROL = {"q": "input", "dq": "input", "tau": "output"}
ARM = {"q": "output", "dq": "output", "tau": "input"}
START = {"q[0]": "0.5", "q[1]": "-0.5"}
LOOP = connect("arm.q", "control.q") + connect("arm.dq", "control.dq")
BACK = connect("control.tau", "arm.tau")


def by_hand(**changes: object) -> Scenario:
    """The loop that the systems here are, as a scenario."""
    control = {
        "model": "fmus.models.pd",
        "parameters": {"K_p": [20.0, 30.0]},
        "inputs": {"q": "arm.q", "dq": "arm.dq"},
    }
    arm = {
        "model": "fmus.models.planar2r",
        "start": {"q": [0.5, -0.5]},
        "inputs": {"tau": "control.tau"},
    }
    run = {"step": 1e-3, "stop": 0.5, "algorithm": "jacobi"}
    components = {"arm": arm, "control": control | changes}
    return build({"run": run, "components": components}, Path("hand.toml"))


def elements(arm: str = "", control: str = "", control_kinds: dict[str, str] = CONTROL) -> str:
    """Arm and controller, with what is inside of each."""
    arm = component("arm", "planar2r", arm or bindings(embedded(START)), **ARM)
    control = component("control", "pd", control, **control_kinds)
    return f"<ssd:Elements>{arm}{control}</ssd:Elements>"


def connections(inside: str) -> str:
    return f"<ssd:Connections>{inside}</ssd:Connections>"


GAINS = bindings(embedded({"K_p[0]": "20", "K_p[1]": "30"}))


def assert_same(ours: Scenario, theirs: Scenario, names: dict[str, str] | None = None) -> None:
    """Equal to the bit, and something moved; `names`: of components, where they differ."""
    a, b = recorded(ours), recorded(theirs)
    assert np.ptp(a["arm.q[0]"]) > 0.1
    for name, values_ in a.items():
        first, port = name.split(".", 1)
        np.testing.assert_array_equal(values_, b[f"{(names or {}).get(first, first)}.{port}"])


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_a_flat_system_is_the_scenario_with_jacobi(tmp_path: Path, version: str) -> None:
    text = ssd(elements(control=GAINS) + connections(LOOP + BACK), version)
    read = load(pack(tmp_path / "flat.ssp", text))
    assert (read.run.algorithm, read.run.step, read.run.stop) == ("jacobi", 1e-3, 0.5)
    assert_same(by_hand(), read)


def test_start_and_end_of_a_connection_do_not_tell_its_direction(tmp_path: Path) -> None:
    turned = connect("control.q", "arm.q") + connect("control.dq", "arm.dq")
    turned += connect("arm.tau", "control.tau")
    text = ssd(elements(control=GAINS) + connections(turned))
    assert_same(by_hand(), load(pack(tmp_path / "turned.ssp", text)))


def test_systems_inside_systems_are_flattened(tmp_path: Path) -> None:
    pd = component("pd", "pd", GAINS, **CONTROL)
    ports = "".join(connector(f"{p}[{i}]", k) for p, k in CONTROL.items() for i in (0, 1))
    inner = connect(".q", "pd.q") + connect(".dq", "pd.dq") + connect("pd.tau", ".tau")
    outer = (
        f'<ssd:System name="control"><ssd:Connectors>{ports}</ssd:Connectors>'
        f"<ssd:Elements>{pd}</ssd:Elements>{connections(inner)}</ssd:System>"
    )
    arm = component("arm", "planar2r", bindings(embedded(START)), **ARM)
    text = ssd(f"<ssd:Elements>{arm}{outer}</ssd:Elements>" + connections(LOOP + BACK))
    assert_same(by_hand(), load(pack(tmp_path / "nested.ssp", text)), {"control": "control_pd"})


DICTIONARY = (
    '<ssd:SignalDictionaries><ssd:SignalDictionary name="motion" {}/></ssd:SignalDictionaries>'
)


def test_signals_of_a_dictionary_are_a_bus(tmp_path: Path) -> None:
    bus = '<ssd:SignalDictionaryReference name="bus" dictionary="motion"><ssd:Connectors/>'
    both = elements(control=GAINS).replace(
        "</ssd:Elements>", f"{bus}</ssd:SignalDictionaryReference></ssd:Elements>"
    )
    over = connect("arm.q", "bus.q") + connect("bus.q", "control.q")
    over += connect("arm.dq", "control.dq") + BACK
    inside = both + connections(over) + DICTIONARY.format('source="motion.ssb"')
    signals = {"motion.ssb": f'<ssb:SignalDictionary {SPACES} version="1.0"/>'}
    assert_same(by_hand(), load(pack(tmp_path / "bus.ssp", ssd(inside), signals)))
    with pytest.raises(ScenarioError, match=r"the archive holds no 'motion\.ssb'"):
        load(pack(tmp_path / "none.ssp", ssd(inside)))
    with pytest.raises(ScenarioError, match=r"no signal dictionary 'motion' \(there: none\)"):
        load(pack(tmp_path / "nameless.ssp", ssd(both + connections(over))))


def test_values_come_from_files_through_mappings_and_outer_ones_win(tmp_path: Path) -> None:
    mapping = (
        '<ssm:ParameterMapping xmlns:ssm="http://ssp-standard.org/SSP1/'
        'SystemStructureParameterMapping" xmlns:ssc="http://ssp-standard.org/SSP1/'
        'SystemStructureCommon" version="1.0"><ssm:MappingEntry source="soft" target="K_p[0]">'
        '<ssc:LinearTransformation factor="4" offset="-20"/></ssm:MappingEntry>'
        '<ssm:MappingEntry source="soft" target="K_p[1]"/></ssm:ParameterMapping>'
    )
    inside = (
        '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/gains.ssv">'
        '<ssd:ParameterMapping source="resources/gains.ssm"/></ssd:ParameterBinding>'
        "</ssd:ParameterBindings>"
    )
    outer = bindings(embedded({"K_p[1]": "30"}), attributes=' prefix="control."')
    text = ssd(outer + elements(control=inside) + connections(LOOP + BACK))
    gains = values({"soft": "10", "unused": "1"})
    files = {"resources/gains.ssv": gains, "resources/gains.ssm": mapping}
    path = pack(tmp_path / "files.ssp", text, files)
    assert_same(by_hand(), load(path))


def test_a_value_in_another_unit_is_converted(tmp_path: Path) -> None:
    start = bindings(embedded({"q[0]": "90", "q[1]": "-45"}, unit="deg"))
    text = ssd(elements(arm=start, control=GAINS) + connections(LOOP + BACK))
    read = load(pack(tmp_path / "units.ssp", text))
    np.testing.assert_allclose(
        read.components["arm"].parameters["q"], [np.pi / 2, -np.pi / 4], rtol=1e-15
    )


def test_a_linear_transformation_scales_a_connection(tmp_path: Path) -> None:
    scaled = '<ssc:LinearTransformation factor="2" offset="0.25"/>'
    inputs = {"dq": "arm.dq"} | {
        f"q[{i}]": {"from": f"arm.q[{i}]", "gain": 2.0, "offset": 0.25} for i in (0, 1)
    }
    lines = connect("arm.q", "control.q", scaled) + connect("arm.dq", "control.dq") + BACK
    text = ssd(elements(control=GAINS) + connections(lines))
    assert_same(by_hand(inputs=inputs), load(pack(tmp_path / "scaled.ssp", text)))


@given(st.lists(st.tuples(st.integers(-8, 8), st.integers(-8, 8)), max_size=6), st.integers(-9, 9))
def test_transformations_in_a_row_are_one(steps: list[tuple[int, int]], start: int) -> None:
    value, x = SspValue("Real", (str(start),), ""), start
    for factor, offset in steps:
        value, x = value.through(factor, offset, False), factor * x + offset
    assert value.factor * start + value.offset == x


def test_the_step_is_what_the_system_says_or_else_the_shortest_of_its_fmus(tmp_path: Path) -> None:
    inside = elements(control=GAINS) + connections(LOOP + BACK)
    master = '<ssd:SimulationInformation><ssd:FixedStepMaster stepSize="0.0025"/>'
    said = pack(tmp_path / "said.ssp", ssd(inside + master + "</ssd:SimulationInformation>"))
    assert load(said).run.step == 0.0025
    assert load(said, ["run.step='5 ms'", "components.control.period='10 ms'"]).run.step == "5 ms"
    assert load(pack(tmp_path / "fmus.ssp", ssd(inside))).run.step == 1e-3


WRONG = {
    "no connector": (LOOP + connect("arm.nothing", "control.q"), "no connector 'nothing[0]'"),
    "no element": (connect("leg.q", "control.q"), "no element 'leg'"),
    "two sources": (connect("arm.q", "control.tau"), "two sources or two sinks"),
    "fed twice": (LOOP + LOOP, "control.q[0] is fed by a second connection"),
    "no number": (
        connect("arm.q", "control.q", '<ssc:LinearTransformation factor="x"/>'),
        "factor is 'x'; expected a number",
    ),
    "an entry": (
        connect("arm.q", "control.q", attributes='startIndices="1"'),
        "startIndices, a connection of an entry of an array, is not supported",
    ),
}


@pytest.mark.parametrize(("inside", "sentence"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_with_a_connection_is_said_with_its_place(
    tmp_path: Path, inside: str, sentence: str
) -> None:
    path = pack(tmp_path / "wrong.ssp", ssd(elements() + connections(inside)))
    with pytest.raises(ScenarioError) as error:
        load(path)
    assert sentence in str(error.value)
    assert f"{path}:SystemStructure.ssd at /System[@name='root']/Connections/" in str(error.value)


def test_suppressed_unit_conversion_leaves_the_number_as_it_is(tmp_path: Path) -> None:
    plain = '<ssc:LinearTransformation factor="3"/>'
    lines = connect("arm.q", "control.q", plain, 'suppressUnitConversion="true"')
    text = ssd(elements(control=GAINS) + connections(lines + connect("arm.dq", "control.dq")))
    wires = load(pack(tmp_path / "suppressed.ssp", text)).components["control"].inputs
    assert [getattr(wires[f"q[{i}]"], "gain", None) for i in (0, 1)] == [3.0, 3.0]


BROKEN = {
    "no system": ("<ssd:SystemStructureDescription xmlns:ssd='x'/>", "no <System>"),
    "not XML": ("<ssd", "not well-formed XML"),
    "another root": ("<a/>", "found <a>, expected <SystemStructureDescription>"),
    "version": (ssd(elements(), "3.0"), "version is '3.0'; expected 1.0 or 2.0"),
    "no FMU": (ssd(elements()).replace("pd.fmu", "dp.fmu"), "holds no 'resources/dp.fmu'"),
    "outside": (ssd(elements()).replace("resources/pd", "../pd"), "leads out of the archive"),
    "elsewhere": (
        ssd(elements()).replace("resources/pd", "http://a/pd"),
        "is not in the archive; expected a path in it",
    ),
    "unit": (
        ssd(elements(arm=bindings(embedded({"q[0]": "1"}, unit="m")))),
        "arm.q: [",
    ),
    "no value": (ssd(elements(arm=bindings(embedded({"q[0]": "x"})))), "'x' is no value of arm.q"),
    "kind of part": (
        ssd(elements()).replace("application/x-fmu-sharedlibrary", "text/x-modelica", 1),
        "of type 'text/x-modelica' is not supported",
    ),
}


@pytest.mark.parametrize(("text", "sentence"), BROKEN.values(), ids=BROKEN)
def test_a_system_that_cannot_be_is_refused_in_a_sentence(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = pack(tmp_path / "broken.ssp", text)
    with pytest.raises(ScenarioError) as error:
        load(path)
    assert sentence in str(error.value)
    assert str(error.value).startswith(str(path))


WHOLE = ssd(
    bindings(embedded({"control.K_p[0]": "30"}))
    + elements(control=GAINS)
    + connections(LOOP + BACK)
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_description_with_anything_wrong_is_read_or_refused(
    tmp_path: Path, data: st.DataObject
) -> None:
    words = re.findall(r"[\w/.\[\]:-]+", WHOLE)
    changed = WHOLE.replace(
        data.draw(st.sampled_from(words)),
        data.draw(
            st.sampled_from(["", "x", "-1", "nan", "1e999", "q[9]", "arm", "input", "<", "é"])
        ),
        data.draw(st.integers(1, 3)),
    )
    with contextlib.suppress(CosimError):
        assemble(load(pack(tmp_path / "changed.ssp", changed)))


def test_what_is_no_archive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.ssp"
    with pytest.raises(ScenarioError, match="no such file"):
        load(path)
    path.write_bytes(b"PK nothing")
    with pytest.raises(ScenarioError, match="not a readable SSP"):
        load(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", "<a/>")
        archive.writestr("../evil", "")
    with pytest.raises(ScenarioError, match="outside the folder"):
        load(path)


def test_a_step_that_nobody_says_is_asked_for(tmp_path: Path) -> None:
    text = ssd(elements(control=GAINS) + connections(LOOP + BACK)).replace('stopTime="0.5"', "")
    with pytest.raises(ScenarioError, match=r"does not say stop; say --set run\.stop="):
        load(pack(tmp_path / "endless.ssp", text))


def test_a_description_outside_of_its_archive_is_named(tmp_path: Path) -> None:
    from cosim.loading.files import load as load_any

    (tmp_path / "SystemStructure.ssd").write_text(WHOLE)
    with pytest.raises(ScenarioError, match="is a description inside of an SSP, not a scenario"):
        load_any(tmp_path / "SystemStructure.ssd")
