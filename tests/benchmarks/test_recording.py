"""What `benchmarks/recording.py` compares are two ways to the same files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.recording import interval, percentile
from benchmarks.recording_work import CONFIG
from cosim.engine.simulate import simulate
from cosim.loading.files import load

ROOT = Path(__file__).parents[2]
IN_MEMORY = """
import sys
from pathlib import Path
from benchmarks import recording_work as recording
from cosim.engine.simulate import simulate
from cosim.record import live
from cosim.loading.files import load

recording.forget()
seen = []
simulate(
    load(recording.CONFIG, ["run.stop=9"]),
    sys.argv[1],
    lambda done, of: seen.extend(p.name for p in Path(sys.argv[1]).rglob("*") if p.is_file()),
)
print(*sorted(set(seen)))
"""


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.parquet")}


def test_a_recording_in_memory_ends_as_the_same_files(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", IN_MEMORY, str(tmp_path / "memory")],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["trajectories.parquet.part"]  # nothing else until the end
    simulate(load(CONFIG, ["run.stop=9"]), tmp_path / "disk")
    assert files(tmp_path / "memory") == files(tmp_path / "disk")
    assert len(files(tmp_path / "disk")) == 3


def test_percentile_and_interval() -> None:
    assert percentile([3.0, 1.0, 2.0], 0.99) == 3.0
    assert percentile(range(100), 0.5) == 50
    low, high = interval(range(101))
    assert (low, high) == (40, 60)
    assert interval([5.0]) == (5.0, 5.0)
    assert low < 50 < high and pytest.approx(50) == (low + high) / 2
