"""The examples of a study in parts, by Slurm, Snakemake, GNU parallel and a CI matrix."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.system.runs import ROOT

pytestmark = pytest.mark.slow
SLURM = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
AuthType=auth/munge
SlurmUser=root
SlurmdUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
ReturnToService=2
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def needed(program: str, package: str) -> str:
    """The path of a program."""
    found = shutil.which(program, path=f"{os.environ['PATH']}:/usr/sbin")
    assert found, f"no {program}: apt-get install {package}"
    return found


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
    assert os.geteuid() == 0, "a Slurm cluster for a test is started as root"
    folder = tmp_path / "slurm"
    (folder / "state").mkdir(parents=True)
    ports = []
    for _ in range(2):
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            ports.append(s.getsockname()[1])
    file = folder / "slurm.conf"
    host = socket.gethostname().partition(".")[0]
    file.write_text(SLURM.format(host=host, folder=folder, ports=ports))
    programs = [needed(p, "slurmctld slurmd munge") for p in ("munged", "slurmctld", "slurmd")]
    for name in ("key", "run"):
        (folder / name).mkdir()
    key, where = folder / "key/munge.key", folder / "run/munge.socket"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    began = [
        [programs[0], "-F", "-f", f"--key-file={key}", f"--socket={where}",
         f"--pid-file={folder}/run/munged.pid", f"--log-file={folder}/munged.log",
         f"--seed-file={folder}/run/seed"],
        [programs[1], "-D", "-f", str(file)],
        [programs[2], "-D", "-f", str(file)],
    ]  # fmt: skip
    file.write_text(file.read_text() + f"AuthInfo=socket={where}\n")
    daemons = []
    try:
        for command in began:
            daemons.append(subprocess.Popen(command))
            time.sleep(1)
        yield file
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait(timeout=60)


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
