"""A Slurm cluster of this host, its daemons started for a test."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

SLURM = """
ClusterName=one
SlurmctldHost={host}({address})
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
NodeName={host} NodeAddr={address} CPUs=2 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def needed(program: str, package: str) -> str:
    """The path of a program."""
    found = shutil.which(program, path=f"{os.environ['PATH']}:/usr/sbin")
    assert found, f"no {program}: apt-get install {package}"
    return found


@contextmanager
def running_slurm(
    folder: Path,
    address: str = "127.0.0.1",
    inside: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Iterator[Path]:
    """The configuration of a running cluster; `inside`: where its daemons are started."""
    assert os.geteuid() == 0, "a Slurm cluster for a test is started as root"
    (folder / "state").mkdir(parents=True)
    ports = []
    with inside():
        for _ in range(2):
            with socket.socket() as s:
                s.bind((address, 0))
                ports.append(s.getsockname()[1])
    file = folder / "slurm.conf"
    host = socket.gethostname().partition(".")[0]
    file.write_text(SLURM.format(host=host, folder=folder, ports=ports, address=address))
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
            with inside():
                daemons.append(subprocess.Popen(command))
            time.sleep(1)
        yield file
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait(timeout=60)
