"""Runs whose process is ended from outside or by a component: no recorded data is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest

from cosim.base.errors import CutShort
from cosim.links.storage import load_table
from cosim.record import Run
from tests.cli.command import CONFIG, ROOT, Command, finished, started
from tests.tiers import first_fast

#: A component that ends its own process at t = 1.5 s; `how`: see the component.
ENDS = """
[run]
step = 0.001
stop = 2
[components.x]
model = "tests.cosim.blocks:Integrator"
inputs.u = "end.y"
[components.end]
model = "tests.cli.components:Ends"
parameters = {{ how = {} }}
inputs.u = "x.y"
"""


def killed(process: subprocess.Popen[str], folder: Path, size: int) -> None:
    """Kill a run once it has written `size` bytes of row groups."""
    part = folder / "trajectories.parquet.part"
    try:
        for _ in range(6000):
            if part.is_file() and part.stat().st_size > size:
                break
            assert process.poll() is None, process.communicate()
            sleep(0.01)
    finally:
        process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL


def test_kill_9_loses_no_row_of_any_file(cosim: Command, tmp_path: Path) -> None:
    """Row groups, the group that was being filled and the engine's chunk fit together."""
    process = started("run", CONFIG, "--set", "run.stop=4000", "--out", "here", cwd=tmp_path)
    killed(process, tmp_path / "here", 5_000_000)
    here = tmp_path / "here"
    assert not (here / "trajectories.parquet").exists()
    with pytest.warns(CutShort, match="was interrupted; it is recorded until t = "):
        found = Run.open(here)
    assert len(found) > 3 * 16384
    assert np.array_equal(found.t, np.arange(len(found)) * 1e-3)
    stop = f"run.stop={found.t[-1]:.3f}"
    cosim("run", CONFIG, "--set", stop, "--out", "whole", "--no-plot")
    whole = Run.open(tmp_path / "whole")
    for name in whole.names:  # the last row of a run is what its last step left
        assert np.array_equal(found.column(name)[:-1], whole.column(name)[:-1])
    for link, path in found.link_tables.items():
        rows = load_table(whole.link_tables[link])[1]
        assert np.array_equal(load_table(path)[1][: rows.size], rows)


def test_recover_completes_the_folder(cosim: Command, tmp_path: Path) -> None:
    process = started("run", CONFIG, "--set", "run.stop=4000", "--out", "here", cwd=tmp_path)
    killed(process, tmp_path / "here", 2_000_000)
    here = tmp_path / "here"
    assert json.loads((here / "run.json").read_text())["status"] == "running"
    with pytest.warns(CutShort):
        before = Run.open(here)
    said = cosim("report", here, "--recover")
    assert said.out.strip() == f"recorded until t = {before.t[-1]:.6g} s", said
    left = sorted(str(p.relative_to(here)) for p in here.rglob("*") if p.is_file())
    assert [p for p in left if not p.startswith("links")] == [
        "last.parquet", "run.json", "trajectories.parquet",
    ]  # fmt: skip
    assert [Path(p).suffix for p in left if p.startswith("links")] == [".parquet"] * 2
    after = Run.open(here)
    assert all(np.array_equal(before.column(n), after.column(n)) for n in ("t", *before.names))
    assert after.metadata["status"] == "recovered"
    last = Run.open(here / "last.parquet")
    assert last.t[-1] == after.t[-1] and len(last) >= 1000
    assert "master_control.w[0]" in last.names
    assert "complete" in cosim("report", here, "--recover").out


@pytest.mark.parametrize(
    ("how", "said"),
    first_fast(
        [
            (0, "a component or a library ended the process of this command (exit code 0)"),
            (2, "ended by SIGSEGV (a component crashed; isolate = true tells which FMU does)"),
            (1, "ended by SIGABRT (a component crashed; "),
            (3, "ended by SIGKILL"),
        ],
        2,
    ),
)
def test_a_component_cannot_end_or_fake_a_run(tmp_path: Path, how: int, said: str) -> None:
    (tmp_path / "ends.toml").write_text(ENDS.format(how), encoding="utf-8")
    done = finished("run", "ends.toml", "--out", "here", cwd=tmp_path)
    assert done.code == 1
    first, second = done.err.splitlines()
    assert first.startswith("error: ") and said in first
    assert second.startswith("recorded until t = 1.499 s: ")
    run = Run.open(tmp_path / "here")
    assert np.array_equal(run.t, np.arange(1500) * 1e-3)
    assert run.metadata["status"] == "recovered"
    assert said in run.metadata["error"]


@pytest.mark.parametrize("command", ["check", "show", "run"])
def test_a_component_cannot_fake_what_only_loads_it(tmp_path: Path, command: str) -> None:
    text = ENDS.format(0).replace("components:Ends", "components:Gone")
    (tmp_path / "ends.toml").write_text(text, encoding="utf-8")
    done = finished(command, "ends.toml", cwd=tmp_path)
    assert done.code == 1
    assert (
        done.err
        == "error: a component or a library ended the process of this command (exit code 0)\n"
    )


def test_a_question_is_asked_and_answered_on_the_terminal(tmp_path: Path) -> None:
    """The command works in the background of its terminal, where reading would stop it."""
    answered = ROOT / "tests" / "cli" / "answered.py"
    done = subprocess.run(
        [sys.executable, str(answered)], cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.split()[-2:] == ["answer=yes", "code=0"], done


def test_when_the_supervisor_is_killed_the_run_ends_too(tmp_path: Path) -> None:
    process = started("run", CONFIG, "--set", "run.stop=1e6", "--out", "here", cwd=tmp_path)
    killed(process, tmp_path / "here", 1000)
    for _ in range(500):
        try:
            with pytest.warns(CutShort, match="was interrupted"):
                Run.open(tmp_path / "here")
            return
        except pytest.fail.Exception:
            sleep(0.01)  # the kernel has not ended the other process yet
    pytest.fail(f"the run goes on: {os.listdir(tmp_path / 'here')}")
