"""A Dask scheduler in place of this machine's processes."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from tests.cli.command import Command
from tests.cosim.study.studies import STUDY, written
from tests.cosim.study.test_sweep import table

GRID = STUDY + "values = [1, 10, 150, 205, 1500]\n"


def test_without_dask_it_is_said_what_to_install(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    study = written(tmp_path, GRID)
    assert "pip install 'cosim-bridge[cluster]'" in cosim.refused(
        "sweep", study, "--scheduler", "tcp://localhost:1"
    )


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs cluster extra")
def test_a_cluster_gives_what_this_machine_gives(cosim: Command, tmp_path: Path) -> None:
    from distributed import LocalCluster

    study = written(tmp_path, GRID)
    cosim("sweep", study, "--workers", "threads", "--out", "a", "--no-plot")
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        address = cluster.scheduler_address
        done = cosim("sweep", study, "--scheduler", address, "--out", "b", "--no-plot")
    assert done.code == 0, done
    a, b = ([{**r, "wall": 0} for r in table(tmp_path / x)] for x in "ab")
    assert repr(a) == repr(b)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs cluster extra")
def test_a_scheduler_that_does_not_answer(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.study.workers.PATIENCE", 1.0)
    study = written(tmp_path, GRID)
    said = cosim.refused("sweep", study, "--scheduler", "tcp://127.0.0.1:9", code=1)
    assert said.startswith("no scheduler answers at tcp://127.0.0.1:9")
