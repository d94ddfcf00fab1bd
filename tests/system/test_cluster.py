"""The examples of a study in parts, by Slurm, Snakemake, GNU parallel and a CI matrix."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.system.runs import ROOT
from tests.system.slurm_cluster import needed, running_slurm

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture
def cluster(tmp_path: Path) -> Path:
    """A copy of the examples with the table of one call, ``whole``; the folder of the study."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    folder = tmp_path / "examples/cluster"
    call(folder, "cosim sweep study.toml --out whole --no-plot --quiet")
    return folder


def call(folder: Path, command: str, **further: str) -> str:
    """What a shell command prints; ``cosim`` is that of this environment."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", command],
        cwd=folder, env=os.environ | {"PATH": path} | further,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def same(folder: Path, table: str) -> bool:
    """True if a table has the bytes of that of one call."""
    return (folder / table).read_bytes() == (folder / "whole/table.parquet").read_bytes()


def test_gnu_parallel_makes_the_table_of_one_call(cluster: Path) -> None:
    needed("parallel", "parallel")
    readme = (ROOT / "examples/README.md").read_text(encoding="utf-8")
    commands = readme.partition("cd examples/cluster\n")[2].partition("```")[0]
    call(cluster, commands.replace("parallel cosim", "parallel --will-cite -j 2 cosim"))
    assert same(cluster, "runs/study/table.parquet")


def test_snakemake_makes_the_table_of_one_call(cluster: Path) -> None:
    pytest.importorskip("snakemake", reason="needs the extra oracles")
    call(cluster, "snakemake --cores 2")
    assert same(cluster, "merged/table.parquet")
    shutil.rmtree(cluster / "parts/07-of-20")  # lost: only this part is made again
    said = call(cluster, "snakemake --cores 2 2>&1")
    assert "2 of 2 steps (100%) done" in said and same(cluster, "merged/table.parquet")


def test_a_ci_matrix_makes_the_table_of_one_call(cluster: Path) -> None:
    jobs = yaml.safe_load((cluster / "matrix.yml").read_text(encoding="utf-8"))["jobs"]
    commands = {
        name: [s["run"] for s in job["steps"] if s.get("run", "").startswith("cosim")]
        for name, job in jobs.items()
    }
    for part in jobs["part"]["strategy"]["matrix"]["part"]:
        for command in commands["part"]:
            call(cluster, command.replace("${{ matrix.part }}", str(part)))
        # an artifact has the content of its folder; the other job finds it in one of its name
        shutil.move(cluster / "runs/study.parts", cluster / f"parts/part-{part}")
    call(cluster, commands["table"][0])
    assert same(cluster, "runs/study/table.parquet")


@pytest.fixture
def slurm(tmp_path: Path) -> Iterator[Path]:
    """The configuration of a running cluster of this host; needs root."""
    with running_slurm(tmp_path / "slurm") as file:
        yield file


def test_slurm_makes_the_table_of_one_call(cluster: Path, slurm: Path) -> None:
    needed("sbatch", "slurm-client")
    script = (cluster / "sweep.sbatch").read_text(encoding="utf-8")
    lines = [line.removeprefix("#   ") for line in script.splitlines() if line.startswith("#   ")]
    call(cluster, "\n".join(lines), SLURM_CONF=str(slurm))
    ending = time.monotonic() + 600
    while call(cluster, "squeue -h", SLURM_CONF=str(slurm)) and time.monotonic() < ending:
        time.sleep(1)
    outputs = "".join(f.read_text() for f in cluster.glob("slurm-*.out"))
    assert (cluster / "runs/study/table.parquet").is_file(), outputs
    assert same(cluster, "runs/study/table.parquet")
