"""A component that calls exit(0) ends no command of the bridge as if all were well."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.record import Run, verify
from tests.bridge.deployments import one_node, written
from tests.cli.command import CONFIG, Done, finished

ENDS = tuple(f"components.master_control.parameters.{x}=1" for x in ("t_bad", "ends"))
CHANGES = ('components.master_control.model="tests.bridge.laws:Law"', *ENDS, "run.stop=3")
SETS = tuple(word for change in CHANGES for word in ("--set", change))
SAID = "error: a component or a library ended the process of this command (exit code 0)"


def left(done: Done, folder: Path) -> Run:
    """The folder of a command that was ended; what it said of it is checked."""
    assert done.code == 1, done
    assert SAID in done.err.splitlines()
    assert "recorded until t = " in done.err
    run = Run.open(folder)
    assert run.metadata["status"] == "recovered"
    assert "exit code 0" in run.metadata["error"]
    return run


def test_exit_0_within_a_twin(tmp_path: Path) -> None:
    done = finished(
        "run", CONFIG, "--deploy", "can", "--no-plot", *SETS, "--out", "here", cwd=tmp_path
    )
    assert left(done, tmp_path / "here").t[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_exit_0_within_a_rehearsal_in_one_process(tmp_path: Path) -> None:
    words = ("rehearse", CONFIG, "-i", "virtual", "--no-plot", "--no-realtime", *SETS)
    assert left(finished(*words, "--out", "here", cwd=tmp_path), tmp_path / "here").t[-1] >= 0.9


@pytest.mark.slow
def test_exit_0_within_a_node_alone(tmp_path: Path) -> None:
    """Everything in one node, which needs nobody; then the same node to its end."""
    parts = ("master", "slave", "master_control", "slave_control")
    deployment = written(one_node(list(parts)), tmp_path)
    words = ("node", CONFIG, "--deploy", deployment, "--node", "all", "--now", "-i", "virtual")
    done = finished(*words, *SETS, "--out", "here", cwd=tmp_path)
    assert left(done, tmp_path / "here").t[-1] >= 0.9
    done = finished(*words, "--set", "run.stop=1", "--out", "here", cwd=tmp_path)
    assert done.code == 0, done
    run = Run.open(tmp_path / "here")
    assert run.metadata["status"] == "finished" and len(run) == 1000
    verify(tmp_path / "here")
