"""The line that says how much memory and how many files a process of tests has at its end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests import footprint

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def test_open_files_are_counted_by_kind(tmp_path):
    before = footprint.open_files()
    files = [(tmp_path / f"{n}.ring").open("wb") for n in range(3)]
    ends = os.pipe()
    try:
        more = footprint.open_files()
    finally:
        for file in files:
            file.close()
        for end in ends:
            os.close(end)
    assert more - before == {".ring": 3, "pipe": 2}
    assert footprint.open_files() == before


def test_memory_is_told_as_it_is_and_at_its_most():
    """A process of its own: 64 MiB that it had for a while are in its peak only."""
    program = """
from tests.footprint import measured
first, held = measured(), bytearray(b"x") * (64 << 20)
second = measured()
del held
third = measured()
assert 60 <= second["now"] - first["now"] <= 80, (first, second)
assert third["now"] < second["now"] - 50 and third["peak"] >= second["now"], (second, third)
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_processes_of_xdist_are_printed_by_the_one_that_reports():
    plugin, said = footprint.Footprint(), []
    small = {"now": 200, "peak": 300, "files": {"pipe": 5, ".so": 2}}
    for name, found in (("gw1", {**small, "now": 700}), ("gw0", small)):
        node = SimpleNamespace(workeroutput={"footprint": found}, gateway=SimpleNamespace(id=name))
        plugin.pytest_testnodedown(node)
    plugin.pytest_testnodedown(SimpleNamespace())  # one that crashed
    plugin.pytest_terminal_summary(SimpleNamespace(write_line=said.append))
    assert said == [
        "gw0: 200 MiB at the end, 300 at most, 7 open files (5 pipe, 2 .so)",
        "gw1: 700 MiB at the end, 300 at most, 7 open files (5 pipe, 2 .so) (too large)",
    ]


def test_the_line_is_at_the_end_of_a_run(tmp_path):
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        f"--basetemp={tmp_path}",
    ]
    done = subprocess.run(
        [*command, "-n", "1", f"{Path(__file__)}::test_open_files_are_counted_by_kind"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert "gw0: " in done.stdout and " MiB at the end, " in done.stdout
