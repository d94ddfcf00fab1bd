"""Many nodes in lock-step on hosts: by ssh, by srun and in namespaces; all of them the twin."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from bridge.rehearsal.remote import RemoteHosts
from bridge.rehearsal.supervisor import Rehearsal
from bridge.relay import namespaces
from cosim.base.errors import RunError
from tests.bridge.rehearsal.test_remote import SCENARIO, is_the_twin, robots, started, two_local
from tests.network.wired import sshd, wired
from tests.system.runs import ROOT
from tests.system.slurm_cluster import needed, running_slurm

pytestmark = pytest.mark.slow


def rehearse(file: Path, folder: Path, changes: Sequence[str], namespace: str, **more: str) -> str:
    """Standard output of a rehearsal whose command is called in a namespace."""
    words = [sys.executable, "-m", "cosim", "rehearse", str(SCENARIO), "--hosts", str(file)]
    words += ["--out", str(folder), "--no-plot", *(f"--set={change}" for change in changes)]
    with namespaces.in_namespace(namespace):
        done = subprocess.run(
            words, cwd=ROOT, env=os.environ | more, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_one_host_local_one_by_ssh_and_one_by_srun(tmp_path: Path) -> None:
    needed("sshd", "openssh-server")
    needed("srun", "slurm-client")
    changes = robots(12, 0.5)
    with wired(3) as ((a, first), (b, second), (c, third)), sshd(tmp_path / "ssh", b) as options:
        inside = lambda: namespaces.in_namespace(c)  # noqa: E731
        with running_slurm(tmp_path / "slurm", third, inside) as conf:
            file = tmp_path / "hosts.toml"
            there = f'python = "{sys.executable}"\nfolder = "{ROOT}"\n'
            node = os.uname().nodename.partition(".")[0]
            file.write_text(
                f'insecure = true\n[hosts.near]\naddress = "{first}"\n'
                f'[hosts.far]\nstart = "ssh"\nto = "{second}"\n{there}'
                f"options = {json.dumps(options)}\n"
                f'[hosts.slurm]\nstart = "srun"\nto = "{node}"\naddress = "{third}"\n{there}'
            )
            said = rehearse(file, tmp_path / "run", changes, a, SLURM_CONF=str(conf))
    assert "passed: every node finished, no slot missed, replays exactly" in said
    is_the_twin(changes, tmp_path / "run")


@pytest.mark.parametrize("n", [6, 50])
def test_nodes_on_three_hosts_with_a_router_each_are_the_twin(n: int, tmp_path: Path) -> None:
    changes = robots(n, 1.0)
    with wired(3) as hosts:
        file = tmp_path / "hosts.toml"
        text = "".join(
            f'[hosts.h{i}]\nstart = "namespace"\nto = "{name}"\naddress = "{address}"\n'
            for i, (name, address) in enumerate(hosts)
        )
        file.write_text(f"insecure = true\n{text}")
        running, remote = started(file, tmp_path / "run", changes)
        with running:
            assert running.run().notes == []
    is_the_twin(changes, tmp_path / "run")
    sizes = [len(host["nodes"]) for host in remote.facts().values()]
    assert sum(sizes) == n and max(sizes) <= 1.1 * n / 3 + 1


#: Runs with a kill at the start.
KILLS = int(os.environ.get("KILLS", "12"))


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_kill_at_any_moment_of_the_start_ends_the_run_and_names_who_is_gone(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = random.Random(seed)
    running, hosts = started(two_local(tmp_path), tmp_path / "run", robots(6, 300.0))
    what, host = draw.choice(["node", "router", "host"]), draw.choice(["h0", "h1"])
    victim = f"node{draw.randint(1, 6)}"
    told = killer(running, hosts, what, host, victim, draw.uniform(0.0, 1.0), monkeypatch)
    named = victim if what == "node" else f"host {host}"
    with pytest.raises(RunError) as raised, running:
        ended = running.run()
        raise RunError("; ".join(str(note) for note in ended.notes))
    assert named in str(raised.value), told
    children = subprocess.run(
        ["pgrep", "-f", str(tmp_path)], capture_output=True, text=True, check=False
    ).stdout.split()
    assert not children


def killer(
    running: Rehearsal,
    hosts: RemoteHosts,
    what: str,
    host: str,
    victim: str,
    wait: float,
    monkeypatch: pytest.MonkeyPatch,
) -> list[Any]:
    """Kill something `wait` s after it is there."""
    import threading
    import time

    told: list[Any] = [what, host, victim, wait]

    def kill() -> None:
        pid: Callable[[], int] = {
            "node": lambda: running.current[victim].pid if victim in running.current else 0,
            "router": lambda: hosts.connections[host].router if host in hosts.connections else 0,
            "host": lambda: hosts.connections[host].pid if host in hosts.connections else 0,
        }[what]
        while not pid():
            time.sleep(0.005)
        time.sleep(wait)
        os.kill(pid(), signal.SIGKILL)

    threading.Thread(target=kill, daemon=True).start()
    return told
