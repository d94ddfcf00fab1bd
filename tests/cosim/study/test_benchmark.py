"""The benchmark of sweeps runs. No times are evaluated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cosim.study.studies import ROOT


@pytest.mark.slow
def test_the_benchmark_runs(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "sweep.py"), "--quick", "--json", "found"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=120)
    found = json.loads((tmp_path / "found").read_text())
    assert [(r["runs"], r["failed"]) for r in found["sweeps"]] == [(6, 0)] * 4


@pytest.mark.slow
def test_one_large_sweep(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / "sweep.py"), "--quick", "--large"]
    subprocess.run([*command, "--json", "found"], cwd=tmp_path, check=True, timeout=120)
    found = json.loads((tmp_path / "found").read_text())["large"]
    assert found["runs"] == 6
    assert found["cpu"] > 0
