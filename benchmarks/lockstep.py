"""Lock-step over a slow network: time and packets a simulated second, with and without look-ahead.

    python benchmarks/lockstep.py [--delay 25ms] [--times 0.5,2.5] [--ahead 20,120] [--rounds N]

Two hosts (network namespaces; Linux, root) with the arms of configs/teleoperation.toml in lock-step
over Zenoh (TCP); each packet takes `--delay` each way. A run of each of two lengths (s) gives the
time of a simulated second, without start and end. The digest is of all signals of both arms, which
are those of the twin.

    python benchmarks/lockstep.py --many [--nodes 2,8,16,32,64] [--least 1,3,10,30,100,300]

The robots of configs/many.toml, a node each, on one host and on three (network namespaces, each
with a Zenoh router; `--delay` between them, here 10 ms): time of a simulated second by number of
nodes (delays of links from 30 ms) and by the least delay of links (16 nodes; with controllers at
1 kHz below 3 ms), beside the theory of windows of bridge/rehearsal/placement.py, with the
processors that all hosts of this machine share.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal import host_file
from bridge.rehearsal.hosts import Hosts, groups, listen_setting
from bridge.rehearsal.placement import predict, ways
from bridge.rehearsal.remote import on_hosts
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import LEAD, NODES, Rehearsal
from bridge.replay import replay, twin

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
NET = "deploy.buses.net.options"
MANY = ROOT / "configs" / "many.toml"
#: Nodes while the least delay of links changes, ms, which is 30 while the nodes do.
NODES_AT, LEAST_AT = 16, 30


@dataclass(frozen=True)
class Measured:
    """A run: simulated and real time, s; packets of both directions; a digest of the journals."""

    simulated: float
    seconds: float
    packets: int
    digest: str


def digest(folder: Path) -> str:
    """Of the signals in all journals of a folder."""
    rows = replay.load(folder)
    parts = [rows[name]["signals"].tobytes() for name in sorted(rows)]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:8]


def measure(stop: float, delay: str, ahead: bool) -> Measured:
    """One run, from the start of the processes to their end."""
    deployment = spec.find(SCENARIO, "zenoh")
    changes = [
        f"run.stop={stop}", f"{NET}.lockstep=true", f"{NET}.insecure=true",
        f"{NET}.lookahead={str(ahead).lower()}",
    ]  # fmt: skip
    system = load_system(SCENARIO, str(deployment), changes)
    with TemporaryDirectory() as name, Hosts(groups(system), Path(name) / "packets") as hosts:
        assert hosts.network is not None
        hosts.network.set("*", delay={"law": "constant", "delay": delay})
        for node in system.nodes:
            where = f"{hosts.addresses[node]}:7461"
            changes.append(listen_setting("net", node, where, ("tcp/{}",)))
        settings = Settings(SCENARIO, deployment, tuple(changes), on_host=hosts.on_host)
        system = load_system(SCENARIO, str(deployment), changes)
        began = perf_counter()
        with Rehearsal(system, replace(settings, warm_up=0.0), Path(name) / "run") as running:
            running.run()
        taken = perf_counter() - began
        packets = len(hosts.network.packets())
        return Measured(stop, taken, packets, digest(Path(name) / "run" / NODES))


def twin_digest(stop: float) -> str:
    """Of the twin of a run."""
    system = load_system(SCENARIO, "zenoh", [f"run.stop={stop}", f"{NET}.lockstep=true"])
    with TemporaryDirectory() as name:
        twin.simulate(system, Path(name))
        return digest(Path(name))


def robots(n: int, least: int, stop: float) -> list[str]:
    """Settings of `n` robots, the delays of whose links begin at `least`, ms."""
    delay = f'{{ law = "uniform", low = "{least} ms", high = "{least + 90} ms", hold = "30 ms" }}'
    graph = f'{{ kind = "{"complete" if n < 5 else "small world"}", n = {n} }}'
    period = "1 ms" if least < 3 else "5 ms"  # what is nearer than half a period is the same tick
    return [
        f'components.control.period="{period}"',
        f"graphs.net={graph}", f"deploy.nodes.node.count={n}", f"deploy.messages.xi.count={n}",
        f"links.0.delay={delay}", f"run.stop={stop}", f"{NET}.lockstep=true",
    ]  # fmt: skip


def hosts_text(hosts: int, delay: str) -> str:
    """The file of so many hosts on this machine."""
    if hosts == 1:
        return "[hosts.a]\nstart = 'namespace'\n"
    there = "".join(f"[hosts.{name}]\nstart = 'namespace'\n" for name in "abcdefgh"[:hosts])
    return f'latency = "{delay}"\n{there}'


def measure_many(
    n: int, hosts: int, least: int, delay: str, stop: float
) -> tuple[float, float, bool]:
    """Seconds from START to the end, the theory's for a simulated one, and equality to the twin."""
    deployment = spec.find(MANY, "many")
    changes = robots(n, least, stop)
    system = load_system(MANY, str(deployment), changes)
    with TemporaryDirectory() as name:
        path, folder = Path(name) / "hosts.toml", Path(name) / "run"
        path.write_text(hosts_text(hosts, delay))
        file = host_file.load(path)
        started, placed = on_hosts(system, file, changes, folder)
        settings = Settings(MANY, deployment, tuple(changes), warm_up=0.0, starter=started)
        with Rehearsal(system, settings, folder) as running:
            running.run()
            seconds = running.t + LEAD  # lock-step begins at the command
        (Path(name) / "twin").mkdir()
        twin.simulate(system, Path(name) / "twin")
        same = digest(folder / NODES) == digest(Path(name) / "twin")
    shared = dict.fromkeys(file.hosts, (os.cpu_count() or 1) / hosts)
    between = ways(system)
    theory = predict(system, between, placed.hosts, shared, file.latency if hosts > 1 else 0.0)
    return seconds, theory.seconds, same


def many_line(n: int, hosts: int, least: int, delay: str) -> list[str]:
    """A row: the difference of two lengths, so that start and end are not in it."""
    first, _, _ = measure_many(n, hosts, least, delay, 1.0)
    longer = round(1.0 + min(10.0, max(0.5, 3.0 / max(first, 0.3))), 1)
    second, theory, same = measure_many(n, hosts, least, delay, longer)
    taken = (second - first) / (longer - 1.0)
    return [
        str(n), str(hosts), f"{least}", f"{taken:.2f}", f"{theory:.2f}", "yes" if same else "NO"
    ]  # fmt: skip


def many(nodes: str, least: str, delay: str) -> None:
    """Measure and print the table of many nodes."""
    cases = [(int(n), LEAST_AT) for n in nodes.split(",")]
    cases += [(NODES_AT, int(x)) for x in least.split(",") if int(x) != LEAST_AT]
    rows = []
    for n, least_ms in cases:
        for hosts in (1, 3) if n > 2 else (1,):
            rows.append(many_line(n, hosts, least_ms, delay))
            print(*rows[-1], file=sys.stderr, flush=True)
    header = ("nodes", "hosts", "least delay, ms", "s a simulated second", "theory", "the twin")
    print(tables.grid(header, rows))


def line(name: str, short: list[Measured], long: list[Measured]) -> list[str]:
    """A row of the table: the best of the rounds of each length."""
    a, b = (min(runs, key=lambda m: m.seconds) for runs in (short, long))
    apart = b.simulated - a.simulated
    same = {m.digest for m in long} == {twin_digest(b.simulated)}
    return [
        name, f"{(b.seconds - a.seconds) / apart:.3f}", f"{(b.packets - a.packets) / apart:.0f}",
        "yes" if same else "NO",
    ]  # fmt: skip


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--delay", help="between hosts (default 25 ms; of many 10 ms)")
    parser.add_argument("--many", action="store_true", help="many nodes on one host and on three")
    parser.add_argument("--nodes", default="2,8,16,32,64")
    parser.add_argument("--least", default="1,3,10,30,100,300")
    parser.add_argument("--times", default="0.5,2.5", help="without look-ahead, s")
    parser.add_argument("--ahead", default="20,120", help="with look-ahead, s")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    if options.many:
        many(options.nodes, options.least, options.delay or "10 ms")
        return
    rows = []
    for name, ahead, times in (
        ("without look-ahead", False, options.times),
        ("with look-ahead", True, options.ahead),
    ):
        short, long = (
            [measure(float(t), options.delay or "25 ms", ahead) for _ in range(options.rounds)]
            for t in times.split(",")
        )
        rows.append(line(name, short, long))
    print(tables.grid(("", "s a simulated second", "packets", "equal to the twin"), rows))


if __name__ == "__main__":
    main()
