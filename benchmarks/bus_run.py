"""Cost of a simulated CAN bus in a run: ``python -m benchmarks.bus_run``.

The teleoperator of configs/can/teleoperation-bus.toml for 60 s, in three variants: with constant
delays instead of frames (the lower bound), on a CAN FD bus of 1 and 5 Mbit/s as in
configs/deploy/can.toml, and as in the file, with 30 % of other traffic. The result is the processor
time of this process, in alternating rounds: `assemble` loads the FMUs and simulates the bus,
`simulate` runs and records every 5 ms to Parquet. The machine is shared, so the best round counts;
the median is printed next to it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.tables import grid, machine
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.scenario.assemble import assemble

SCENARIO = Path(__file__).parents[1] / "configs" / "can" / "teleoperation-bus.toml"
CONSTANT = '{from="%s", to="%s", semantics="newest-stamp", delay={law="constant", delay="1 ms"}}'
ENDS = (
    ("master_control.xi", "slave_control.xi_in[0]"),
    ("slave_control.xi", "master_control.xi_in[0]"),
)
SETTINGS = {
    "constant delays, no bus": [f"links=[{', '.join(CONSTANT % ends for ends in ENDS)}]"],
    "CAN FD, 1 and 5 Mbit/s": [
        "bus.can0.traffic=[]",
        "bus.can0.bitrate=1e6",
        "bus.can0.data_bitrate=5e6",
    ],
    "CAN FD, 0.5 and 2 Mbit/s, 30 % other traffic": [],
}


def spent(settings: list[str], folder: Path) -> tuple[float, float, float]:
    """Processor time of `assemble` and of `simulate`, s, and the length of the run, s."""
    scenario = load(SCENARIO, ["run.record.every=5", *settings])
    begin = time.process_time()
    plan = assemble(scenario)
    between = time.process_time()
    simulate(scenario, folder, plan=plan)
    return between - begin, time.process_time() - between, plan.h * plan.ticks


def main() -> None:
    """Print the table of docs/bus.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--quick", action="store_true", help="One round.")
    given = parser.parse_args()
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in SETTINGS}
    with TemporaryDirectory() as folder:
        for i in range(1 if given.quick else given.rounds):
            for n, (name, settings) in enumerate(SETTINGS.items()):
                found[name].append(spent(settings, Path(folder, f"{i}-{n}")))
    rows = []
    for name, times in found.items():
        best, middle = min(a + b for a, b, _ in times), median(a + b for a, b, _ in times)
        parts = [f"{1e3 * min(t[i] for t in times):.0f}" for i in (0, 1)]
        ratio = f"{times[0][2] / best:.0f} ({times[0][2] / middle:.0f})"
        rows.append([name, *parts, ratio])
    print(machine())
    print(grid(["frames", "assemble, ms", "simulate, ms", "times real time (median)"], rows))


if __name__ == "__main__":
    main()
