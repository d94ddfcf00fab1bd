"""Files of the working directory that are called like a module: only a user's own are imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.base.python import python_call
from tests.cli.command import CALL, ROOT

#: Of Python, of libraries, and ours.
HIDDEN = ("queue", "json", "struct", "socket", "numpy", "can", "msgspec", "typer", "pyarrow")
PACKAGES = ("cosim", "bridge", "fmus")
REFUSES = 'raise RuntimeError("of the working directory")\n'
OTHERS = ("bridge.rehearsal.babbler", "bridge.node.start", "bridge.relay")


@pytest.fixture
def crowded(tmp_path: Path) -> Path:
    """A folder in which everything has a name that is taken, and a component of the user's own."""
    for name in HIDDEN:
        (tmp_path / f"{name}.py").write_text(REFUSES)
    for name in PACKAGES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(REFUSES)
    (tmp_path / "own.py").write_text("from tests.cosim.blocks import Gain\nclass Own(Gain): pass\n")
    (tmp_path / "own.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1\n[components.own]\nmodel = "own:Own"\nstart.u = 1\n'
        '[components.arm]\nmodel = "fmus.models.planar2r"\nisolate = true\n'
    )
    return tmp_path


def test_a_run_imports_only_the_users_own_module(crowded: Path) -> None:
    call = [sys.executable, "-P", *CALL[1:], "run", "own.toml", "--out", "here", "--no-plot"]
    paths = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(call, cwd=crowded, env=paths, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "of the working directory" not in done.stderr


@pytest.mark.parametrize("module", OTHERS)
def test_other_processes_of_ours_do_not_either(crowded: Path, module: str) -> None:
    call = python_call(module, "--help")
    done = subprocess.run(call, cwd=crowded, capture_output=True, text=True, timeout=60)
    assert "of the working directory" not in done.stderr


def test_as_a_module_of_python(crowded: Path) -> None:
    """Python itself puts the working directory first there, which `-P` prevents."""
    call = [sys.executable, "-P", "-m", "cosim", "--version"]
    done = subprocess.run(call, cwd=crowded, capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("cosim "), done.stderr


WANDERS = """
import os
from tests.cosim.blocks import Gain

WHERE = "{where}"
if WHERE == "import":
    os.chdir("/")

class Own(Gain):
    def __init__(self, **words):
        super().__init__(**words)
        if WHERE == "made":
            os.chdir("/")

    def step(self, t, h, u):
        if WHERE == "step":
            os.chdir("/")
        return super().step(t, h, u)
"""


@pytest.mark.parametrize("where", ["import", "made", "step"])
def test_a_component_that_changes_the_directory_does_not_move_results(
    crowded: Path, where: str
) -> None:
    (crowded / "own.py").write_text(WANDERS.format(where=where))
    program = (
        "import os, sys; sys.path.append('.'); import cosim; cosim.run('own.toml', out='here');"
        "print(os.getcwd())"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=crowded, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip
    assert done.stdout.strip() == str(crowded), done.stderr
    assert (crowded / "here" / "trajectories.parquet").is_file()
