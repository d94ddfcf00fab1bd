"""The programs of the page on sweeps for Slurm and Kubernetes, as far as they run without these."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.cli.command import CALL, Command
from tests.cosim.study.studies import ROOT, STUDY, written
from tests.cosim.study.test_sweep import table

PAGE = (ROOT / "docs" / "sweep.md").read_text(encoding="utf-8")


def program(word: str) -> str:
    (found,) = (p for p in re.findall(r"```python\n(.*?)```", PAGE, re.S) if word in p)
    return str(found)


def has(*names: str) -> bool:
    return all(importlib.util.find_spec(name) for name in names)


@pytest.mark.slow
@pytest.mark.skipif(not has("distributed", "dask_jobqueue"), reason="needs dask-jobqueue")
def test_the_program_for_slurm(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.local import LocalCluster

    scripts = []
    here = {"scheduler_options": {"host": "127.0.0.1:0", "dashboard_address": None}}

    def queue(**given: Any) -> Any:
        with SLURMCluster(**given, **here) as slurm:
            scripts.append(slurm.job_script())
        return LocalCluster(cores=2, processes=2, memory="1 GB", **here)

    def run(command: list[str], *, check: bool) -> None:
        assert command[0] == "cosim"
        subprocess.run([*CALL, *command[1:], "--no-plot"], cwd=tmp_path, check=check)

    module = ModuleType("dask_jobqueue")
    module.SLURMCluster = queue  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "dask_jobqueue", module)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # of the workers, for the components of the test
    text = program("SLURMCluster").replace("subprocess.run(", "run(")
    written(tmp_path, STUDY + "values = [1, 10, 150, 205, 1500]\n")
    exec(text, {"run": run})
    (script,) = scripts
    assert "#SBATCH -p main" in script and "#SBATCH -t 02:00:00" in script
    assert "--nworkers 32" in script and "--nthreads 1" in script
    assert "source ~/cosim/bin/activate" in script
    cosim("sweep", "study.toml", "--workers", "threads", "--out", "here", "--no-plot")
    a, b = (table(tmp_path / x) for x in ("runs/study", "here"))
    assert repr([{**r, "wall": 0} for r in a]) == repr([{**r, "wall": 0} for r in b])


@pytest.mark.slow  # its package is among the oracles, which only slow tests need
@pytest.mark.skipif(not has("distributed", "dask_kubernetes"), reason="needs dask-kubernetes")
def test_the_resource_for_kubernetes() -> None:
    from dask_kubernetes.operator import make_cluster_spec

    text = program("KubeCluster").split("with KubeCluster")[0]
    found: dict[str, Any] = {"make_cluster_spec": make_cluster_spec}
    exec(text, found)
    spec = found["spec"]["spec"]
    (worker,) = spec["worker"]["spec"]["containers"]
    assert worker["args"][:4] == ["dask", "worker", "--nthreads", "1"]
    assert spec["worker"]["replicas"] == 50
    assert spec["scheduler"]["spec"]["containers"][0]["args"][:2] == ["dask", "scheduler"]
