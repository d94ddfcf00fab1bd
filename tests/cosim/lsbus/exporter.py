"""Node FMUs of ``c/node3.c`` with every kind of Tx clock; no code is shared with the importer."""

from __future__ import annotations

import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from cosim.fmi import FmuComponent
from cosim.lsbus.node import NodeFmu
from fmus.build.toolchain import compile_shared, shared_suffix

FOLDER_C = Path(__file__).parent / "c"
SOURCES = [FOLDER_C / "node3.c", FOLDER_C / "rest3.c"]
FOLDER = tempfile.TemporaryDirectory(prefix="lsbus-")
MIME = "application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;"
PARAMETERS = ("kind", "id", "bytes", "count", "first", "period", "baud", "discard", "bad")
KINDS = {"triggered": 0, "countdown": 1, "changing": 2, "constant": 3, "fixed": 3, "tunable": 3}


def description(kind: str, period: float, first: float, flags: str = "") -> str:
    """The model description of a node with this kind of Tx clock."""
    causality = "output" if kind == "triggered" else "input"
    interval = f'intervalDecimal="{period}" shiftDecimal="{first}"' if kind == "constant" else ""
    parameters = "".join(
        f'<Float64 name="{name}" valueReference="{10 + i}" causality="parameter" '
        'variability="fixed" start="0"/>'
        for i, name in enumerate(PARAMETERS)
    )
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="node" instantiationToken="t">
<CoSimulation modelIdentifier="node3" canHandleVariableCommunicationStepSize="true"
 hasEventMode="true" {flags}/><ModelVariables>
<Clock name="Powertrain.Tx_Clock" valueReference="1" causality="{causality}"
 intervalVariability="{kind}" {interval}/>
<Clock name="Powertrain.Rx_Clock" valueReference="2" causality="input"
 intervalVariability="triggered"/>
<Binary name="Powertrain.Tx_Data" valueReference="3" causality="output" variability="discrete"
 initial="calculated" clocks="1" mimeType="{MIME}"/>
<Binary name="Powertrain.Rx_Data" valueReference="4" causality="input" variability="discrete"
 clocks="2" mimeType="{MIME}"><Start value=""/></Binary>{parameters}
<Boolean name="notify" valueReference="19" causality="parameter" variability="fixed" start="false"/>
<Float64 name="tec" valueReference="20" causality="output"/>
<Float64 name="sent" valueReference="21" causality="output"/>
<Float64 name="heard" valueReference="22" causality="output"/>
<Float64 name="ticked" valueReference="23" causality="output"/>
<Float64 name="smooth" valueReference="30" causality="input" start="0"/>
<Float64 name="jump" valueReference="31" causality="input" variability="discrete" start="0"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


def member(name: str) -> str:
    """A member of the terminal."""
    return (
        f'<TerminalMemberVariable variableKind="signal" variableName="Powertrain.{name}" '
        f'memberName="{name}"/>'
    )


TERMINALS = f"""<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals><Terminal name="Powertrain"
 terminalKind="org.fmi-ls-bus.network-terminal" matchingRule="org.fmi-ls-bus.transceiver">
{"".join(map(member, ("Tx_Data", "Tx_Clock", "Rx_Data", "Rx_Clock")))}
<Terminal name="Configuration" terminalKind="org.fmi-ls-bus.network-terminal.configuration"
 matchingRule="bus"><TerminalMemberVariable variableKind="signal" variableName="notify"
 memberName="BusNotifications"/></Terminal></Terminal></Terminals></fmiTerminalsAndIcons>"""
MANIFEST = """<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
 fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-bus" fmi-ls:fmi-ls-version="1.0.0"
 fmi-ls:fmi-ls-description="Layered Standard for the simulation of bus communication on a Physical
 Signal Abstraction or Network Abstraction based level." isBusSimulationFMU="false"/>"""


@lru_cache
def library() -> bytes:
    """The compiled C file."""
    return compile_shared(SOURCES, Path(FOLDER.name) / f"node3{shared_suffix()}").read_bytes()


def export(path: Path, model: str, terminals: str = TERMINALS) -> Path:
    """An FMU with this model description and these terminals."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", model)
        archive.writestr("terminalsAndIcons/terminalsAndIcons.xml", terminals)
        extra = "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml"
        archive.writestr(extra, MANIFEST)
        archive.writestr(f"binaries/x86_64-linux/node3{shared_suffix()}", library())
    return path


def node(folder: Path, name: str, kind: str = "countdown", **given: float) -> NodeFmu:
    """A node of these parameters; see ``c/node3.c``."""
    values = {"period": 1e-3, "first": 1e-3, "baud": 500e3, **given, "kind": float(KINDS[kind])}
    path = export(folder / f"{name}.fmu", description(kind, values["period"], values["first"]))
    return NodeFmu(
        FmuComponent(path, name), "Powertrain", {k: np.array(v) for k, v in values.items()}
    )
