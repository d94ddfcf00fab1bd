"""Every example runs, and prints the output in its README (except for wall times)."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.runs import CONFIG, ROOT

EXAMPLES = ROOT / "examples"
README = (EXAMPLES / "README.md").read_text(encoding="utf-8")
COSIM = [sys.executable, "-c", "from cosim.cli import main; main()"]


def called(*command: str | Path, cwd: Path) -> list[str]:
    """Lines a command prints."""
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return [steady(line) for line in done.stdout.splitlines()]


def promised(name: str) -> list[str]:
    """Lines the README says it prints."""
    found = re.search(rf"<!-- {name} -->\n```text\n(.*?)\n```\n<!-- end -->", README, re.DOTALL)
    assert found, f"examples/README.md says nothing about {name}"
    return [steady(line) for line in found[1].splitlines()]


def steady(line: str) -> str:
    """A line without what differs from one run to the next."""
    return re.sub(r"^(wall time +).*", r"\1", line)


@pytest.fixture
def examples(tmp_path: Path) -> Path:
    """A copy to run in."""
    shutil.copytree(EXAMPLES, tmp_path / "examples", ignore=shutil.ignore_patterns("out", "__py*"))
    return tmp_path / "examples"


def test_own_controller(examples: Path) -> None:
    folder = examples / "own_controller"
    printed = called(*COSIM, "run", "scenario.toml", "--out", "out", cwd=folder)
    assert printed == promised("own_controller")
    assert (folder / "out" / "report.html").is_file()


@pytest.mark.parametrize(
    "changes",
    [
        ["components.control.parameters.k_d=4"],
        ["components.control.period=20 ms"],
        ["links.0.semantics=fifo", "links.1.semantics=fifo"],
    ],
    ids=lambda changes: changes[0],
)
def test_own_controller_with_the_changes_of_the_readme(examples: Path, changes: list[str]) -> None:
    written = README.replace('"', "")
    assert all(f"--set {change}" in written for change in changes)
    settings = [part for change in changes for part in ("--set", change)]
    folder = examples / "own_controller"
    printed = called(*COSIM, "run", "scenario.toml", *settings, "--no-plot", cwd=folder)
    assert printed != promised("own_controller")


def test_policy(examples: Path) -> None:
    folder = examples / "policy"
    assert called(*COSIM, "run", "policy.toml", "--out", "out", cwd=folder) == promised("policy")


def test_the_page_on_components_has_the_settling_times_of_the_policy(examples: Path) -> None:
    page = (ROOT / "docs/own-component.md").read_text(encoding="utf-8")
    for compute, words in (
        ("0", "after 2.1 s"),
        ("150 ms", "after 4.0 s"),
        ("300 ms", "not within"),
    ):
        change = f"components.policy.compute={compute}"
        command = [*COSIM, "run", "policy.toml", "--no-plot", "--set", change]
        printed = called(*command, "--out", compute, cwd=examples / "policy")
        (settled,) = [line for line in printed if line.startswith("settled")]
        found = re.search(r"after ([\d.]+) s", settled)
        row = f"after {float(found[1]):.1f} s" if found else "not within"
        assert row == words
        assert re.search(rf"^\| {compute}[^|]*\| {words}", page, re.MULTILINE)


def test_own_controller_is_shown(examples: Path) -> None:
    printed = called(*COSIM, "show", "scenario.toml", cwd=examples / "own_controller")
    assert any("controller:PD, Python call-back" in line for line in printed)


def test_the_controller_is_twenty_lines() -> None:
    source = (EXAMPLES / "own_controller" / "controller.py").read_text(encoding="utf-8")
    lines = [line.strip() for line in source.split("class PD:\n")[1].splitlines()]
    assert len([line for line in lines if line and not line.startswith('"""')]) <= 20


def test_plot_run(examples: Path) -> None:
    folder = examples.parent
    arguments = ("--out", "runs/example", "--no-plot", "--quiet")
    called(*COSIM, "run", CONFIG, *arguments, cwd=folder)
    printed = called(sys.executable, examples / "plot_run.py", "runs/example", cwd=folder)
    assert printed == promised("plot_run")
    assert (folder / "runs" / "example" / "sync.png").is_file()
