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
processors that all hosts of this machine share. Its costs are measured first, with two nodes on the
same paths, and all that follows is predicted before it is measured. Processor time is compared,
too: other work on the machine changes it less.

    python benchmarks/lockstep.py --checkpoints [--nodes 2,8,16] [--rounds N]

The same on one host without checkpoints and with one a second of wall time, in turns: the best time
of a run of each, what each checkpoint adds to it, and the bytes of one, of all nodes.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from cosim.base.copies import replace

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal import host_file
from bridge.rehearsal.checkpoints import Keeping, last_number
from bridge.rehearsal.hosts import Hosts, groups, listen_setting
from bridge.rehearsal.placement import LockstepCosts, predict, ways
from bridge.rehearsal.remote import on_hosts
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import LEAD, NODES, Rehearsal
from bridge.replay import replay, twin
from cosim.base.interrupts import exit_code, signals_as_interrupt
from cosim.checkpoint.archive import LATEST
from cosim.record.folder import CHECKPOINTS

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
NET = "deploy.buses.net.options"
MANY = ROOT / "configs" / "many.toml"
#: Nodes while the least delay of links changes, ms, which is 30 while the nodes do.
NODES_AT, LEAST_AT = 16, 30
#: Processor time of the difference of two lengths, s: long beside what their starts differ by.
LONG = 5.0
#: s between two samples of a controller where the least delay is at least 3 ms.
PERIOD = 5e-3


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


@dataclass(frozen=True)
class Case:
    """So many nodes on so many hosts; `least`: the least delay of links, ms."""

    nodes: int
    hosts: int
    least: int


@dataclass(frozen=True)
class Taken:
    """Wall and processor time of a simulated second, s; `same`: the result is the twin's."""

    wall: float
    processor: float
    same: bool


def processor() -> float:
    """Processor time of this process and of the children that have ended, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def run_many(case: Case, delay: str, stop: float) -> Taken:
    """One run: wall time from START to the end, and processor time from the begin to the end."""
    deployment = spec.find(MANY, "many")
    changes = robots(case.nodes, case.least, stop)
    system = load_system(MANY, str(deployment), changes)
    with TemporaryDirectory() as name:
        path, folder = Path(name) / "hosts.toml", Path(name) / "run"
        path.write_text(hosts_text(case.hosts, delay))
        began = processor()
        started, _ = on_hosts(system, host_file.load(path), changes, folder)
        settings = Settings(MANY, deployment, tuple(changes), warm_up=0.0, starter=started)
        with Rehearsal(system, settings, folder) as running:
            running.run()
            seconds = running.t + LEAD  # lock-step begins at the command
        used = processor() - began
        (Path(name) / "twin").mkdir()
        twin.simulate(system, Path(name) / "twin")
        same = digest(folder / NODES) == digest(Path(name) / "twin")
    return Taken(seconds, used, same)


def measure_many(case: Case, delay: str, rounds: int, length: float) -> Taken:
    """By two lengths that are `length` s apart, without start and end; the least of `rounds`."""
    apart = round(length, 1)
    first = [run_many(case, delay, 0.5) for _ in range(rounds)]
    second = [run_many(case, delay, 0.5 + apart) for _ in range(rounds)]
    wall = min(x.wall for x in second) - min(x.wall for x in first)
    used = min(x.processor for x in second) - min(x.processor for x in first)
    return Taken(wall / apart, used / apart, all(x.same for x in (*first, *second)))


def costs_of(delay: str, rounds: int) -> LockstepCosts:
    """The costs of the theory, by two nodes on one host and on two: 2000 slots a second.

    Windows of 1 ms and of 300 ms have 4000 and 13 ends of payloads a second.
    """
    often = measure_many(Case(2, 1, 1), delay, rounds, 8.0)
    rarely = measure_many(Case(2, 1, 300), delay, rounds, 250.0)
    payload = max(0.0, often.processor - rarely.processor) / (4000 - 4 / 0.3)
    slot = max(0.0, rarely.processor - 4 / 0.3 * payload) / 2000
    exchange = max(0.0, often.wall - often.processor / (os.cpu_count() or 1)) / 1000
    far, close = (measure_many(Case(2, n, 30), delay, rounds, 60.0) for n in (2, 1))
    crossing = max(0.0, far.processor - close.processor) / (2 / 0.03)
    return LockstepCosts(slot, payload, crossing, exchange)


def predicted(case: Case, delay: str, costs: LockstepCosts) -> tuple[float, float, float]:
    """Wall time of a simulated second, its least, and processor time, s."""
    system = load_system(MANY, "many", robots(case.nodes, case.least, 1.0))
    with TemporaryDirectory() as name:
        path = Path(name) / "hosts.toml"
        path.write_text(hosts_text(case.hosts, delay))
        file = host_file.load(path)
        _, placed = on_hosts(system, file, robots(case.nodes, case.least, 1.0), Path(name))
    between, every = ways(system), dict.fromkeys(system.nodes, "all")
    cores = os.cpu_count() or 1
    latency = file.latency if case.hosts > 1 else 0.0
    shared = dict.fromkeys(file.hosts, cores / case.hosts)
    found = predict(system, between, placed.hosts, shared, latency, costs)
    alone = predict(system, between, every, {"all": 1}, 0.0, costs).computing
    pairs = {(way.sender, placed.hosts[way.receiver]) for way in found.cut}
    used = alone + costs.crossing * len(pairs) / max(1e-3 * case.least, PERIOD)
    return found.seconds, max(found.computing, found.waiting), used


def many(nodes: str, least: str, delay: str, rounds: int) -> None:
    """Measure and print the table of many nodes, each row after its prediction."""
    cases = [(int(n), LEAST_AT) for n in nodes.split(",")]
    cases += [(NODES_AT, int(x)) for x in least.split(",") if int(x) != LEAST_AT]
    costs = costs_of(delay, rounds)
    print(f"of two nodes: {costs}", file=sys.stderr, flush=True)
    all_cases = [Case(n, hosts, ms) for n, ms in cases for hosts in (1, 3) if hosts == 1 or n > 2]
    theory = {case: predicted(case, delay, costs) for case in all_cases}
    for case, (wall, bound, used) in theory.items():
        print(f"predicted: {case}: {bound:.3f} to {wall:.3f} s, processors {used:.3f} s",
              file=sys.stderr, flush=True)  # fmt: skip
    rows = []
    for case, (wall, bound, used) in theory.items():
        found = measure_many(case, delay, rounds, min(300.0, max(1.0, LONG / used)))
        rows.append([
            str(case.nodes), str(case.hosts), str(case.least), f"{found.wall:.2f}",
            f"{bound:.2f} to {wall:.2f}", f"{found.wall / wall:.2f}", f"{found.processor:.2f}",
            f"{used:.2f}", f"{found.processor / used:.2f}", "yes" if found.same else "NO",
        ])  # fmt: skip
        print(*rows[-1], file=sys.stderr, flush=True)
    header = (
        "nodes", "hosts", "least delay, ms", "wall, s", "theory", "measured / theory",
        "processors, s", "theory", "measured / theory", "the twin",
    )  # fmt: skip
    print(tables.grid(header, rows))


def measure_kept(n: int, stop: float, interval: float | None) -> tuple[float, int, int]:
    """Seconds from START to the end of a run; the checkpoints in it, and the bytes of the last."""
    deployment, changes = spec.find(MANY, "many"), robots(n, LEAST_AT, stop)
    system = load_system(MANY, str(deployment), changes)
    with TemporaryDirectory() as name:
        path, folder = Path(name) / "hosts.toml", Path(name) / "run"
        path.write_text(hosts_text(1, ""))
        started, _ = on_hosts(system, host_file.load(path), changes, folder)
        settings = Settings(MANY, deployment, tuple(changes), warm_up=0.0, starter=started)
        if interval is not None:
            settings = replace(settings, keeping=Keeping(interval))
        with Rehearsal(system, settings, folder) as running:
            running.run()
            seconds = running.t + LEAD
        found = last_number(system, folder / NODES)
        sizes = [p.stat().st_size for p in (folder / CHECKPOINTS).rglob(LATEST)]
        return seconds, 0 if found is None else found[0] + 1, sum(sizes)


def kept(nodes: str, rounds: int) -> None:
    """Measure and print the table of checkpoints."""
    rows = []
    for n in map(int, nodes.split(",")):
        stop = 80.0 / n
        without, with_ = [], []
        for _ in range(rounds):
            without.append(measure_kept(n, stop, None))
            with_.append(measure_kept(n, stop, 1.0))
        (a, _, _), (b, count, size) = min(without), min(with_)
        rows.append([
            str(n), f"{stop:g}", f"{a:.2f}", f"{b:.2f}", str(count),
            f"{1e3 * (b - a) / count:.0f}", f"{size / 1e6:.2f}",
        ])  # fmt: skip
        print(*rows[-1], file=sys.stderr, flush=True)
    header = (
        "nodes",
        "simulated, s",
        "without, s",
        "with, s",
        "number",
        "each adds, ms",
        "one, MB",
    )
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


def main() -> int:
    """Measure and print a table; a signal leaves no host behind. Returns the exit code."""
    try:
        with signals_as_interrupt():
            measured()
    except KeyboardInterrupt:
        return exit_code()
    return 0


def measured() -> None:
    """Measure and print the table that the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--delay", help="between hosts (default 25 ms; of many 10 ms)")
    parser.add_argument("--many", action="store_true", help="many nodes on one host and on three")
    parser.add_argument("--checkpoints", action="store_true", help="what a checkpoint costs")
    parser.add_argument("--nodes", help="default 2,8,16,32,64; of checkpoints 2,8,16")
    parser.add_argument("--least", default="1,3,10,30,100,300")
    parser.add_argument("--times", default="0.5,2.5", help="without look-ahead, s")
    parser.add_argument("--ahead", default="20,120", help="with look-ahead, s")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    if options.many:
        nodes = options.nodes or "2,8,16,32,64"
        many(nodes, options.least, options.delay or "10 ms", options.rounds)
        return
    if options.checkpoints:
        kept(options.nodes or "2,8,16", options.rounds)
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
    sys.exit(main())
