"""Node FMUs and the bus FMU in a container of fmu-manipulation-toolbox, run by FMPy."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from cosim.bus.timing import BusTiming
from cosim.lsbus.network import CanNetwork
from fmus.build.bus_fmu import build_bus
from tests.cosim.lsbus.exporter import node

PARAMETERS = {"kind": 0.0, "bytes": 3.0, "count": 5.0, "first": 1e-3, "period": 1e-3}
FIRST_BYTE = {"a": 10.0, "b": 100.0}  # of the first frame; the next frames begin with 1 more each
pytestmark = pytest.mark.slow


def container(
    folder: Path,
    fmus: Sequence[str],
    links: Sequence[Sequence[str]],
    step: float,
    baud: float,
    first_byte: Mapping[str, float],
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
    values |= {"smooth": first_byte[first], f"{second}.smooth": first_byte[second]}
    found: np.ndarray = simulate_fmu(
        str(folder / "all.fmu"), validate=False, start_values=values, stop_time=8e-3,
        output_interval=step, fmi_type="CoSimulation", use_event_mode=False,
        output=[f"{n}{x}" for n in ("", f"{second}.") for x in ("sent", "heard", "ticked")],
    )  # fmt: skip
    return found


@pytest.mark.parametrize("fmus", [("a", "b"), ("b", "a")])
def test_the_first_node_of_a_container_hears_the_other_one(
    fmus: tuple[str, str], tmp_path: Path
) -> None:
    """Without a bus. The second node sends too; version 2.0 hands it no frames (docs/bus.md)."""
    second = fmus[1]
    links = [["a.fmu", "Powertrain", "b.fmu", "Powertrain"]]
    found = container(tmp_path, fmus, links, step=1e-3, baud=0.0, first_byte=FIRST_BYTE)
    assert found["sent"][-1] == found[f"{second}.sent"][-1] == 5
    assert list(found["heard"][1:6]) == [FIRST_BYTE[second] + k for k in range(5)]


def test_the_bus_fmu_in_a_container_ticks_at_the_ends_of_frames(tmp_path: Path) -> None:
    """The bus gets the frames of both nodes, and its clocks tick when a frame has been sent.

    Version 2.0 passes no data on from clocks that it ticks itself (docs/bus.md).
    """
    build_bus(2, BusTiming(500e3), tmp_path / "bus.fmu")
    links = [[f"{n}.fmu", "Powertrain", "bus.fmu", f"Node{i + 1}"] for i, n in enumerate("ab")]
    found = container(tmp_path, ("bus", "a", "b"), links, 1e-4, 500e3, {"a": 0.0, "b": 0.0})
    assert found["sent"][-1] == found["b.sent"][-1] == 5
    given = {k: v for k, v in PARAMETERS.items() if k != "kind"}
    nodes = [
        node(tmp_path, f"{name}-own", "triggered", **given, id=k)
        for name, k in (("a", 0x100), ("b", 0x200))
    ]
    with CanNetwork(BusTiming(500e3), nodes, step=1e-4) as network:
        network.run(8e-3)
    ends = sorted({x.time_ps for x in network.exchanged if not x.sent})
    assert len(ends) == 10
    for k in range(5):
        first, second = (1e-12 * t for t in ends[2 * k : 2 * k + 2])
        for clock in ("ticked", "b.ticked"):
            assert found[clock][10 * (k + 1) + 2] == pytest.approx(first, abs=1e-9)
            assert found[clock][10 * (k + 1) + 9] == pytest.approx(second, abs=1e-9)
