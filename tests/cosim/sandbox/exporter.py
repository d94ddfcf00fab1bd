"""FMUs whose only binary is WebAssembly, of C files and descriptions written for the tests."""

from __future__ import annotations

import zipfile
from pathlib import Path

from fmus.build.wasm_fmu import add_wasm

SOURCES = Path(__file__).parent / "c"
HOSTILE3 = """<fmiModelDescription fmiVersion="3.0" modelName="hostile" instantiationToken="t">
<CoSimulation modelIdentifier="hostile3" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables><Float64 name="u" valueReference="0" causality="input" start="1"/>
<Float64 name="y" valueReference="1" causality="output"/>
<Float64 name="when" valueReference="2" causality="parameter" variability="fixed" start="0"/>
<Int32 name="how" valueReference="10" causality="parameter" variability="fixed" start="0"/>
</ModelVariables><ModelStructure><Output valueReference="1"/></ModelStructure>
</fmiModelDescription>"""


def hostile(path: Path) -> Path:
    """An FMU that does what ``c/hostile3.c`` says."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", HOSTILE3)
        archive.write(SOURCES / "hostile3.c", "sources/hostile3.c")
    return add_wasm(path)
