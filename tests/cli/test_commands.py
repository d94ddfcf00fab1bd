"""The list of commands, and what a command imports."""

from __future__ import annotations

import gc
import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.base.parts import part
from cosim.cli import main
from cosim.cli.commands import function
from cosim.cli.overview import ALIASES, COMMANDS, GROUPS, MORE
from tests.cli.command import CALL, Command

ROOT = Path(__file__).parents[2]
TELEOPERATION = ROOT / "configs" / "teleoperation.toml"
SAYS = """
import sys
before = set(sys.modules)
from cosim.cli import _command, main
try:
    main() if "--help" in sys.argv else _command()  # others have a process of their own
finally:
    print(*(set(sys.modules) - before), file=sys.stderr)
"""


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_says_of_a_command_what_its_own_help_says(name: str) -> None:
    text = inspect.getdoc(function(name))
    assert text and text.splitlines()[0] == COMMANDS[name]


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"]])
def test_every_command_is_listed_with_its_line(words: list[str]) -> None:
    done = subprocess.run(
        [*CALL, *words],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"COLUMNS": "80"},
    )
    assert done.returncode == (0 if words else 2)
    assert max(map(len, done.stdout.splitlines())) <= 80
    listed = " ".join(done.stdout.split())
    first = {name: line for group in GROUPS.values() for name, line in group.items()}
    assert len(first) <= 16  # a page
    assert all(f"{name} {line}" in listed for name, line in first.items())
    for title, group in MORE.items():
        assert f"{title} {', '.join(group)}" in listed


@pytest.mark.parametrize("name", ALIASES)
def test_an_earlier_name_is_the_command_with_an_option(name: str, cosim: Command) -> None:
    command, option = ALIASES[name]
    now = cosim(command, option, "nowhere")
    assert now.code == 2
    assert (cosim(name, "nowhere").code, cosim(name, "nowhere").err) == (2, now.err)
    assert option in cosim(name, "--help").out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--at", "1"], "expected --linear with them"),
        (["--linear", "--port", "master"], "options of a port besides --linear"),
    ],
)
def test_options_of_a_port_and_a_linear_model_exclude_each_other(
    words: list[str], said: str, cosim: Command
) -> None:
    assert said in cosim.refused("analyze", TELEOPERATION, *words)


@pytest.mark.parametrize(
    ("words", "most", "without"),
    [
        (
            ["--help"],
            20,
            {"typer", "numpy", "rich", "markdown_it", "pydantic", "matplotlib", "pandas"},
        ),
        (
            ["check", TELEOPERATION],
            460,
            {"pyarrow", "numpy.ma", "matplotlib", "pandas", "rich", "pydantic"},
        ),
        (
            ["run", TELEOPERATION, "--no-plot", "--out"],
            424,
            {"matplotlib", "numpy.ma", "pandas", "rich", "pydantic", "cosim.links.distributions"},
        ),
    ],
)
def test_a_command_imports_what_it_needs(
    tmp_path: Path, words: list[str], most: int, without: set[str]
) -> None:
    """Imports are counted, not seconds, and not what the environment makes Python import."""
    words = [*map(str, words), *([str(tmp_path / "run")] if words[-1] == "--out" else [])]
    done = subprocess.run(
        [sys.executable, "-c", SAYS, *words], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    modules = set(done.stderr.splitlines()[-1].split())
    assert not modules & without
    assert len(modules) <= most


@pytest.mark.parametrize(("before", "expected"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "4"}, "4")])
def test_a_command_has_one_thread_of_linear_algebra_unless_the_environment_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, before: dict[str, str], expected: str
) -> None:
    """A second thread of OpenBLAS waits busily from the import of NumPy on."""
    found = []
    monkeypatch.setattr(os, "environ", dict(before))
    monkeypatch.setattr(sys, "argv", ["cosim", "info"])
    monkeypatch.setattr(
        "cosim.cli.supervise.supervised",
        lambda _: found.append((os.environ["OPENBLAS_NUM_THREADS"], gc.get_threshold()[0])) or 0,
    )
    monkeypatch.setattr("cosim.cli.supervise.end", sys.exit)
    thresholds = gc.get_threshold()
    gc.set_threshold(700)
    try:
        with pytest.raises(SystemExit) as ended:
            main()
    finally:
        gc.set_threshold(*thresholds)
    assert ended.value.code == 0
    [(threads, new_objects)] = found
    assert threads == expected
    assert new_objects > 10_000  # or imports are searched for garbage dozens of times


@pytest.mark.parametrize("words", [["greet", "--help"], ["completion", "bash"]])
def test_another_distribution_adds_a_command(words: list[str], tmp_path: Path) -> None:
    """Its entry point and a module are all that it takes; they are found where Python finds it."""
    (tmp_path / "greeting.py").write_text('def greet() -> None:\n    """Say hello."""\n')
    facts = tmp_path / "greeting-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: greeting\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[cosim.commands]\ngreet = greeting:greet\n")
    done = subprocess.run(
        [*CALL, *words],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    assert ("Say hello." if words[0] == "greet" else " completion greet") in done.stdout


def test_a_part_that_is_not_installed_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"no installed part 'twins'; did you mean 'twin'\?"):
        part("twins")
