"""Many nodes in lock-step on hosts: by ssh, by srun and in namespaces; all of them the twin."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from bridge.rehearsal import host_file
from bridge.rehearsal.remote import RemoteHosts
from bridge.rehearsal.supervisor import Rehearsal
from bridge.relay import namespaces
from bridge.zenoh.certificates import make_keys, refusal
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


@contextmanager
def with_certificates(folder: Path) -> Iterator[tuple[Path, Path]]:
    """A file of three hosts whose routers speak TLS, and the folder of their certificates."""
    with wired(3) as hosts:
        keys = folder / "keys"
        make_keys(keys, [f"h{i}" for i in range(3)], [address for _, address in hosts])
        text = "".join(
            f'[hosts.h{i}]\nstart = "namespace"\nto = "{name}"\naddress = "{address}"\n'
            for i, (name, address) in enumerate(hosts)
        )
        (folder / "hosts.toml").write_text(f'keys = "keys"\n{text}')
        yield folder / "hosts.toml", keys


def test_routers_with_certificates_speak_tls_and_the_run_is_the_twin(tmp_path: Path) -> None:
    changes = robots(6, 0.5)
    with with_certificates(tmp_path) as (file, _):
        running, hosts = started(file, tmp_path / "run", changes)
        with running:
            for other in ("h1", "h2"):  # the router of h0 answers in TLS, and to nothing else
                endpoint = next(iter(hosts.connections[other].task.connect))
                with file_in(file, other):
                    assert refusal(endpoint, tmp_path / "keys", other) == ""
                    assert refusal(endpoint.replace("7447", "1"), tmp_path / "keys", other) == ""
            assert running.run().notes == []
    is_the_twin(changes, tmp_path / "run")


def file_in(file: Path, host: str) -> AbstractContextManager[None]:
    """The namespace of a host."""
    return namespaces.in_namespace(host_file.load(file).hosts[host].to)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [("authority", "h2.pem, or speaks without TLS|certificate that ca.pem here refuses"),
     ("address", "its Zenoh router cannot connect to tls/10.78.0.2:7447: it has a certificate that "
                 "ca.pem here refuses: IP address mismatch"),
     ("missing", "no file .*/keys/h1.key; cosim keys creates certificates"),
     ("old", "certificate that ca.pem here refuses: certificate has expired|"
             "refuses the certificate h1.pem, .*CERTIFICATE_EXPIRED")],
)  # fmt: skip
def test_a_wrong_certificate_is_refused_with_a_sentence(
    wrong: str, sentence: str, tmp_path: Path
) -> None:
    with with_certificates(tmp_path) as (file, keys):
        addresses = [f"10.78.0.{i}" for i in (1, 2, 3)]
        match wrong:
            case "authority":
                make_keys(tmp_path / "others", ["h2"], addresses)
                for name in ("h2.pem", "h2.key"):
                    shutil.copy(tmp_path / "others" / name, keys / name)
            case "address":
                make_keys(keys, ["h1"], addresses[:1])
            case "missing":
                (keys / "h1.key").unlink()
            case "old":
                expired(keys, "h1", addresses)
        running, _ = started(file, tmp_path / "run", robots(6, 0.5))
        with pytest.raises(RunError, match=f"^host h[012]: .*({sentence})"), running:
            running.run()


def expired(keys: Path, name: str, addresses: Sequence[str]) -> None:
    """A certificate of the same authority and names, whose time is over."""
    (keys / "ext").write_text(
        f"subjectAltName={','.join(f'IP:{a}' for a in addresses)}\n"
        "extendedKeyUsage=serverAuth,clientAuth\n"
    )
    request = ["openssl", "req", "-new", "-key", f"{name}.key", "-subj", f"/CN={name}"]
    made = subprocess.run(request, cwd=keys, check=True, capture_output=True).stdout
    (keys / "database").write_text("")
    (keys / "ca.conf").write_text(
        "[ca]\ndefault_ca = d\n[d]\ndatabase = database\nrand_serial = yes\npolicy = p\n"
        "new_certs_dir = .\ndefault_md = sha256\n[p]\ncommonName = supplied\n"
    )
    words = ["openssl", "ca", "-batch", "-config", "ca.conf"]
    words += ["-cert", "ca.pem", "-keyfile", "ca.key"]
    words += ["-in", "/dev/stdin", "-out", f"{name}.pem", "-extfile", "ext", "-notext"]
    words += ["-startdate", "20200101000000Z", "-enddate", "20210101000000Z"]
    subprocess.run(words, cwd=keys, check=True, capture_output=True, input=made)


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
