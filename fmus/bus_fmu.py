"""The simulated CAN bus as an FMU: a Bus Simulation FMU of FMI-LS-BUS 1.0 for n nodes.

The FMU is the C code of ``cosim/c/bus`` behind that of ``fmus/c/lsbus``, with its sources. Each
node is a terminal ``Node1``, ``Node2``, ... whose Tx_Clock counts down to the next operation of the
bus.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import cosim
from cosim.base.errors import FmuError
from cosim.bus.described import bit_ps
from cosim.bus.settings import BusNodeSettings
from cosim.bus.timing import BusTiming
from fmus.build import licences, write_archive
from fmus.description import xml_text
from fmus.toolchain import FLAGS, compile_shared, host_platform, shared_suffix

IDENTIFIER = "can_bus"
MEMBERS = ("Tx_Clock", "Rx_Clock", "Tx_Data", "Rx_Data")
_MIME = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
_KIND = "org.fmi-ls-bus.network-terminal"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
#: Fixed by the schema of the layered standard.
_ABOUT = (
    "Layered Standard for the simulation of bus communication on a Physical Signal Abstraction or"
    " Network Abstraction based level."
)
_HERE = Path(__file__).parent / "c"
_HEADERS = ("export.h", "fmi3.h", "fmi3_types.h")


def build_bus(
    nodes: int, timing: BusTiming, target: Path | str, platforms: Sequence[str] | None = None
) -> Path:
    """Build the FMU of a bus with so many `nodes` and return its path, `target`.

    `platforms`: of :data:`fmus.toolchain.PLATFORMS`; default the host's. Raises FmuError for a
    number of nodes that is not 1 to 64 and where the file cannot be written, and
    fmus.toolchain.ToolchainError from the compiler.
    """
    if not 1 <= nodes <= 64:
        raise FmuError(f"found {nodes} nodes, expected 1 to 64")
    sources = bus_sources(nodes, timing)
    joined = "".join(f"{name}\0{text}\0" for name, text in sorted(sources.items()))
    token = "{" + hashlib.sha256(joined.encode()).hexdigest()[:32] + "}"
    sources["bus_config.h"] += f'#define TOKEN "{token}"\n#endif\n'
    content = {name: text.encode() for name, text in _texts(nodes, timing, token, sources).items()}
    for platform in platforms or (host_platform(),):
        suffix = shared_suffix(platform)
        content[f"binaries/{platform}/{IDENTIFIER}{suffix}"] = _compiled(sources, platform)
    write_archive(content, Path(target))
    return Path(target)


def bus_sources(nodes: int, timing: BusTiming) -> dict[str, str]:
    """The C files by name; ``bus_config.h`` still without token and end."""
    bus = Path(cosim.__file__).parent / "c" / "bus"
    files = [*bus.glob("*.[ch]"), *(_HERE / "lsbus").glob("*.[ch]"), *(_HERE / n for n in _HEADERS)]
    found = {file.name: file.read_text(encoding="utf-8") for file in files}
    return found | {"bus_config.h": _config(nodes, timing)}


def _config(nodes: int, timing: BusTiming) -> str:
    data_rate = timing.data_bitrate or timing.bitrate
    default = BusNodeSettings("default")
    values = {
        "N_NODES": nodes,
        "BITRATE": f"{round(timing.bitrate)}u",
        "DATA_BITRATE": f"{round(data_rate)}u",
        "BIT_PS": bit_ps(timing.bitrate),
        "DATA_BIT_PS": bit_ps(data_rate),
        "WITH_FD": int(timing.fd),
        "SAMPLE_POINT": round(default.sample_point * 1000),
        "JUMP_WIDTH": round(default.sjw * 1000),
    }
    lines = "".join(f"#define {name} {value}\n" for name, value in values.items())
    return f"/* bus_config.h - this bus. */\n#ifndef BUS_CONFIG_H\n#define BUS_CONFIG_H\n{lines}"


def _compiled(sources: Mapping[str, str], platform: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="bus-fmu-") as scratch:
        folder = Path(scratch)
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        units = sorted(folder.glob("*.c"))
        output = folder / f"{IDENTIFIER}{shared_suffix(platform)}"
        return compile_shared(units, output, include=[folder], platform=platform).read_bytes()


def _texts(nodes: int, timing: BusTiming, token: str, sources: Mapping[str, str]) -> dict[str, str]:
    """All entries of the archive but the binaries."""
    build = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(build, "BuildConfiguration", modelIdentifier=IDENTIFIER)
    files = SubElement(
        configuration, "SourceFileSet", language="C99", compilerOptions=" ".join(FLAGS)
    )
    for name in sorted(n for n in sources if n.endswith(".c")):
        SubElement(files, "SourceFile", name=name)
    return {
        "modelDescription.xml": xml_text(_description(nodes, timing, token)),
        "terminalsAndIcons/terminalsAndIcons.xml": xml_text(_terminals(nodes)),
        "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml": xml_text(_manifest()),
        "sources/buildDescription.xml": xml_text(build),
        **{f"sources/{name}": text for name, text in sources.items()},
        **licences("3.0"),
    }


def _variables(nodes: int) -> Iterator[tuple[str, int, str]]:
    """(terminal, value reference, member) of every variable of a terminal."""
    for node in range(nodes):
        for k, member in enumerate(MEMBERS):
            yield f"Node{node + 1}", 4 * node + k + 1, member


def _description(nodes: int, timing: BusTiming, token: str) -> Element:
    rates = f"{timing.bitrate:g} bit/s"
    if timing.fd:
        rates += f", FD {timing.data_bitrate or timing.bitrate:g} bit/s"
    root = Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName="CanBus",
        description=f"CAN bus with {nodes} nodes, {rates}",
        version=cosim.__version__,
        license="Apache-2.0",
        instantiationToken=token,
        generationTool=f"cosim-bridge {cosim.__version__}",
    )
    SubElement(
        root,
        "CoSimulation",
        modelIdentifier=IDENTIFIER,
        canHandleVariableCommunicationStepSize="true",
        hasEventMode="true",
    )
    SubElement(SubElement(root, "LogCategories"), "Category", name="logStatusError")
    listed = SubElement(root, "ModelVariables")
    SubElement(
        listed, "Boolean", name="BusNotifications", valueReference="0", causality="output",
        variability="constant", start="true",
    )  # fmt: skip
    SubElement(
        listed, "Float64", name="time", valueReference=str(4 * nodes + 1),
        causality="independent", variability="continuous",
    )  # fmt: skip
    outputs = [0]
    for terminal, reference, member in _variables(nodes):
        _variable(listed, f"{terminal}.{member}", reference, member)
        outputs += [reference] if member == "Tx_Data" else []
    structure = SubElement(root, "ModelStructure")
    for reference in outputs:
        SubElement(structure, "Output", valueReference=str(reference))
    return root


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


def _terminals(nodes: int) -> Element:
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = SubElement(root, "Terminals")
    terminal = listed
    for name, _, member in _variables(nodes):
        if member == MEMBERS[0]:
            terminal = SubElement(
                listed, "Terminal", name=name, terminalKind=_KIND,
                matchingRule="org.fmi-ls-bus.transceiver",
            )  # fmt: skip
        _member(terminal, f"{name}.{member}", member)
        if member == MEMBERS[-1]:
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


def _manifest() -> Element:
    return Element(
        "fmiLayeredStandardManifest",
        {
            "xmlns:fmi-ls": _LS,
            "fmi-ls:fmi-ls-name": "org.fmi-standard.fmi-ls-bus",
            "fmi-ls:fmi-ls-version": "1.0.0",
            "fmi-ls:fmi-ls-description": _ABOUT,
            "isBusSimulationFMU": "true",
        },
    )
