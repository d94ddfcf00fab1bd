"""Memory does not grow with the length of a run: what is recorded goes to the disk in chunks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.long_run import GOAL, rows
from tests.system.runs import ROOT

RUN = """
import json, resource, sys
from pathlib import Path
from tests.system.runs import scenario, teleoperation
from cosim.engine.simulate import simulate
document = teleoperation(stop=float(sys.argv[2]))
document["run"]["record"] = {"every": int(sys.argv[3])}
simulate(scenario(document), Path(sys.argv[1]))
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit))
"""


def peak(folder: Path, stop: float, every: int) -> float:
    """Largest resident memory, MB, of a process that runs `stop` s."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(folder), str(stop), str(every)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(json.loads(done.stdout)) / 1e6


def test_memory_is_flat_in_the_length_of_a_run(tmp_path: Path) -> None:
    short = peak(tmp_path / "short", 60.0, every=1000)
    long = peak(tmp_path / "long", 1200.0, every=1000)
    assert abs(long - short) < 10.0, (short, long)


@pytest.mark.slow
def test_memory_is_flat_in_what_is_recorded(tmp_path: Path) -> None:
    """Every tick, 39 signals: 75 MB of numbers, of which a few chunks are held at a time."""
    short = peak(tmp_path / "short", 60.0, every=1)
    long = peak(tmp_path / "long", 240.0, every=1)
    assert long - short < 10.0, (short, long)


@pytest.mark.slow
def test_a_long_recording_is_read_in_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """10^7 rows, which take 240 MB as whole columns, and more in sums over them."""
    monkeypatch.chdir(tmp_path)
    commands = ["run", "report", "png", "show", "diff", "csv", "parquet"]
    for row in rows(10_000_000, commands):
        assert row["exit"] == 0
        assert 30 < row["mb"] < GOAL, row
