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


INTERRUPTED = """
import json, os, resource, sys
from pathlib import Path
from warnings import simplefilter
import numpy as np
from cosim.record import Column, Recorder, Run
folder, rows, step = Path(sys.argv[1]), int(sys.argv[2]), 1 << 13
folder.mkdir()
if not os.fork():
    columns = [Column(name, "m", i) for i, name in enumerate("abc")]
    recorder = Recorder(folder, columns, h=0.001, n_signals=3, rows_per_chunk=step)
    for k in range(0, rows, step):
        buffer = recorder.buffer()
        buffer[:step] = np.arange(k, k + step)[:, None]
        recorder.submit(buffer, k, step)
    os.kill(os.getpid(), 9)
os.wait()
simplefilter("ignore")
run = Run.open(folder)
total = sum(float(piece.column("b").sum()) for piece in run.pieces(["b"]))
assert len(run) > rows - 10 * step and total == len(run) * (len(run) - 1) / 2, len(run)
print(json.dumps(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000))
"""


def interrupted(folder: Path, rows: int) -> float:
    """Largest resident memory, MB, of a process that reads `rows` rows of a killed one."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(folder), str(rows)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return float(json.loads(done.stdout))


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
@pytest.mark.timeout(1800)
def test_commands_take_no_more_memory_for_more_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are read in pieces of 8 MB; the four columns of the longer one have 64 MB more.

    Read as wholes, they take 300 to 470 MB more, and the tables of `compare` 140.
    """
    monkeypatch.chdir(tmp_path)
    commands = ["run", "report", "diff", "analyze", "compare"]
    short, long = rows(1_000_000, commands), rows(3_000_000, commands)
    for few, many in zip(short, long, strict=True):
        assert few["exit"] == many["exit"] == 0
        assert many["mb"] - few["mb"] < 60.0, (few, many)


@pytest.mark.slow
def test_an_interrupted_recording_is_read_in_little_memory(tmp_path: Path) -> None:
    """The rows of a process that was killed, 100 MB as whole columns, as its files have them."""
    peaks = [interrupted(tmp_path / str(rows), rows) for rows in (100_000, 4_000_000)]
    assert peaks[1] - peaks[0] < 60.0, peaks


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_long_recording_is_read_in_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """10^7 rows, which take 240 MB as whole columns, and more in sums over them.

    With 42 signals each, their row groups alone would take 50 MB in whoever reads them.
    """
    monkeypatch.chdir(tmp_path)
    commands = ["run", "report", "png", "show", "diff", "analyze", "mat", "csv", "parquet"]
    commands += ["arms", "arms-report", "arms-show", "arms-diff", "arms-parquet"]
    for row in rows(10_000_000, commands):
        assert row["exit"] == 0
        assert 30 < row["mb"] < GOAL, row
