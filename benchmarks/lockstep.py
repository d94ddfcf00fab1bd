"""Lock-step over a slow network: time and packets a simulated second, with and without look-ahead.

    python benchmarks/lockstep.py [--delay 25ms] [--times 0.5,2.5] [--ahead 20,120] [--rounds N]

Two hosts (network namespaces; Linux, root) with the arms of configs/teleoperation.toml in lock-step
over Zenoh (TCP); each packet takes `--delay` each way. A run of each of two lengths (s) gives the
time of a simulated second, without start and end. The digest is of all signals of both arms, which
are those of the twin.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal.hosts import Hosts, groups, listen_setting
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import NODES, Rehearsal
from bridge.replay import replay, twin

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
NET = "deploy.buses.net.options"


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
    parser.add_argument("--delay", default="25 ms")
    parser.add_argument("--times", default="0.5,2.5", help="without look-ahead, s")
    parser.add_argument("--ahead", default="20,120", help="with look-ahead, s")
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    rows = []
    for name, ahead, times in (
        ("without look-ahead", False, options.times),
        ("with look-ahead", True, options.ahead),
    ):
        short, long = (
            [measure(float(t), options.delay, ahead) for _ in range(options.rounds)]
            for t in times.split(",")
        )
        rows.append(line(name, short, long))
    print(tables.grid(("", "s a simulated second", "packets", "equal to the twin"), rows))


if __name__ == "__main__":
    main()
