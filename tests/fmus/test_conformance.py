"""The FMUs against the standard: schemas, rules, headers, exported names, true dependencies."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from cosim.base.units import BASE, parse
from cosim.fmi.component import FmuComponent
from fmus.build.archive import Version, find, shipped_models, toolchain
from fmus.build.kernel import library
from fmus.build.source import token
from fmus.model import Model, Variable
from fmus.models import planar2r

FMPY = Path(fmpy.__file__).parent
SCHEMAS, HEADERS = FMPY / "schema" / "fmi3", FMPY / "c-code"
OURS = Path(toolchain.__file__).parents[1] / "c"
VERSIONS: tuple[Version, ...] = ("2.0", "3.0")
BOTH = [
    pytest.param(model, version, id=f"{model.identifier}-{version}")
    for model in shipped_models()
    for version in VERSIONS
]


def described(model: Model, version: Version) -> ElementTree.Element:
    with ZipFile(find(model, version)) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


# --- schemas and rules -----------------------------------------------------------------------


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_fmpy_finds_no_problem(model: Model, version: Version) -> None:
    assert validate_fmu(str(find(model, version))) == []


@pytest.mark.parametrize(
    ("name", "schema"),
    [
        ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
        ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
    ],
)
@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
def test_the_other_files_fit_their_schemas(model: Model, name: str, schema: str) -> None:
    with ZipFile(find(model, "3.0")) as archive:
        document = etree.fromstring(archive.read(name))
    etree.XMLSchema(etree.parse(str(SCHEMAS / schema))).assertValid(document)


@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
def test_terminals_name_variables_that_are_there(model: Model) -> None:
    names = {
        element.get("name") for element in described(model, "3.0").iterfind("ModelVariables/*")
    }
    with ZipFile(find(model, "3.0")) as archive:
        root = ElementTree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
    members = [element.get("variableName") for element in root.iter("TerminalMemberVariable")]
    assert members
    assert set(members) <= names


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_every_variable_has_a_description_a_unit_and_a_place_of_its_own(
    model: Model, version: Version
) -> None:
    variables = list(described(model, version).iterfind("ModelVariables/*"))
    names = [v.get("name") for v in variables]
    references = [int(v.get("valueReference", "-1")) for v in variables]
    assert len(set(names)) == len(names)
    assert references == list(range(len(variables)))
    for v in variables:
        assert v.get("description"), v.get("name")
        typed = v[0] if version == "2.0" else v
        assert typed.get("unit") or typed.tag in ("Integer", "Int32"), v.get("name")


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_units_are_what_the_runner_takes_them_for(model: Model, version: Version) -> None:
    for unit in described(model, version).iterfind("UnitDefinitions/Unit"):
        base, expected = unit[0], parse(unit.get("name", ""))
        assert tuple(int(base.get(name, "0")) for name in BASE) == expected.exponents
        assert float(base.get("factor", "1")) == expected.factor


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_the_runner_reads_back_what_was_declared(model: Model, version: Version) -> None:
    component = FmuComponent(find(model, version))
    assert component.kind == model.kind
    for found, declared in (
        (component.inputs, model.inputs()),
        (component.outputs, model.outputs()),
        (component.parameters, model.parameters()),
    ):
        there = {port.name: (port.shape, port.unit) for port in found}
        assert there == {port.name: (port.shape, port.unit) for port in declared}
    defaults = {p.name: p.default for p in component.parameters}
    assert defaults == {p.name: p.default for p in model.parameters()}


@pytest.mark.parametrize("version", VERSIONS)
def test_capabilities_are_those_of_the_library(version: Version) -> None:
    flags = described(planar2r.model(), version).find("CoSimulation")
    assert flags is not None
    suffix = "FMUstate" if version == "2.0" else "FMUState"
    for name in (f"canGetAndSet{suffix}", f"canSerialize{suffix}"):
        assert flags.get(name) == "true"
    for name in ("providesDirectionalDerivative", "hasEventMode", "canRunAsynchronuously"):
        assert flags.get(name, "false") == "false"


# --- headers and exported names --------------------------------------------------------------


def test_our_declarations_are_the_standards(tmp_path: Path) -> None:
    """Every function is declared again with the official types: another signature is an error."""
    (tmp_path / "check.c").write_text(
        '#include "fmi2Functions.h"\n#include "fmi3Functions.h"\n'
        "#define FMI2_TYPES_H\n#define FMI3_TYPES_H\n"
        '#include "fmi2.h"\n#include "fmi3.h"\n'
    )
    output = tmp_path / f"check{toolchain.shared_suffix()}"
    flags = ["-Werror", "-Wno-attributes", "-fvisibility=default"]
    toolchain.compile_shared([tmp_path / "check.c"], output, include=[HEADERS, OURS], flags=flags)


@pytest.mark.parametrize("version", ["2", "3"])
def test_our_types_are_the_standards(version: str, tmp_path: Path) -> None:
    """Sizes and numbers of each type and constant, printed with either header."""
    official = "".join(path.read_text() for path in HEADERS.glob(f"fmi{version}*Types*.h"))
    official = re.sub(r"/\*.*?\*/", "", official, flags=re.S)
    types = sorted(set(re.findall(rf"\b(fmi{version}\w+)\s*;", official)))
    types = [name for name in types if not name.endswith("TYPE")]
    constants = sorted(
        {
            name
            for body in re.findall(r"enum\s*{(.*?)}", official, flags=re.S)
            for name in re.findall(r"\w+", body)
        }
    )
    assert len(types) > 10
    assert len(constants) > 10
    entries = [f"sizeof({name})" for name in types]
    entries += [f"(unsigned long)({name})" for name in constants]
    numbers = []
    for kind, header in (("ours", f"fmi{version}_types.h"), ("official", OFFICIAL[version])):
        source = tmp_path / f"{kind}.c"
        source.write_text(
            f'#include "export.h"\n#include "{header}"\n'
            f"EXPORT const unsigned long values[] = {{{', '.join(entries)}}};\n"
        )
        output = tmp_path / f"{kind}{toolchain.shared_suffix()}"
        toolchain.compile_shared([source], output, include=[OURS, HEADERS])
        array = (ctypes.c_ulong * len(entries)).in_dll(ctypes.CDLL(str(output)), "values")
        numbers.append(dict(zip(entries, array, strict=True)))
    assert numbers[0] == numbers[1]


OFFICIAL = {"2": "fmi2FunctionTypes.h", "3": "fmi3FunctionTypes.h"}


def official_functions(version: str) -> list[str]:
    text = (HEADERS / f"fmi{version}FunctionTypes.h").read_text()
    return sorted(set(re.findall(rf"\b(fmi{version}\w+)TYPE\b", text)))


@pytest.mark.parametrize("version", ["2", "3"])
def test_every_function_of_the_standard_is_exported(version: str) -> None:
    loaded = ctypes.CDLL(str(library(planar2r.model())))
    names = official_functions(version)
    assert len(names) > 40
    missing = [name for name in names if not hasattr(loaded, name)]
    assert missing == []


def test_nothing_else_is_visible() -> None:
    loaded = ctypes.CDLL(str(library(planar2r.model())))
    hidden = "instance_new do_step model_step model_initial sine_cosine variables state_save"
    assert [name for name in hidden.split() if hasattr(loaded, name)] == []


# --- the page inside -------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_the_documentation_holds_equations_and_variables(model: Model, version: Version) -> None:
    with ZipFile(find(model, version)) as archive:
        page = archive.read("documentation/index.html").decode()
        licence = archive.read("documentation/licenses/license.txt").decode()
    assert "::" in page
    for v in model.variables:
        assert f"<td>{v.name}</td>" in page
    assert "Apache-2.0" in licence
    root = described(model, version)
    assert root.get("guid" if version == "2.0" else "instantiationToken") == token(model)


def test_a_variable_of_each_type_can_be_declared(drive: Any, tmp_path: Path) -> None:
    """No shipped model has a boolean: one made up here, through XML, C and both APIs."""
    source = tmp_path / "switch.c"
    source.write_text(
        '#include <stddef.h>\n#include "model.h"\n'
        "const char *model_initial(Model *x) { x->y = x->on ? x->n : -x->n; return NULL; }\n"
        "const char *model_step(Model *x, double t, double h) {\n"
        "    (void)t, (void)h;\n    return model_initial(x);\n}\n"
    )
    model = Model(
        "switch_",
        "A switch",
        "sampled",
        (
            Variable("on", "parameter", type="boolean", start=1.0, description="Whether"),
            Variable("n", "parameter", type="integer", start=3.0, description="How much"),
            Variable("y", "output", description="n or -n", start_depends=("on", "n")),
        ),
        (str(source),),
    )
    for version in VERSIONS:
        assert validate_fmu(str(find(model, version))) == []
        d = drive(model, version)
        kind, size = (
            (ctypes.c_int, []) if version == "2.0" else (ctypes.c_bool, [ctypes.c_size_t(1)])
        )
        one, value = (ctypes.c_uint32 * 1)(0), (kind * 1)(0)
        d.go_to("initialization")
        assert d.get("y") == [3.0]
        assert d("GetBoolean", one, ctypes.c_size_t(1), value, *size) == 0
        assert value[0] == 1
        assert d("SetBoolean", one, ctypes.c_size_t(1), (kind * 1)(0), *size) == 0
        assert d.get("y") == [-3.0]
        assert d.leave() == 0
        assert d.step(0.0, 1.0) == 0
