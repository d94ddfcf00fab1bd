"""The benchmark of parts runs, and its tables are equal."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from tests.system.runs import ROOT


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("parallel") is None, reason="needs GNU parallel")
def test_parts_and_one_sweep_give_the_same_table() -> None:
    arguments = ["--runs", "8", "--parts", "2", "--rounds", "1", "--stop", "2"]
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks/parts.py", *arguments],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "tables: the same bytes" in done.stdout
