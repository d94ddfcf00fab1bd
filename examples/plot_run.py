"""Open a run of the teleoperator, compute two numbers, draw them: ``plot_run.py RUN_FOLDER``."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cosim.measure.metrics import evaluate, metric
from cosim.record import Run


def main(folder: Path) -> None:
    run = Run.open(folder)
    print(f"{folder}: {len(run)} rows of {len(run.names)} signals, seed {run.metadata['seed']}")

    # What a scenario can declare under [metrics] ...
    effort = metric("effort", "norm", ["master.tau_h"], label="operator effort")
    sync = metric("sync", "error", ["master.q"], target="slave.q", within=0.05, label="sync error")
    for result in evaluate([effort, sync], run):
        for label, text in result.facts:
            print(f"{label}: {text}")

    # ... and what it cannot: signals are NumPy arrays, (rows, entries).
    q, dq, tau_h = (run.array(f"master.{name}") for name in ("q", "dq", "tau_h"))
    power = (tau_h * dq).sum(axis=1)
    print(f"work of the operator: {power[:-1] @ np.diff(run.t):.3f} J")

    figure = Figure(figsize=(8, 5), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    above.plot(run.t, q - run.array("slave.q"), label=["joint 1", "joint 2"])
    above.set_ylabel(f"q_master - q_slave [{run.unit('master.q')}]")
    above.legend()
    below.plot(run.t, power)
    below.set(xlabel="t [s]", ylabel="power of the operator [W]")
    figure.savefig(folder / "sync.png", dpi=120)
    print(f"figure: {folder / 'sync.png'}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python plot_run.py RUN_FOLDER")
    main(Path(sys.argv[1]))
