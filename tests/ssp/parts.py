"""Systems written by hand, the way other tools write them, around FMUs of this project."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario
from fmus.models import pd, planar2r, xi

SPACES = " ".join(
    f'xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{long}"'
    for short, long in (
        ("ssd", "Description"),
        ("ssc", "Common"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
        ("ssb", "SignalDictionary"),
    )
)
FMUS = {"pd": pd.fmu, "planar2r": planar2r.fmu, "xi": xi.fmu}


def ssd(system: str, version: str = "1.0", rest: str = "") -> str:
    """A description around the inside of its system."""
    return (
        f'<?xml version="1.0"?><ssd:SystemStructureDescription {SPACES} version="{version}" '
        f'name="hand"><ssd:System name="root">{system}</ssd:System>'
        f'<ssd:DefaultExperiment startTime="0" stopTime="0.5"/>{rest}'
        "</ssd:SystemStructureDescription>"
    )


def component(name: str, fmu: str, inside: str = "", **kinds: str) -> str:
    """A component; `kinds`: the entries of each two-vector are connectors of this kind."""
    connectors = "".join(connector(f"{port}[{i}]", kinds[port]) for port in kinds for i in (0, 1))
    return (
        f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" '
        f'source="resources/{fmu}.fmu"><ssd:Connectors>{connectors}</ssd:Connectors>{inside}'
        "</ssd:Component>"
    )


def connector(name: str, kind: str) -> str:
    """A real connector."""
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real/></ssd:Connector>'


def connect(start: str, end: str, inside: str = "", attributes: str = "") -> str:
    """Connections of both entries of ``element.port``, ``.port`` being the system's own."""
    found = ""
    for i in (0, 1):
        ends = ""
        for which, text in (("start", start), ("end", end)):
            element, _, port = text.partition(".")
            ends += f'{which}Element="{element}" ' if element else ""
            ends += f'{which}Connector="{port}[{i}]" '
        found += f"<ssd:Connection {ends}{attributes}>{inside}</ssd:Connection>"
    return found


def values(parameters: dict[str, str], kind: str = "Real", unit: str = "") -> str:
    """A parameter set."""
    unit = f' unit="{unit}"' if unit else ""
    inside = "".join(
        f'<ssv:Parameter name="{k}"><ssv:{kind} value="{v}"{unit}/></ssv:Parameter>'
        for k, v in parameters.items()
    )
    return (
        f'<ssv:ParameterSet {SPACES} version="1.0" name="set"><ssv:Parameters>{inside}'
        "</ssv:Parameters></ssv:ParameterSet>"
    )


def bindings(*inside: str, attributes: str = "") -> str:
    """Parameter bindings with what is inside of each."""
    each = "".join(f"<ssd:ParameterBinding{attributes}>{x}</ssd:ParameterBinding>" for x in inside)
    return f"<ssd:ParameterBindings>{each}</ssd:ParameterBindings>"


def embedded(parameters: dict[str, str], kind: str = "Real", unit: str = "") -> str:
    """A set inside of a binding."""
    return f"<ssd:ParameterValues>{values(parameters, kind, unit)}</ssd:ParameterValues>"


def part(name: str, source: str, inside: str = "", attributes: str = "", **kinds: str) -> str:
    """A component of any source; `kinds`: the kinds of its scalar connectors."""
    connectors = "".join(connector(port, kind) for port, kind in kinds.items())
    return (
        f'<ssd:Component name="{name}" source="{source}" {attributes}>'
        f"<ssd:Connectors>{connectors}</ssd:Connectors>{inside}</ssd:Component>"
    )


def wire(start: str, end: str, inside: str = "", attributes: str = "") -> str:
    """A connection of one connector, ``element.name``, with another."""
    (a, x), (b, y) = start.split(".", 1), end.split(".", 1)
    ends = f'startConnector="{x}" endConnector="{y}" '
    ends += (f'startElement="{a}" ' if a else "") + (f'endElement="{b}" ' if b else "")
    return f"<ssd:Connection {ends}{attributes}>{inside}</ssd:Connection>"


def pack(
    path: Path,
    description: str,
    files: Mapping[str, str] | None = None,
    fmus: Mapping[str, Path] | None = None,
) -> Path:
    """Write an SSP with the FMUs of :data:`FMUS` that it names, other `fmus`, and `files`."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", description)
        for name, fmu in FMUS.items():
            if f"resources/{name}.fmu" in description:
                archive.write(fmu("2.0"), f"resources/{name}.fmu")
        for name, text in (files or {}).items():
            archive.writestr(name, text)
        for name, fmu in (fmus or {}).items():
            archive.write(fmu, name)
    return path


def recorded(scenario: Scenario) -> dict[str, np.ndarray]:
    """Every signal of a run, (ticks + 1,), by the name of the scalar."""
    plan = assemble(scenario)
    with Engine(plan) as engine:
        engine.initialize()
        rows = np.empty((plan.ticks + 1, plan.n_signals))
        engine.run(plan.ticks, rows)
        rows[-1] = engine.signals
    return {
        name: rows[:, slot.start + i]
        for slot in plan.slots().values()
        for i, name in enumerate(slot.scalars())
    }
