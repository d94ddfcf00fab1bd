"""FMUs with CAN terminals of FMI-LS-BUS 1.0: what a simulated bus and a network FMU share.

Their functions of FMI are ``fmus/c/lsbus``; behind these is a core, which each kind of FMU has.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import cosim
from fmus.build.archive import licences
from fmus.build.description import xml_text
from fmus.build.toolchain import (
    FLAGS,
    compile_object,
    host_platform,
    link_shared,
    processes,
    shared_suffix,
)
from fmus.model import Model, Variable
from fmus.model.attributes import units

MEMBERS = ("Tx_Clock", "Rx_Clock", "Tx_Data", "Rx_Data")
_MIME = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
_KIND = "org.fmi-ls-bus.network-terminal"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
#: Fixed by the schema of the layered standard.
_ABOUT = (
    "Layered Standard for the simulation of bus communication on a Physical Signal Abstraction or"
    " Network Abstraction based level."
)
_HERE = Path(__file__).parents[1] / "c"
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
_HEADERS = ("export.h", "fmi3.h", "fmi3_types.h")


@dataclass(frozen=True, slots=True)
class SignalOutput:
    """A Float64 output: `unit` as in the description of an FMU, `shape` of an array."""

    name: str
    shape: tuple[int, ...]
    unit: str

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)


@dataclass(frozen=True, slots=True)
class LsBusFmu:
    """The description of an FMU with CAN terminals.

    Value references: terminal n has 4 n + 1 to 4 n + 4, in the order of :data:`MEMBERS`; the next
    one is the time, and `outputs` follow. `bus`: it is a Bus Simulation FMU, which sends
    notifications; its constant ``BusNotifications`` has the reference 0.
    """

    name: str
    identifier: str
    description: str
    token: str
    terminals: tuple[str, ...]
    outputs: tuple[SignalOutput, ...] = ()
    bus: bool = False

    @property
    def time(self) -> int:
        """The value reference of the time."""
        return 4 * len(self.terminals) + 1

    def variables(self) -> Iterator[tuple[str, int, str]]:
        """(terminal, value reference, member) of every variable of a terminal."""
        for n, terminal in enumerate(self.terminals):
            for k, member in enumerate(MEMBERS):
                yield terminal, 4 * n + k + 1, member


def shell_sources() -> dict[str, str]:
    """The C files of every such FMU, by name: functions of FMI, and the header of a core."""
    files = [*(_HERE / "lsbus").glob("*.[ch]"), *(_HERE / name for name in _HEADERS)]
    return {file.name: file.read_text(encoding="utf-8") for file in files}


def token_of(sources: Mapping[str, str]) -> str:
    """The instantiation token of an FMU made of these sources."""
    joined = "".join(f"{name}\0{text}\0" for name, text in sorted(sources.items()))
    return "{" + hashlib.sha256(joined.encode()).hexdigest()[:32] + "}"


def units_of(sources: Mapping[str, str]) -> list[str]:
    """The C files that are compiled, sorted: those in folders are included by others."""
    return sorted(name for name in sources if name.endswith(".c") and "/" not in name)


def binaries(
    identifier: str,
    sources: Mapping[str, str],
    platforms: Sequence[str] | None = None,
    objects: Path | None = None,
) -> dict[str, bytes]:
    """The library for each platform (default: the host's), by its name in the archive.

    `objects`: a folder in which FMUs that have sources in common share what is compiled. Raises
    fmus.build.toolchain.ToolchainError from the compiler.
    """
    found = {}
    with tempfile.TemporaryDirectory(prefix="lsbus-fmu-") as scratch, processes() as pool:
        folder = objects or Path(scratch)
        for platform in platforms or (host_platform(),):
            name = f"{identifier}{shared_suffix(platform)}"
            jobs = [
                pool.submit(_object, _unit(sources, unit), folder / platform, platform)
                for unit in units_of(sources)
            ]
            made = [job.result() for job in jobs]
            library = link_shared(made, Path(scratch) / name, platform=platform)
            found[f"binaries/{platform}/{name}"] = library.read_bytes()
    return found


def _unit(sources: Mapping[str, str], name: str) -> dict[str, str]:
    """The text of a C file and of all that it includes, by name, itself first."""
    found: dict[str, str] = {}
    left = [name]
    while left:
        here = left.pop()
        if here in sources and here not in found:
            found[here] = sources[here]
            beside = here.rpartition("/")[0]
            for other in _INCLUDE.findall(sources[here]):
                near = f"{beside}/{other}" if beside else other
                left.append(near if near in sources else other)
    return found


def _object(unit: Mapping[str, str], folder: Path, platform: str) -> Path:
    """The object of a C file, compiled unless it is there."""
    digest = hashlib.sha256("".join(f"{k}\0{v}\0" for k, v in unit.items()).encode()).hexdigest()
    place = folder / digest
    source = place / next(iter(unit))
    output = source.with_suffix(".o")
    if not output.is_file():
        for name, text in unit.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_text(text, encoding="utf-8", newline="\n")
        compile_object(source, output, include=[place], platform=platform)
    return output


def entries(fmu: LsBusFmu, sources: Mapping[str, str]) -> dict[str, str]:
    """All texts of the archive: descriptions, manifest, sources, licences."""
    build = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(build, "BuildConfiguration", modelIdentifier=fmu.identifier)
    files = SubElement(
        configuration, "SourceFileSet", language="C99", compilerOptions=" ".join(FLAGS)
    )
    for name in units_of(sources):
        SubElement(files, "SourceFile", name=name)
    return {
        "modelDescription.xml": xml_text(_description(fmu)),
        "terminalsAndIcons/terminalsAndIcons.xml": xml_text(_terminals(fmu)),
        "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml": xml_text(_manifest(fmu)),
        "sources/buildDescription.xml": xml_text(build),
        **{f"sources/{name}": text for name, text in sources.items()},
        **licences("3.0"),
    }


def _description(fmu: LsBusFmu) -> Element:
    root = Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=fmu.name,
        description=fmu.description,
        version=cosim.__version__,
        license="Apache-2.0",
        instantiationToken=fmu.token,
        generationTool=f"cosim-bridge {cosim.__version__}",
    )
    SubElement(
        root,
        "CoSimulation",
        modelIdentifier=fmu.identifier,
        canHandleVariableCommunicationStepSize="true",
        hasEventMode="true",
    )
    if fmu.outputs:
        units(root, _as_model(fmu))
    SubElement(SubElement(root, "LogCategories"), "Category", name="logStatusError")
    listed = SubElement(root, "ModelVariables")
    given = _values(listed, fmu)
    for terminal, reference, member in fmu.variables():
        _variable(listed, f"{terminal}.{member}", reference, member)
        given += [reference] if member == "Tx_Data" else []
    structure = SubElement(root, "ModelStructure")
    for reference in given:
        SubElement(structure, "Output", valueReference=str(reference))
    for n in range(len(fmu.outputs)):
        SubElement(structure, "InitialUnknown", valueReference=str(fmu.time + 1 + n))
    return root


def _as_model(fmu: LsBusFmu) -> Model:
    """Its outputs as those of a model, for the table of units."""
    variables = (Variable(o.name, "output", o.shape, o.unit) for o in fmu.outputs)
    return Model(fmu.identifier, fmu.description, "sampled", tuple(variables), ())


def _values(listed: Element, fmu: LsBusFmu) -> list[int]:
    """The variables that belong to no terminal; returns the references of the outputs."""
    if fmu.bus:
        SubElement(
            listed, "Boolean", name="BusNotifications", valueReference="0", causality="output",
            variability="constant", start="true",
        )  # fmt: skip
    SubElement(
        listed, "Float64", name="time", valueReference=str(fmu.time),
        causality="independent", variability="continuous",
    )  # fmt: skip
    for n, output in enumerate(fmu.outputs):
        variable = SubElement(
            listed, "Float64", name=output.name, valueReference=str(fmu.time + 1 + n),
            causality="output", variability="discrete", initial="calculated", unit=output.unit,
        )  # fmt: skip
        for size in output.shape:
            SubElement(variable, "Dimension", start=str(size))
    references = [fmu.time + 1 + n for n in range(len(fmu.outputs))]
    return [0, *references] if fmu.bus else references


def _variable(listed: Element, name: str, reference: int, member: str) -> None:
    common = {"name": name, "valueReference": str(reference)}
    match member:
        case "Tx_Clock":
            SubElement(listed, "Clock", common, causality="input", intervalVariability="countdown")
        case "Rx_Clock":
            SubElement(listed, "Clock", common, causality="input", intervalVariability="triggered")
        case "Tx_Data":
            SubElement(
                listed, "Binary", common, causality="output", variability="discrete",
                initial="calculated", clocks=str(reference - 2), mimeType=_MIME,
            )  # fmt: skip
        case "Rx_Data":
            binary = SubElement(
                listed, "Binary", common, causality="input", variability="discrete",
                clocks=str(reference - 2), mimeType=_MIME,
            )  # fmt: skip
            SubElement(binary, "Start", value="")


def _terminals(fmu: LsBusFmu) -> Element:
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = SubElement(root, "Terminals")
    terminal = listed
    for name, _, member in fmu.variables():
        if member == MEMBERS[0]:
            terminal = SubElement(
                listed, "Terminal", name=name, terminalKind=_KIND,
                matchingRule="org.fmi-ls-bus.transceiver",
            )  # fmt: skip
        _member(terminal, f"{name}.{member}", member)
        if fmu.bus and member == MEMBERS[-1]:
            nested = SubElement(
                terminal, "Terminal", name="Configuration",
                terminalKind=f"{_KIND}.configuration", matchingRule="bus",
            )  # fmt: skip
            _member(nested, "BusNotifications", "BusNotifications")
    return root


def _member(terminal: Element, variable: str, member: str) -> None:
    SubElement(
        terminal, "TerminalMemberVariable", variableKind="signal", variableName=variable,
        memberName=member,
    )  # fmt: skip


def _manifest(fmu: LsBusFmu) -> Element:
    return Element(
        "fmiLayeredStandardManifest",
        {
            "xmlns:fmi-ls": _LS,
            "fmi-ls:fmi-ls-name": "org.fmi-standard.fmi-ls-bus",
            "fmi-ls:fmi-ls-version": "1.0.0",
            "fmi-ls:fmi-ls-description": _ABOUT,
            "isBusSimulationFMU": str(fmu.bus).lower(),
        },
    )
