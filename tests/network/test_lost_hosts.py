"""Hosts of a rehearsal that are killed, frozen or cut off: named in time, and nothing is left."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from bridge.relay import namespaces
from tests.bridge.rehearsal.test_remote import SCENARIO, is_the_twin, robots
from tests.network.wired import sshd, wired
from tests.system.runs import ROOT
from tests.system.slurm_cluster import needed, running_slurm

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

#: Runs with a kill at the start, of each way to start hosts.
KILLS = int(os.environ.get("KILLS", "3"))
WAYS = ("namespace", "ssh", "srun")
#: s; the limit of the hosts in these tests, and what a busy machine takes to stop the others.
SILENCE, STOPPING = 4.0, 90.0


@dataclass(frozen=True)
class Fleet:
    """Hosts by name, each with its network namespace; the command is called in that of the first.

    `text`: the file of hosts; `environment`: of the command.
    """

    hosts: Mapping[str, str]
    text: str
    environment: Mapping[str, str]

    @property
    def command_in(self) -> str:
        """The namespace of the command."""
        return next(iter(self.hosts.values()))


@contextmanager
def fleet(way: str, folder: Path) -> Iterator[Fleet]:
    """A host here and two more by ssh or in namespaces, or one by srun."""
    there = f'python = "{sys.executable}"\nfolder = "{ROOT}"\n'
    with ExitStack() as stack:
        found = stack.enter_context(wired(2 if way == "srun" else 3))
        (near, first), *others = found
        text = f'insecure = true\n[hosts.near]\naddress = "{first}"\n'
        hosts, environment = {"near": near}, dict[str, str]()
        for i, (name, address) in enumerate(others):
            host = f"far{i}"
            hosts[host] = name
            text += f'[hosts.{host}]\nstart = "{way}"\naddress = "{address}"\n'
            if way == "namespace":
                text += f'to = "{name}"\n'
            elif way == "ssh":
                options = stack.enter_context(sshd(folder / f"ssh{i}", name))
                text += f'to = "root@{address}"\n{there}options = {json.dumps(options)}\n'
            else:
                inside = lambda n=name: namespaces.in_namespace(n)  # noqa: E731
                conf = stack.enter_context(running_slurm(folder / "slurm", address, inside))
                environment["SLURM_CONF"] = str(conf)
                node = os.uname().nodename.partition(".")[0]
                text += f'to = "{node}"\n{there}'
        yield Fleet(hosts, text, environment)


@pytest.fixture(scope="module", params=WAYS)
def hosts(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Fleet]:
    """Hosts that are started in one of the ways."""
    if request.param == "ssh":
        needed("sshd", "openssh-server")
    if request.param == "srun":
        needed("srun", "slurm-client")
    with fleet(request.param, tmp_path_factory.mktemp(request.param)) as found:
        yield found


def inside(namespace: str) -> dict[int, str]:
    """The processes in a namespace with their command lines."""
    said = subprocess.run(["ip", "netns", "pids", namespace], capture_output=True, text=True).stdout
    found = {}
    for pid in map(int, said.split()):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
        except OSError:
            continue
        if words:  # a zombie has none
            found[pid] = words
    return found


def parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


class Run:
    """``cosim rehearse`` on a fleet, and the processes that were there before it."""

    def __init__(
        self,
        hosts: Fleet,
        folder: Path,
        stop: float = 200.0,
        options: Sequence[str] = (),
        silence: float = SILENCE,
    ) -> None:
        self.hosts, self.folder = hosts, folder / "run"
        (folder / "hosts.toml").write_text(f'silence = "{silence} s"\n{hosts.text}')
        self._before = {pid for name in hosts.hosts.values() for pid in inside(name)}
        words = [sys.executable, "-m", "cosim", "rehearse", str(SCENARIO.relative_to(ROOT))]
        words += ["--hosts", str(folder / "hosts.toml"), "--out", str(self.folder), "--no-plot"]
        words += [f"--set={change}" for change in robots(6, stop)]
        words += ["--no-twin", "--set=deploy.buses.net.options.lookahead=false"]  # slowly
        words += options
        self._output = folder / "output"
        with namespaces.in_namespace(hosts.command_in), self._output.open("wb") as to:
            self.process = subprocess.Popen(
                words, cwd=ROOT, env=os.environ | hosts.environment,
                stdout=to, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def of(self, host: str, *kinds: str) -> dict[int, str]:
        """The processes of these kinds that this run has on a host now."""
        return {
            pid: words
            for pid, words in inside(self.hosts.hosts[host]).items()
            if pid not in self._before and any(kind in words for kind in kinds)
        }

    def nodes(self, host: str) -> list[int]:
        """The nodes of a host: copies of its agent, which is their parent."""
        agents = self.of(host, "bridge.rehearsal.agent")
        return [pid for pid in agents if parent(pid) in agents]

    def running(self) -> None:
        """Wait until t = 0 has passed."""
        until(lambda: (self.folder / "rehearsal.json").is_file(), 300.0)
        time.sleep(1.0)

    def ended(self, within: float) -> tuple[int, str]:
        """Exit code and output; nothing is left on any host soon after."""
        code = self.process.wait(within)
        until(lambda: not self.left(), SILENCE + STOPPING, self.left)
        return code, self.said()

    def said(self) -> str:
        """The output so far."""
        return self._output.read_text(errors="replace")

    def left(self) -> dict[int, str]:
        """The processes that still run."""
        return {
            pid: words
            for name in self.hosts.hosts.values()
            for pid, words in inside(name).items()
            if pid not in self._before and pid != self.process.pid
        }


def until(there: Callable[[], object], seconds: float, say: Callable[[], object] = str) -> None:
    ending = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < ending, say()
        time.sleep(0.01)


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_kill_at_any_moment_of_the_start_names_the_host(
    hosts: Fleet, seed: int, tmp_path: Path
) -> None:
    draw = random.Random(seed)
    host = draw.choice(list(hosts.hosts))
    kinds = draw.choice([("bridge.rehearsal.agent",), ("bridge.zenoh.router",), ("bridge.",)])
    wait = draw.uniform(0.0, 10.0)
    run = Run(hosts, tmp_path)
    time.sleep(wait)
    found: dict[int, str] = {}
    while not found:
        found = run.of(host, *kinds)
        assert run.process.poll() is None
    pid = draw.choice(sorted(found))
    if found[pid].startswith(("ssh ", "srun ")):  # it is here, and keeps the connection to another
        host = next((f"far{i}" for i in (0, 1) if f"@10.78.0.{i + 2}" in found[pid]), "far0")
    told = f"{host}, after {wait:.2f} s: {pid} {found[pid]}; {len(found)} of them"
    os.kill(pid, signal.SIGKILL)
    code, said = run.ended(STOPPING)
    assert code == 1 and "Traceback" not in said, told + said
    assert re.search(rf"(node node\d\S* .*on host {host}|host {host}: )", said), told + said


@pytest.mark.parametrize("frozen", ["agent", "host", "node", "router"])
def test_a_frozen_host_is_named_in_time_and_the_others_are_collected(
    hosts: Fleet, frozen: str, tmp_path: Path
) -> None:
    run = Run(hosts, tmp_path)
    host = list(hosts.hosts)[-1]
    run.running()
    agents = run.of(host, "bridge.rehearsal.agent")
    routers = run.of(host, "bridge.zenoh.router")
    stopped = {
        "agent": [pid for pid in agents if parent(pid) not in agents],
        "host": [*agents, *routers], "node": run.nodes(host)[:1],
        "router": [*routers],
    }[frozen]  # fmt: skip
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    began = time.monotonic()
    try:
        code = run.process.wait(SILENCE + STOPPING)
        taken = time.monotonic() - began
    finally:
        for pid in stopped:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
    said = run.ended(1.0)[1]
    assert code == 1 and "Traceback" not in said, said
    wanted = {
        "agent": f"host {host}: nothing came from it for {SILENCE:g} s",
        "host": f"host {host}: ",
        "node": f"stopped by a signal for {SILENCE:g} s (silence), on host {host}",
        "router": f"host {host}: its Zenoh router lost its connection to that of near",
    }[frozen]
    assert wanted in said, said
    assert taken < SILENCE + STOPPING
    rows_are_there(run, host if frozen in ("agent", "host") else "")


def rows_are_there(run: Run, but: str) -> None:
    """The journals of all hosts, except those of one, are in the run folder."""
    facts = json.loads((run.folder / "run.json").read_text())["deployment"]["hosts"]
    for host, of in facts.items():
        for node in of["nodes"] if host != but else ():
            assert (run.folder / "nodes" / f"{node}.journal").stat().st_size > 0, node


def test_a_host_that_is_cut_off_is_named_in_time(hosts: Fleet, tmp_path: Path) -> None:
    run = Run(hosts, tmp_path)
    host = list(hosts.hosts)[-1]
    run.running()
    name = hosts.hosts[host]
    link = ["ip", "-n", name, "link", "set", "eth0"]
    subprocess.run([*link, "down"], check=True)
    try:
        code = run.process.wait(SILENCE + STOPPING)
        # The agent of the host ends on its own, with all that it has started.
        until(lambda: not run.of(host, "bridge."), SILENCE + STOPPING)
    finally:
        subprocess.run([*link, "up"], check=True)
    said = run.ended(1.0)[1]
    assert code == 1 and "Traceback" not in said, said
    assert f"host {host}: " in said, said
    rows_are_there(run, host)


@pytest.mark.parametrize(
    ("outage", "silence", "options"),
    [(1.0, 10.0, ()), (3.0, 10.0, ()), (3.0, 4.0, ()), (3.0, 4.0, ("--checkpoint=200ms",))],
    ids=["short", "a third of silence", "nearly silence", "nearly silence, with checkpoints"],
)
def test_an_outage_that_heals_is_survived_to_the_bit_or_named(
    hosts: Fleet, outage: float, silence: float, options: Sequence[str], tmp_path: Path
) -> None:
    """TCP sends again up to as long after an outage as it lasted."""
    stop, patience = 3.0, "--set=deploy.patience=600"
    run = Run(hosts, tmp_path, stop, [patience, *options], silence)
    host = list(hosts.hosts)[-1]
    run.running()
    if options:
        until(lambda: len(list(run.folder.glob("**/previous"))) == 6, 500.0, run.said)
    link = ["ip", "-n", hosts.hosts[host], "link", "set", "eth0"]
    subprocess.run([*link, "down"], check=True)
    try:
        time.sleep(outage)
    finally:
        subprocess.run([*link, "up"], check=True)
    code, said = run.ended(550.0)  # less than `patience`: no node waits in vain
    assert "Traceback" not in said, said
    if code and not options and outage > silence / 3:
        assert re.search(rf"host {host}: (its Zenoh router lost|nothing came|the conn)", said), said
        return
    assert code == 0, said
    is_the_twin(robots(6, stop), run.folder)


@pytest.mark.parametrize("how", ["agent", "host", "cut off"])
def test_a_host_that_is_frozen_or_cut_off_is_replaced_and_the_run_is_the_twin(
    hosts: Fleet, how: str, tmp_path: Path
) -> None:
    # A host that was cut off is given up after `patience`; a busy machine takes long to start.
    stop, patience = 4.0, 60 if how == "cut off" else 300
    run = Run(hosts, tmp_path, stop, ["--checkpoint=200ms", f"--set=deploy.patience={patience}"])
    host = list(hosts.hosts)[-1]
    run.running()
    until(lambda: len(list(run.folder.glob("**/previous"))) == 6, 300.0, run.said)  # of each node
    agents = run.of(host, "bridge.rehearsal.agent")
    stopped = {
        "agent": [pid for pid in agents if parent(pid) not in agents],
        "host": [*agents, *run.of(host, "bridge.zenoh.router")], "cut off": [],
    }[how]  # fmt: skip
    link = ["ip", "-n", hosts.hosts[host], "link", "set", "eth0"]
    try:
        if how == "cut off":
            subprocess.run([*link, "down"], check=True)
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        code = run.process.wait(600.0)
    finally:
        subprocess.run([*link, "up"], check=True)
        for pid in stopped:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
    said = run.ended(1.0)[1]
    assert code == 0 and "Traceback" not in said, said
    found = re.search(r"host (\w+): .*; all nodes begin again at t = ([0-9.]+) s ", said)
    assert found and found[1] == host and 0.0 < float(found[2]) < stop, said
    is_the_twin(robots(6, stop), run.folder)
