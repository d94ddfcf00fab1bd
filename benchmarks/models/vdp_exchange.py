"""The driven van der Pol oscillator as an FMU for model exchange, FMI 2.0: ``vdp_exchange.c``."""

from __future__ import annotations

import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path

from fmus.build.toolchain import compile_shared, shared_suffix

_FOLDER = tempfile.TemporaryDirectory(prefix="vdp-")
_VARIABLES = (
    ("u", "input", 'start="0"'), ("x", "output", 'start="2"'), ("v", "local", 'start="0"'),
    ("der(x)", "local", 'derivative="2"'), ("der(v)", "local", 'derivative="3"'),
    ("mu", "parameter", 'start="1"'), ("omega2", "parameter", 'start="1"'),
    ("gain", "parameter", 'start="0.1"'),
)  # fmt: skip


@lru_cache(maxsize=1)
def fmu() -> Path:
    """Path of the FMU, compiled for this process."""
    folder = Path(_FOLDER.name)
    binary = folder / f"vdp{shared_suffix()}"
    compile_shared([Path(__file__).with_suffix(".c")], binary)
    path = folder / "vdp_exchange.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", _description())
        archive.write(binary, f"binaries/linux64/vdp{shared_suffix()}")
    return path


def _description() -> str:
    scalars = ""
    for i, (name, causality, attributes) in enumerate(_VARIABLES):
        varies = "fixed" if causality == "parameter" else "continuous"
        exact = ' initial="exact"' if name in ("x", "v") else ""
        scalars += (
            f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" '
            f'variability="{varies}"{exact}><Real {attributes}/></ScalarVariable>'
        )
    return (
        '<fmiModelDescription fmiVersion="2.0" modelName="vdp" guid="vdp" '
        'numberOfEventIndicators="0"><ModelExchange modelIdentifier="vdp" '
        'completedIntegratorStepNotNeeded="true"/><ModelVariables>'
        f'{scalars}</ModelVariables><ModelStructure><Outputs><Unknown index="2"/></Outputs>'
        '<Derivatives><Unknown index="4"/><Unknown index="5"/></Derivatives></ModelStructure>'
        "</fmiModelDescription>"
    )
