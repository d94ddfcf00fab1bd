"""The plug-in of pytest, in tests of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree
from zlib import crc32

import pytest

from bridge.testing.case import file_name
from tests.bridge.testing import loaded
from tests.cli.command import CALL

pytest_plugins = ["pytester"]
loaded.all_that_runs_use()

#: A component, and a scenario of it, as a user has them next to a test. It moves by chance.
COMPONENT = """\
import time

import numpy as np

from cosim.base.component import Parameter, Port


class Ramp:
    kind = "sampled"
    inputs = (Port("late", (), "m"),)
    outputs = (Port("x", (), "m"),)
    parameters = (Parameter("slope", (1.0,), (), "m/s"), Parameter("wait", (0.0,), (), "s"))

    def initialize(self, values):
        self.slope, self.wait = values.get("slope", 1.0), values.get("wait", 0.0)

    def initial(self, u):
        return {"x": np.float64(0.0)}

    def step(self, t, h, u):
        while self.wait:
            pass
        return {"x": np.float64(self.slope * t)}

    def get_state(self):
        return None

    def set_state(self, state):
        pass
"""
SCENARIO = """\
title = "a ramp"
[run]
step = "1 ms"
stop = "0.1 s"
[components.ramp]
model = "ramp_of_a_test:Ramp"
parameters = { slope = 1.0, wait = 0.0 }
inputs = {}
[[links]]
from = "ramp.x"
to = "ramp.late"
delay = { law = "uniform", low = "1 ms", high = "30 ms" }
"""


@pytest.fixture
def project(pytester, monkeypatch):
    """A folder with a component and a scenario in it; returns pytester."""
    folder = pytester.mkdir("checks")
    (folder / "ramp_of_a_test.py").write_text(COMPONENT)
    (folder / "ramp.toml").write_text(SCENARIO)
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider")
    return pytester


def write(project, text):
    (project.path / "checks" / "test_ramp.py").write_text(text)


PASSES = """\
def test_passes(cosim_run):
    run = cosim_run("ramp.toml")
    assert run.stays_below("ramp.x", "0.2 m")
"""
FAILS = """\
def test_fails(cosim_run):
    run = cosim_run("ramp.toml", set={"components.ramp.parameters.slope": 3.0})
    assert run.stays_below("ramp.x", "0.2 m")
"""


def test_importing_the_plugin_imports_nothing_but_pytest():
    code = (
        "import sys, pytest; before = set(sys.modules); import bridge.testing.plugin\n"
        "print(*(m for m in set(sys.modules) - before if m.split('.')[0] in sys.argv[1:]))"
    )
    heavy = ("cosim", "fmus", "numpy", "pyarrow", "msgspec", "can", "zenoh", "typer")
    done = subprocess.run(
        [sys.executable, "-c", code, *heavy], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_a_failed_test_shows_numbers_seed_and_commands_and_keeps_its_run(project):
    write(project, PASSES + FAILS)
    result = project.runpytest("--cosim-out", "kept", "--junitxml", "junit.xml")
    result.assert_outcomes(passed=1, failed=1)
    name = "checks/test_ramp.py::test_fails"
    seed = crc32(name.encode()) & 0x7FFFFFFF
    text = result.stdout.str()
    assert "the greatest ramp.x is 0.297 m at 99 ms (ramp.x); expected below 0.2 m" in text
    assert f"seed         {seed} (from {name})" in text
    assert f"repeat it    cd {project.path} && pytest {name}" in text
    kept = project.path / "kept" / "checks_test_ramp.py_test_fails"
    assert "<html" in (kept / "run-1" / "report.html").read_text(encoding="utf-8")
    assert [p.name for p in kept.parent.iterdir()] == [kept.name]  # nothing of what passed
    found = properties(project.path / "junit.xml")
    assert found["test_fails"]["cosim.seed"] == str(seed)
    assert found["test_fails"]["cosim.run-1"] == str(kept / "run-1" / "report.html")
    assert found["test_passes"].keys() == {"cosim.seed"}
    # the kept command makes the same bytes
    script = (kept / "repeat.sh").read_text()
    command = re.search(r"^cd (\S+) && cosim (run .*)$", script, re.MULTILINE)
    assert command and str(seed) in command[2]
    done = subprocess.run(
        ["sh", "-c", f'"$@" {command[2]} --out "{project.path}/again" --no-plot', "sh", *CALL],
        cwd=command[1], capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    first, second = kept / "run-1", project.path / "again"
    (link,) = (first / "links").iterdir()
    for file in (first / "trajectories.parquet", link):
        assert file.read_bytes() == (second / file.relative_to(first)).read_bytes()


def properties(junit: Path) -> dict[str, dict[str, str]]:
    return {
        case.attrib["name"]: {p.attrib["name"]: p.attrib["value"] for p in case.iter("property")}
        for case in ElementTree.parse(junit).iter("testcase")
    }


SEEDS = """\
import pytest

@pytest.mark.parametrize("i", range(3))
def test_seeds(cosim_run, i):
    run = cosim_run("ramp.toml")
    assert run.metadata["seed"] < 0, f"seed of {i}: {run.metadata['seed']}"

def test_own_seed(cosim_run):
    assert cosim_run("ramp.toml", set={"run.seed": 7}).metadata["seed"] == 7
"""


def test_seeds_come_from_the_names_of_tests_whoever_runs_them(project):
    write(project, SEEDS)
    wanted = {
        str(i): str(crc32(f"checks/test_ramp.py::test_seeds[{i}]".encode()) & 0x7FFFFFFF)
        for i in range(3)
    }
    result = project.runpytest("-n", "2", "--junitxml", "junit.xml")
    result.assert_outcomes(passed=1, failed=3)
    found = re.findall(r"^E +AssertionError: seed of (\d): (\d+)", result.stdout.str(), re.M)
    assert dict(found) == wanted
    assert "cosim.run-1" in properties(project.path / "junit.xml")["test_seeds[0]"]


REFERENCE = """\
SLOPE = 1.0

def test_as_it_was(cosim_run, reference):
    run = cosim_run("ramp.toml", set={"components.ramp.parameters.slope": SLOPE})
    assert run.is_identical_to(reference(run))
"""


def test_a_reference_is_written_when_asked_for_and_compared_with_otherwise(project):
    write(project, REFERENCE)
    result = project.runpytest()
    result.assert_outcomes(failed=1)
    assert "no reference is kept yet; pytest --cosim-update writes it" in result.stdout.str()
    kept = project.path / "checks" / "references" / "test_ramp" / "test_as_it_was.parquet"
    assert not kept.exists()
    project.runpytest("--cosim-update").assert_outcomes(passed=1)
    project.runpytest().assert_outcomes(passed=1)
    before = kept.read_bytes()
    write(project, REFERENCE.replace("SLOPE = 1.0", "SLOPE = 1.0000001"))
    result = project.runpytest()
    result.assert_outcomes(failed=1)
    assert re.search(r"2 of 2 signals differ .* most of all ramp\.\w+ by 9\.9", result.stdout.str())
    assert kept.read_bytes() == before


STUCK = """\
def test_stuck(cosim_run):
    cosim_run("ramp.toml", set={"components.ramp.parameters.wait": 1.0}, limit="0.3 s")

def test_next(cosim_run):
    assert cosim_run("ramp.toml", limit=30).has_no_faults()
"""


def test_a_run_that_takes_too_long_is_ended_and_the_next_test_runs(project):
    write(project, STUCK)
    result = project.runpytest()
    result.assert_outcomes(passed=1, failed=1)
    text = result.stdout.str()
    assert "TimeLimitError: the run took longer than its limit of 0.3 s: " in text
    assert "ramp" in text.partition("limit of 0.3 s: ")[2].splitlines()[0]  # who was at work
    assert "run-1" in text  # what was recorded until then


MAPPING = """\
import cosim

@cosim.component(inputs={}, outputs={"y": "m"})
def one():
    return {"y": 1.0}

def test_mapping(cosim_run):
    run = cosim_run({"run": {"step": 0.1, "stop": 1}, "components": {"a": {"model": one}}})
    assert run.stays_below("a.y", 0.5)
"""


def test_a_scenario_of_the_test_itself_is_repeated_by_the_test(project):
    write(project, MAPPING)
    text = project.runpytest().stdout.str()
    assert "the greatest a.y is 1 m at 0 s (a.y); expected below 0.5 m" in text
    assert "run-1        made by the test itself" in text


def test_a_place_that_cannot_be_written_does_not_end_the_tests(project):
    write(project, FAILS + PASSES)
    (project.path / "kept").write_text("a file")
    result = project.runpytest("--cosim-out", "kept")
    result.assert_outcomes(passed=1, failed=1)
    assert re.search(r"^not kept: \w+Error: .*kept", result.stdout.str(), re.MULTILINE)


def test_names_of_files_tell_tests_apart():
    names = ["a/t.py::test_x", "a/t.py::test_x[1]", "a/t.py::test_x[a/b]", "a/t.py::test_x[a_b]"]
    files = [file_name(name) for name in names] + [file_name(f"t.py::test_x[{'y' * 999}]")]
    assert files[0] == "a_t.py_test_x" and len(set(files)) == 5
    assert all(re.fullmatch(r"[\w.=+-]{1,140}", name) for name in files)
