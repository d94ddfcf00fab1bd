"""Writes ``teleoperation.csv``: ``python -m tests.system.golden.make`` in the project's folder.

What makes these numbers shares with the engine and the FMUs the plan and the links' tables only:
the models are their NumPy references, the executor is the oracle in ``tests/cosim/oracle.py``.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from tests.cosim.oracle import execute
from tests.system.runs import SIDES, Document, plan, teleoperation

FILE = Path(__file__).with_name("teleoperation.csv")
STOP, EVERY = 20.0, 500  # s, ticks: a row each 0.5 s
COLUMNS = tuple(
    f"{name}[{i}]"
    for side in SIDES
    for name, size in (
        (f"{side}.q", 2),
        (f"{side}.dq", 2),
        (f"{side}.tau_h", 2),
        (f"{side}_control.tau", 2),
        (f"{side}_control.z", 2),
        (f"{side}_control.theta_hat", 3),
    )
    for i in range(size)
)


def document(stop: float = STOP) -> Document:
    """The shipped scenario with the models' NumPy references in place of the FMUs."""
    found = teleoperation(stop=stop)
    for side in SIDES:
        found["components"][side]["model"] = "fmus.models.planar2r:Planar2R"
        found["components"][f"{side}_control"]["model"] = "fmus.models.teleoperation:Teleoperation"
    return found


def rows(stop: float = STOP) -> np.ndarray:
    """t and the columns every 0.5 s, (n, 1 + columns); the last row of a run is left out.

    There nobody has stepped any more: what the controllers hold is older than t.
    """
    made = plan(document(stop))
    every = execute(made)[:-1:EVERY]
    at = {
        name: slot.start + i
        for slot in made.slots().values()
        for i, name in enumerate(slot.scalars())
    }
    t = np.arange(len(every)) * EVERY * made.h
    return np.column_stack([t, every[:, [at[name] for name in COLUMNS]]])


def main() -> None:
    """Write the file anew."""
    with FILE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["t", *COLUMNS])
        writer.writerows([f"{value:.17g}" for value in row] for row in rows())


if __name__ == "__main__":
    main()
