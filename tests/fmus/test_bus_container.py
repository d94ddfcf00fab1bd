"""Node FMUs and the bus FMU in a container of fmu-manipulation-toolbox, run by FMPy."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from cosim.bus.timing import BusTiming
from fmus.bus_fmu import build_bus
from tests.cosim.lsbus.exporter import node

PARAMETERS = {"kind": 0.0, "bytes": 3.0, "count": 5.0, "first": 1e-3, "period": 1e-3}
FIRST_BYTE = {"a": 10.0, "b": 100.0}  # of the first frame; the next frames begin with 1 more each
pytestmark = pytest.mark.slow


def container(
    folder: Path, fmus: Sequence[str], links: Sequence[Sequence[str]], step: float, baud: float
) -> np.ndarray:
    """The outputs of 8 ms of the FMUs in one container; those of the first node have no prefix."""
    for name, k in (("a", 0x100), ("b", 0x200)):
        node(folder, name, "triggered", id=k)
    (folder / "all.json").write_text(
        json.dumps(
            {"name": "all.fmu", "fmu": [f"{x}.fmu" for x in fmus], "step_size": step,
             "auto_input": True, "auto_output": True, "auto_parameter": True, "link": links}
        )
    )  # fmt: skip
    program = Path(sys.executable).with_name("fmucontainer")
    command = [str(program), "-fmu-directory", str(folder), "-container", "all.json", "-fmi", "3"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    first, second = (x for x in fmus if x != "bus")
    values = {f"{n}.{k}": v for n in "ab" for k, v in (PARAMETERS | {"baud": baud}).items()}
    values |= {"a.id": 256.0, "b.id": 512.0}
    values |= {"smooth": FIRST_BYTE[first], f"{second}.smooth": FIRST_BYTE[second]}
    found: np.ndarray = simulate_fmu(
        str(folder / "all.fmu"), validate=False, start_values=values, stop_time=8e-3,
        output_interval=step, fmi_type="CoSimulation", use_event_mode=False,
        output=["sent", "heard", f"{second}.sent", f"{second}.heard"],
    )  # fmt: skip
    return found


@pytest.mark.parametrize("fmus", [("a", "b"), ("b", "a")])
def test_the_first_node_of_a_container_hears_the_other_one(
    fmus: tuple[str, str], tmp_path: Path
) -> None:
    """Without a bus. The second node sends too; version 2.0 hands it no frames (docs/ls-bus.md)."""
    second = fmus[1]
    found = container(
        tmp_path, fmus, [["a.fmu", "Powertrain", "b.fmu", "Powertrain"]], step=1e-3, baud=0.0
    )
    assert found["sent"][-1] == found[f"{second}.sent"][-1] == 5
    assert list(found["heard"][1:6]) == [FIRST_BYTE[second] + k for k in range(5)]


def test_a_container_takes_the_bus_fmu_and_its_nodes(tmp_path: Path) -> None:
    """Nodes send all frames, and no FMU reports an error; version 2.0 delivers no frame here."""
    build_bus(2, BusTiming(500e3), tmp_path / "bus.fmu")
    links = [[f"{n}.fmu", "Powertrain", "bus.fmu", f"Node{i + 1}"] for i, n in enumerate("ab")]
    found = container(tmp_path, ("bus", "a", "b"), links, step=1e-4, baud=500e3)
    assert found["sent"][-1] == found["b.sent"][-1] == 5
