"""Commands without the modules that not every installation or system has."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cosim.base import extras
from cosim.base.errors import ScenarioError
from tests.cli.command import CONFIG, ROOT, Command

STUDY = f"""
title = "One run"
scenario = "{CONFIG.as_posix()}"
settings = ["run.stop='0.1 s'"]
[vary.lambda_M]
paths = ["components.master_control.parameters.lambda_M"]
values = [1.0]
[figures.stable]
kind = "line"
x = "lambda_M"
y = "stable"
"""
#: Modules that Python has on Linux and macOS and not on Windows, or on Linux only.
OF_POSIX = "fcntl grp pty pwd resource syslog termios tty"
OF_EXTRAS = "PIL matplotlib"
#: The command of the arguments behind the first two: the system, and modules that are missing.
PROGRAM = """
import os, select, sys
from types import SimpleNamespace

system, missing, sys.argv = sys.argv[1], set(sys.argv[2].split()), ["cosim", *sys.argv[3:]]

for name in missing:
    sys.modules[name] = None  # neither imported nor found
for name in ("epoll", "poll"):
    delattr(select, name)
for name in [n for n in vars(os) if n.startswith("sched_") or n == "posix_fallocate"]:
    delattr(os, name)

import cosim.cli.commands, cosim.cli.supervise as supervise
import cosim.record.folder as folder, cosim.record.live as live

for module in (folder, live, supervise):
    module.sys = SimpleNamespace(**{**vars(sys), "platform": system})
cosim.cli.commands.command()
"""


def called(system: str, missing: str, *words: str | Path, at: Path) -> subprocess.CompletedProcess:
    """A command on what stands for another system; only sizes of files and locks differ there."""
    call = [sys.executable, "-c", PROGRAM, system, missing, *map(str, words)]
    return subprocess.run(call, cwd=at, capture_output=True, text=True)


@pytest.mark.parametrize("system", ["win32", "darwin"])
@pytest.mark.parametrize("words", [
    ("run", CONFIG, "--stop", "0.1", "-q"),
    ("check", CONFIG),
    ("info", ROOT / "fmus" / "_built" / "planar2r.fmi2.fmu"),
    ("analyze", CONFIG, "--set", "run.stop=0.1", "--no-tests"),
    ("compare", CONFIG, "--controllers", "pd", "--set", "run.stop=1", "--jobs", "1", "-q"),
    ("sweep", "study.toml", "--workers", "threads", "-q"),
])  # fmt: skip
def test_offline_runs_need_neither_linux_nor_an_extra(
    tmp_path: Path, system: str, words: tuple[str | Path, ...]
) -> None:
    missing = OF_EXTRAS + (f" {OF_POSIX}" if system == "win32" else "")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    done = called(system, missing, *words, at=tmp_path)
    assert done.returncode == 0, done.stderr
    if words[0] in ("run", "compare", "sweep"):
        (report,) = tmp_path.glob("runs/*/report.html")
        assert "</html>" in report.read_text(encoding="utf-8")


DRAWING = [
    ("run", CONFIG, "--png"),
    ("run", CONFIG, "--pdf"),
    ("rehearse", CONFIG, "--png"),
    ("sweep", "study.toml", "--png"),
    ("compare", CONFIG, "--png"),
    ("analyze", CONFIG, "--png"),
    ("report", "runs", "--pdf"),
    ("show", CONFIG, "--bus", "can0", "--picture", "bus.png"),
    ("bus", "--picture", "bus.png"),
    ("monitor", "runs", "--plot", "a.png"),
    ("reproduce",),
]


@pytest.mark.parametrize("words", DRAWING, ids=lambda words: " ".join(map(str, words[::2])))
def test_figures_without_matplotlib_are_refused_before_any_work(
    cosim: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str | Path, ...]
) -> None:
    monkeypatch.setattr("cosim.base.extras.find_spec", lambda name: None)
    said = cosim.refused(*words)
    assert said.count("\n") <= 1 and "pip install 'cosim-bridge[figures]'" in said
    assert not list(tmp_path.iterdir())


def test_what_reproduce_does_without_figures_needs_no_matplotlib(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.base.extras.find_spec", lambda name: None)
    assert cosim("reproduce", "--only", "o1", "--out", "here", "-q").code == 0


def test_a_picture_of_the_interface_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    from cosim.reporting import figures

    monkeypatch.setattr("cosim.base.extras.find_spec", lambda name: None)
    with pytest.raises(ScenarioError, match=r"cosim-bridge\[figures\]"):
        figures.load()


def test_extras_have_what_their_sentences_say() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    names = {"PIL": "pillow"}
    always = [text.partition(">")[0] for text in project["dependencies"]]
    test = [text.partition(">")[0] for text in optional["test"]]
    for library, (extra, _) in extras._EXTRAS.items():
        name = names.get(library, library)
        assert name in [text.partition(">")[0] for text in optional[extra]]
        assert name in test and name not in always
