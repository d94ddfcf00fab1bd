"""Tests of the simulated bus once more, with AddressSanitizer and UndefinedBehaviorSanitizer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz import sanitized
from tests.fuzz.targets import ROOT

SOURCES = ROOT / "cosim" / "c" / "bus"
FOLDER = ROOT / "tests" / "cosim" / "bus"
TESTS = (
    FOLDER / "test_simulation.py",
    FOLDER / "test_wires.py",
    FOLDER / "test_clock.py",
    FOLDER / "test_counters_at_start.py",
    FOLDER.with_name("scenario") / "test_bus_ticks.py",
)


@pytest.mark.slow
@pytest.mark.skipif(bool(sanitized.missing()), reason=sanitized.missing())
def test_no_access_is_outside_the_memory_given(tmp_path: Path) -> None:
    """Every array of settings is an allocation of its own, and so is the memory of the bus."""
    library = tmp_path / "bus.so"
    sources = sorted(map(str, SOURCES.glob("*.c")))
    subprocess.run(["gcc", *sanitized.FLAGS, "-o", str(library), *sources, "-lm"], check=True)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "tests.cosim.bus.sanitized_library"]
    words += ["-p", "no:cacheprovider", f"--basetemp={tmp_path / 'inner'}"]
    words += map(str, TESTS)
    environment = {**os.environ, **sanitized.preloaded(), "SANITIZED_BUS": str(library)}
    found = subprocess.run(words, cwd=ROOT, env=environment, text=True, capture_output=True)
    assert found.returncode == 0, found.stdout[-4000:] + found.stderr[-4000:]
