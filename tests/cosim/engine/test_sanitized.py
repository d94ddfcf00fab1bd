"""Tests of the engine once more, with AddressSanitizer and UndefinedBehaviorSanitizer."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.native import shared
from tests.fuzz import sanitized
from tests.fuzz.targets import ROOT

SOURCES = ROOT / "cosim" / "c"
FOLDER = ROOT / "tests" / "cosim"
TESTS = (
    FOLDER / "engine" / "test_engine.py",
    FOLDER / "engine" / "test_many_signals.py",
    FOLDER / "engine" / "test_plain_steps.py",
    FOLDER / "engine" / "test_threads.py",
    FOLDER / "algorithms" / "test_adaptive.py",
    FOLDER / "algorithms" / "test_extrapolation.py",
    FOLDER / "fmi" / "test_clocks.py",
    FOLDER / "fmi" / "test_exchange.py",
    FOLDER / "fmi" / "test_isolation.py",
    FOLDER / "fmi" / "test_scheduled.py",
    FOLDER / "fmi" / "test_slopes.py",
    FOLDER / "fmi" / "test_timed_clocks.py",
    FOLDER / "fmi" / "test_types.py",
    FOLDER / "fmi" / "test_within.py",
    FOLDER / "record" / "test_recorder.py",
    FOLDER / "sweeps" / "test_batch.py",
)


pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(bool(sanitized.missing()), reason=sanitized.missing()),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sanitized.compiled(sorted(SOURCES.glob("*.c")), tmp_path_factory.mktemp("engine"))


@pytest.mark.parametrize("tests", TESTS, ids=lambda path: path.stem)
def test_no_access_is_outside_the_memory_given(library: Path, tests: Path, tmp_path: Path) -> None:
    """Units, links, clocks and the vector of signals are allocations of their own."""
    assert not sanitized.failure(library, shared.__name__, [tests], tmp_path)
