"""Hosts that die in lock-step are replaced: on themselves, or by the others of the file."""

from __future__ import annotations

import os
import re
import shlex
import signal
import stat
import sys
from pathlib import Path
from random import Random

import pytest

from bridge.deployment.system import load_system
from bridge.rehearsal import host_file
from bridge.rehearsal.kept_run import KeptRun
from bridge.rehearsal.remote import RemoteHosts, on_hosts
from bridge.rehearsal.replacement import ReplacingRun
from bridge.rehearsal.settings import Settings
from cosim.base.copies import replace
from cosim.base.errors import Interrupted, RunError
from tests.bridge.rehearsal.test_remote import (
    DEPLOYMENT,
    SCENARIO,
    free_port,
    is_the_twin,
    robots,
    two_local,
)


def with_ssh(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with this host, and another one by an `ssh` that fails while a file "dead" exists."""
    program, dead = folder / "bin/ssh", folder / "dead"
    program.parent.mkdir()
    program.write_text(
        f'#!/bin/sh\n[ -e {shlex.quote(str(dead))} ] && echo "No route to host" >&2 && exit 255\n'
        'for last; do :; done\nexec sh -c "$last"\n'
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    path = folder / "hosts.toml"
    path.write_text(
        f"[hosts.h0]\nport = {free_port()}\n"
        f'[hosts.h1]\nport = {free_port()}\nstart = "ssh"\nto = "there"\naddress = "127.0.0.1"\n'
        f'python = "{sys.executable}"\nnodes = ["node1"]\n'
    )
    return path


def kept_run(path: Path, folder: Path, changes: tuple[str, ...], kept: KeptRun) -> ReplacingRun:
    """The run of a folder on the hosts of a file, begun or resumed."""
    system, file = load_system(SCENARIO, str(DEPLOYMENT), changes), host_file.load(path)
    folder.mkdir(exist_ok=True)
    kept.check(system)
    starter, _ = on_hosts(system, file, changes, folder)
    settings = Settings(SCENARIO, DEPLOYMENT, changes, warm_up=0.0, starter=starter)
    settings = replace(settings, keeping=kept.begin(system, folder))
    return ReplacingRun(kept, system, settings, folder, file=file)


def new_run(interval: float) -> KeptRun:
    return KeptRun(interval, {"place": os.getcwd()})


def hosts_of(running: ReplacingRun) -> RemoteHosts:
    assert isinstance(running.starter, RemoteHosts)
    return running.starter


CASES = [
    ("ssh", "dead", 1),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in [
        ("local", "host", 0), ("local", "node", 2), ("local", "router", 3),
        ("ssh", "host", 4), ("ssh", "node", 5), ("local", "host", 6), ("ssh", "dead", 7),
    ]),
]  # fmt: skip


@pytest.mark.parametrize(("start", "what", "seed"), CASES)
def test_what_died_is_replaced_and_the_run_is_the_twin(
    start: str, what: str, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = two_local(tmp_path) if start == "local" else with_ssh(tmp_path, monkeypatch)
    random, changes = Random(seed), robots(6, 4.0)
    running = kept_run(path, tmp_path / "run", changes, new_run(0.0))
    times, said = sorted(random.uniform(1.5, 3.8) for _ in range(1 + seed % 2)), list[str]()

    def progress(t: float, end: float) -> None:
        host = hosts_of(running).connections.get("h1")
        lives = [life for life in host.lives.values() if life.code is None] if host else []
        if not times or t < times[0] or host is None or not lives:  # not (any more) there
            return
        times.pop(0)
        if what == "dead":
            (tmp_path / "dead").touch()
        pid = {"node": lives[0].pid, "router": host.router}.get(what, host.pid)
        os.kill(pid, signal.SIGKILL)

    running.run(progress, said.append)
    is_the_twin(changes, tmp_path / "run")
    again = [re.search(r"; all nodes begin again at t = ([0-9.]+) s ", text) for text in said]
    assert said and all(again) and max(float(found[1]) for found in again if found) > 0.0
    hosts = {"h0"} if what == "dead" else {"h0", "h1"}
    assert set(hosts_of(running).facts()) == hosts
    named = "killed by SIGKILL on host h1" if what == "node" else "host h1: "
    assert named in said[0]
    if what == "dead":
        assert "host h1: the connection has ended (exit code 255: No route to host)" in said[1]


@pytest.mark.slow
def test_a_run_is_resumed_on_other_hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, changes = tmp_path / "run", robots(6, 4.0)
    running = kept_run(with_ssh(tmp_path, monkeypatch), folder, changes, new_run(0.3))

    def interrupt(t: float, end: float) -> None:
        if t > 1.0:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted):
        running.run(interrupt, print)
    alone = tmp_path / "alone.toml"
    alone.write_text(f"[hosts.other]\nport = {free_port()}\n")
    running = kept_run(alone, folder, changes, KeptRun.open(folder, None))
    assert running.run(lambda t, end: None, print).notes == []
    is_the_twin(changes, folder)


def test_a_host_that_is_not_there_at_the_beginning_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = with_ssh(tmp_path, monkeypatch)
    (tmp_path / "dead").touch()
    running, said = kept_run(path, tmp_path / "run", robots(6, 1.0), new_run(1.0)), list[str]()
    with pytest.raises(RunError, match=r"host h1: the connection has ended .*No route to host"):
        running.run(lambda t, end: None, said.append)
    assert not said
