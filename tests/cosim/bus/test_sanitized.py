"""Tests of the simulated bus once more, with AddressSanitizer and UndefinedBehaviorSanitizer."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.bus import shared
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
@pytest.mark.timeout(1800)
@pytest.mark.skipif(bool(sanitized.missing()), reason=sanitized.missing())
def test_no_access_is_outside_the_memory_given(tmp_path: Path) -> None:
    """Every array of settings is an allocation of its own, and so is the memory of the bus."""
    library = sanitized.compiled(sorted(SOURCES.glob("*.c")), tmp_path)
    assert not sanitized.failure(library, shared.__name__, TESTS, tmp_path)
