"""Our FMUs in other masters, and our engine with ``algorithm = "jacobi"``: same numbers.

FMPy, libcosim and Ecos share no code with this project. The system has two arms, an operator, two
controllers and their connections: seven FMUs wired directly and stepped together, with a delay of
one step at each connection.

libcosim passes the difference of two rounded times, fl(t + h) - fl(t), to an FMU as the length of a
step. With h = 2⁻⁹ s these are exact, and so is the comparison; with h = 1 ms the step differs by up
to 10⁻¹⁶ s from ours, and the trajectories accordingly.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.schedule.plan import Plan
from tests.system import foreign
from tests.system.runs import plan, signals, teleoperation, without_delay

Master = Callable[[Plan, Path], foreign.Outputs]
needs_tbb = pytest.mark.needs_tbb


def wired(fmi: str, step: float, steps: int) -> Plan:
    """Seven FMUs, connected by wires only, all stepped every tick."""
    document = without_delay(teleoperation(stop=steps * step))
    document["run"] |= {"step": step, "algorithm": "jacobi"}
    components = document["components"]
    components["operator"] = {
        "model": "fmus.models.operator",
        "parameters": {"k_p": [10.0, 8.0], "q_h": [3.5, 3.0]},
        "inputs": {"q": "master.q", "dq": "master.dq"},
    }
    components["master"]["parameters"] = {"substeps": 2}
    components["master"]["inputs"]["tau_ext"] = "operator.tau_h"
    for component in components.values():
        component.pop("period", None)
        component["fmi"] = fmi
    return plan(document)


def compared(master: Master, fmi: str, step: float, folder: Path) -> dict[str, float]:
    """Largest difference of each output between our engine and `master`."""
    ours = wired(fmi, step, 400)
    recorded = signals(ours)
    at = {
        name: slot.start + i
        for c in ours.components
        for slot in c.outputs
        for i, name in enumerate(slot.scalars())
    }
    theirs = master(wired(fmi, step, 400), folder)
    assert theirs.keys() == at.keys()
    moved = np.ptp(recorded, axis=0)
    assert all(moved[at[f"{side}.q[0]"]] > 0.02 for side in ("master", "slave"))
    return {
        name: float(np.abs(y - recorded[-len(y) :, at[name]]).max()) for name, y in theirs.items()
    }


@pytest.mark.parametrize(
    ("master", "fmi"),
    [
        pytest.param(foreign.fmpy, "2.0", id="FMPy, FMI 2.0"),
        pytest.param(foreign.fmpy, "3.0", id="FMPy, FMI 3.0"),
        pytest.param(foreign.libcosim, "2.0", id="libcosim"),
        pytest.param(foreign.ecos, "2.0", id="Ecos", marks=needs_tbb),
    ],
)
def test_other_masters_give_the_same_trajectory_to_the_last_bit(
    tmp_path: Path, master: Master, fmi: str
) -> None:
    apart = compared(master, fmi, 2.0**-9, tmp_path)
    assert not {name: value for name, value in apart.items() if value > 0.0}


def test_libcosim_rounds_the_length_of_a_step_of_a_millisecond(tmp_path: Path) -> None:
    apart = compared(foreign.libcosim, "2.0", 1e-3, tmp_path)
    assert 0.0 < max(apart.values()) < 1e-12


@needs_tbb
def test_ecos_agrees_at_a_step_of_a_millisecond(tmp_path: Path) -> None:
    """It adds h to the time in every step, but hands the FMUs h itself."""
    assert not any(compared(foreign.ecos, "2.0", 1e-3, tmp_path).values())
