"""One run that `recording.py` measures, in a process that imports nothing a user's does not.

python benchmarks/recording_work.py CASE VARIANT FOLDER STOP
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "configs" / "teleoperation.toml"
COMMAND, ENGINE = "`cosim run --no-plot`", "engine"
MEMORY, ALONE = "in memory", "in memory, alone"


def forget() -> None:
    """Make this process keep what it records in memory until the run ends."""
    import mmap

    import numpy as np

    from cosim.engine import simulate
    from cosim.links import storage
    from cosim.links.storage import GROUP
    from cosim.record import live

    class Table(storage.TableWriter):
        def __init__(self, path: Path, facts: Any) -> None:
            self._path, self._facts, self._kept = path, facts, list[Any]()

        def write(self, rows: Any) -> None:
            self._kept.append(np.array(rows, np.int32))

        def close(self) -> None:
            rows = np.concatenate(self._kept)
            groups = (rows[i : i + GROUP] for i in range(0, rows.size, GROUP))
            storage.write_groups(self._path, self._facts, groups)

    written = simulate.write_metadata
    simulate.TableWriter = Table  # type: ignore[misc]
    simulate.write_metadata = lambda *a, indented=True: indented and written(*a)  # type: ignore[assignment]
    live.map_new_file = lambda path, size: (mmap.mmap(-1, size), -1)


def work(case: str, variant: str, folder: str, stop: str) -> None:
    """One run, in this process; of the engine, its processor and wall seconds are printed."""
    import json
    import time

    from cosim.cli.supervise import supervised

    def prepare() -> None:
        from cosim.engine import simulate
        from cosim.links import storage
        from cosim.record import live

        del simulate, storage, live
        if variant in (MEMORY, ALONE):
            forget()

    def command() -> None:
        prepare()
        from cosim.cli.commands import command

        sys.argv = ["cosim", "run", str(CONFIG), "--no-plot", "--out", folder]
        sys.argv += ["--set", f"run.stop={stop}"]
        command()

    if case == COMMAND:
        sys.exit(command() if variant == ALONE else supervised(command))
    prepare()
    from cosim.engine.simulate import simulate
    from cosim.loading.files import load

    scenario = load(CONFIG, [f"run.stop={stop}"])
    cpu, wall = time.process_time(), time.perf_counter()
    simulate(scenario, folder)
    print(json.dumps([time.process_time() - cpu, time.perf_counter() - wall]))


if __name__ == "__main__":
    sys.path.append(str(ROOT))
    work(*sys.argv[1:])
