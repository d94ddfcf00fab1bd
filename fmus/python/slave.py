"""``fmus build my_module:MyController``: an FMU 2.0 of a Python component, by PythonFMU.

The FMU is a wrapper (tool coupling) around Python. The machine that runs it needs Python of the
same minor version with this project and NumPy, and the importer must be a Python process or have
loaded libpython. A step costs some microseconds. Such an FMU cannot save its state. For other
requirements write the law in C (``fmus build path/to/model.py``).
"""

from __future__ import annotations

import importlib
import inspect
import tempfile
import zipfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cosim.base.component import Component, Parameter, Port
from cosim.base.errors import CosimError, FmuError, ScenarioError
from cosim.base.files import written_aside
from cosim.base.units import BASE, parse
from fmus.model import annotation

#: The script inside the FMU: what PythonFMU calls, and the component behind it.
_SCRIPT = '''\
import numpy as np
from pythonfmu import Boolean, Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Integer, Real

from {module} import {attribute} as make

TYPES = {{"real": Real, "integer": Integer, "boolean": Boolean}}


class {name}(Fmi2Slave):
    """The component as a slave: calculated at the start when somebody asks, then by steps."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.component = make()
        self.given, self.u, self.y, self.stepped = {{}}, {{}}, None, False
        for port in self.component.inputs:
            self.u[port.name] = np.array(port.default or (0.0,) * port.size).reshape(port.shape)
            self.declare(port, self.u[port.name], Fmi2Causality.input, "real")
        for p in self.component.parameters:
            self.given[p.name] = np.array(p.default, dtype=float).reshape(p.shape)
            self.declare(p, self.given[p.name], Fmi2Causality.parameter, p.type)
        for port in self.component.outputs:
            self.declare(port, None, Fmi2Causality.output, "real")

    def declare(self, port, held, causality, type_):
        for at in np.ndindex(port.shape):
            name = port.name + (f"[{{','.join(map(str, at))}}]" if at else "")
            fixed = causality == Fmi2Causality.parameter
            real = "continuous" if self.component.kind == "continuous" else "discrete"
            self.register_variable(
                TYPES[type_](
                    name,
                    causality=causality,
                    variability=Fmi2Variability["fixed" if fixed else real],
                    initial=Fmi2Initial.exact if fixed else (
                        Fmi2Initial.calculated if held is None else None
                    ),
                    description=port.description or None,
                    getter=self.getter(port, held, at, type_),
                    setter=None if held is None else self.setter(held, at),
                ),
                nested=False,
            )

    def getter(self, port, held, at, type_):
        cast = {{"real": float, "integer": int, "boolean": bool}}[type_]

        def get():
            if held is not None:
                return cast(held[at])
            return cast(np.reshape(self.outputs()[port.name], port.shape)[at])

        return get

    def setter(self, held, at):
        def set_(value):
            held[at] = value
            if not self.stepped:
                self.y = None

        return set_

    def outputs(self):
        if self.y is None:
            self.component.initialize({{k: v.copy() for k, v in self.given.items()}})
            self.y = dict(self.component.initial(self.u))
        return self.y

    def do_step(self, current_time, step_size):
        if not self.stepped:
            self.outputs()
            self.stepped = True
        self.y = dict(self.component.step(current_time, step_size, self.u))
        return True
'''


def build_class(text: str, out_dir: Path) -> Path:
    """Build ``out_dir/<class>.fmu`` of the component ``module:attribute``; returns its path.

    The module's file goes into the FMU. Raises ScenarioError for what is no component, FmuError
    where PythonFMU is not installed or fails.
    """
    module, _, attribute = text.partition(":")
    component, source = _component(module, attribute, text)
    try:
        builder = importlib.import_module("pythonfmu.builder").FmuBuilder
    except ImportError:
        raise FmuError(
            "an FMU of a Python class needs PythonFMU: pip install pythonfmu; or write the law in "
            "C and build that (docs/own-component.md)"
        ) from None
    with tempfile.TemporaryDirectory(prefix="slave-") as scratch:
        script = Path(scratch) / f"{attribute}_slave.py"
        script.write_text(_SCRIPT.format(module=module, attribute=attribute, name=attribute))
        project = {source} if "." not in module else set()
        try:
            made = builder.build_FMU(
                script,
                dest=Path(scratch) / "made.fmu",
                project_files=project,
                needsExecutionTool=True,
            )
        except Exception as error:  # the tool's own kinds, and whatever the class raises
            raise FmuError(f"{text}: PythonFMU failed: {error}") from error
        return _completed(Path(made), component, out_dir / f"{attribute}.fmu")


def _component(module: str, attribute: str, text: str) -> tuple[Component, Path]:
    """The component, made once to look at, and its file."""
    if not module or not attribute.isidentifier():
        raise ScenarioError(f"{text!r} is not a component; expected module:Class")
    try:
        found = importlib.import_module(module)
        make = vars(found)[attribute]
        component: Component = make()
        ports = (*component.inputs, *component.outputs, *component.parameters)
    except KeyError:
        raise ScenarioError(f"module {module!r} has no {attribute!r}") from None
    except (ImportError, TypeError, AttributeError, CosimError) as error:
        raise ScenarioError(f"{text} is not a component: {error}") from None
    for port in ports:
        if not isinstance(port, Port | Parameter):
            raise ScenarioError(f"{text}: {port!r} is neither a Port nor a Parameter")
    return component, Path(inspect.getfile(found)).resolve()


# ---- what PythonFMU does not write ----------------------------------------------------------


def _completed(made: Path, component: Component, out: Path) -> Path:
    """The same FMU with units, initial unknowns and the kind of the component."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with (
            zipfile.ZipFile(made) as old,
            written_aside(out) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as new,
        ):
            for name in old.namelist():
                data = old.read(name)
                if name == "modelDescription.xml":
                    data = _described(data, component)
                new.writestr(name, data)
    except OSError as error:
        raise FmuError(f"{out}: cannot be written: {error.strerror}") from None
    return out


def _described(data: bytes, component: Component) -> bytes:
    root = ElementTree.fromstring(data)
    used = dict(_units(component))
    for variable in root.iterfind("ModelVariables/ScalarVariable"):
        real, unit = variable.find("Real"), used.get(variable.get("name", ""), "1")
        if real is not None and unit != "1":
            real.set("unit", unit)
    root.insert(0, _definitions(sorted(set(used.values()) - {"1"})))
    interface = root.find("CoSimulation")
    if interface is not None:  # the schema wants it first
        root.remove(interface)
        root.insert(0, interface)
    structure = root.find("ModelStructure")
    outputs = None if structure is None else structure.find("Outputs")
    if structure is not None and outputs is not None:
        unknowns = SubElement(structure, "InitialUnknowns")
        for unknown in outputs:
            SubElement(unknowns, "Unknown", index=unknown.get("index", ""))
    vendor = Element("VendorAnnotations")
    tool = SubElement(vendor, "Tool", name="cosim fmus")
    SubElement(tool, "Component", annotation(component.kind, component.inputs))
    at = [child.tag for child in root].index("ModelVariables")
    root.insert(at, vendor)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def _units(component: Component) -> Iterator[tuple[str, str]]:
    """(name of a scalar, unit) of everything declared."""
    declared: tuple[Any, ...] = (*component.inputs, *component.outputs, *component.parameters)
    for port in declared:
        for at in product(*map(range, port.shape)):
            yield port.name + (f"[{','.join(map(str, at))}]" if at else ""), port.unit


def _definitions(names: list[str]) -> Element:
    definitions = Element("UnitDefinitions")
    for name in names:
        unit = parse(name)
        base = SubElement(SubElement(definitions, "Unit", name=name), "BaseUnit")
        for symbol, exponent in zip(BASE, unit.exponents, strict=True):
            if exponent:
                base.set(symbol, str(exponent))
        base.set("factor", repr(unit.factor))
        base.set("offset", repr(unit.offset))
    return definitions
