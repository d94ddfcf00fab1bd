"""How late the nodes of a rehearsal wake at 1 kHz beside busy processes, next to cyclictest.

    python benchmarks/node_lateness.py [--seconds S] [--busy 0,2,4] [--rounds N]
        [--variants TEXT] [--json FILE]

Each measurement is a whole rehearsal of two arms and two controllers at 1 kHz (four processes,
udp_multicast in a network namespace of its own), or four bare loops in C, while cyclictest runs at
the same priority in the same seconds and N processes compute without a pause. Variants are taken in
turns, and the table holds medians of the rounds:

* the nodes as they are, with their journals on the disk,
* the nodes with their journals in memory (/dev/shm): the difference is what the disk costs,
* the same, while `cosim ping listen can` reads every frame of both buses,
* the nodes without real-time grants: what the grants are worth,
* four bare C loops with the same grants: the difference to the nodes is what nodes do in a slot.

A node executes every slot that it missed, so one stall of 5 ms makes five late slots; cyclictest
counts that stall once. The columns "a stall once" count the first slot of each stall only, which is
what compares with cyclictest. "Late" are slots that woke 200 us after their deadline or later; they
are either behind a slot of the node that ended after their deadline, or the thread woke late.

Needs root (namespaces, SCHED_FIFO) and Debian's rt-tests for cyclictest.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np
from numpy.typing import NDArray

from benchmarks import tables
from bridge.native import pace
from bridge.realtime.requests import Realtime, enter
from bridge.replay import replay

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
SETUP = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
NAMESPACE = ("unshare", "--net", "sh", "-c")
#: Groups of the two buses of a rehearsal on udp_multicast.
GROUPS = ("239.74.163.2", "239.74.163.3")
COSIM = (sys.executable, "-c", "from cosim.cli import main; main()")
PERIOD, LATE, PRIORITY, NODES = 1_000_000, 200_000, 50, 4  # ns, ns, SCHED_FIFO, processes
QUANTILES = (50, 99, 99.9, 100)
Ns = NDArray[np.int64]


@dataclass(frozen=True)
class Found:
    """One measurement; all times in us, quantiles as QUANTILES.

    `every`: of all slots; `once`: each stall once; `late`: share of slots that were late;
    `behind`: share of the late ones that stood behind a slot which ended after their deadline;
    `receive`, `step`: parts of a slot; `peer`: cyclictest in the same seconds.
    """

    every: list[float]
    once: list[float]
    late: float
    behind: float
    receive: list[float]
    step: list[float]
    peer: list[float]


def quantiles(ns: Ns) -> list[float]:
    """QUANTILES of `ns` (n,), in us; zeros if there are none."""
    return [float(v) / 1e3 for v in np.percentile(ns, QUANTILES)] if len(ns) else [0.0] * 4


def judge(slots: list[dict[str, Ns]], peer: list[float]) -> Found:
    """What the slots of all nodes say together: `deadline`, `woke`, `received`, `done`, ns (n,)."""
    late = [s["woke"] - s["deadline"] for s in slots]
    behind = [np.r_[False, s["done"][:-1] > s["deadline"][1:]] for s in slots]
    every, held = np.concatenate(late), np.concatenate(behind)
    slow = every > LATE
    receive = np.concatenate([s["received"] - s["woke"] for s in slots])
    step = np.concatenate([s["done"] - s["received"] for s in slots])
    return Found(
        quantiles(every), quantiles(every[~held]), float(slow.mean()),
        float(held[slow].mean()) if slow.any() else 0.0, quantiles(receive), quantiles(step), peer,
    )  # fmt: skip


# ---- what is measured ----------------------------------------------------------------------------


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that compute without a pause, at the ordinary priority."""
    words = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(words) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


@contextmanager
def cyclictest(seconds: float, found: list[float]) -> Iterator[None]:
    """Run cyclictest beside what is done meanwhile; its quantiles go to `found`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "found.json")
        words = ["cyclictest", "-q", "-m", "-t1", f"-p{PRIORITY}", f"-i{PERIOD // 1000}"]
        words += ["-h100000", f"-D{max(1, round(seconds))}", f"--json={file}"]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        yield
        process.wait()
        histogram = json.loads(file.read_text())["thread"]["0"]["histogram"]
    values = np.repeat([int(us) for us in histogram], [int(n) for n in histogram.values()])
    found += quantiles(1000 * values.astype(np.int64))


def listeners(seconds: float, folder: Path) -> str:
    """Shell commands that start a ping at each bus, which listens until the rehearsal has ended."""
    ping = (*COSIM, "ping", "listen", "can")
    return " ".join(
        f"{shlex.join(ping)} {group} -i udp_multicast --duration {seconds + 3:g} "
        f">{shlex.quote(str(folder))}-{group} 2>&1 &"
        for group in GROUPS
    )


def nodes(seconds: float, folder: Path, *more: str, listen: bool = False) -> list[dict[str, Ns]]:
    """The slots of a rehearsal's nodes, without the first second."""
    first, last = SETUP.rsplit("&& ", 1)
    setup = f"{first}&& ( {listeners(seconds, folder)} sleep 2 ) && {last}" if listen else SETUP
    words = [*NAMESPACE, setup, "sh", *COSIM, "rehearse", str(SCENARIO), "--deploy", "can-1khz"]
    words += ["-i", "udp_multicast", "--no-twin", "--no-plot", "--quiet", "--out", str(folder)]
    words += ["--set", f"run.stop={seconds:g}", *more]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if not (folder / "run.json").is_file():
        raise SystemExit(done.stderr or done.stdout)
    names = {"deadline": "deadline_ns", "woke": "woke_ns", "received": "received_ns",
             "done": "done_ns"}  # fmt: skip
    for group in GROUPS if listen else ():
        heard = re.findall(r"(\d+) samples,", Path(f"{folder}-{group}").read_text())
        print(f"{group}: the ping heard {sum(map(int, heard))} frames", file=sys.stderr)
    lives = replay.load(folder / "nodes").values()
    return [{k: rows[name][1000:].astype(np.int64) for k, name in names.items()} for rows in lives]


def loops(seconds: float) -> list[dict[str, Ns]]:
    """Bare loops in C, as many as there are nodes, each in a process with the nodes' grants."""
    words = [sys.executable, __file__, "--loop", f"{seconds:g}"]
    running = [subprocess.Popen(words, stdout=subprocess.PIPE) for _ in range(NODES)]
    slots = []
    for process in running:
        out, _ = process.communicate()
        start, *woke = (int(x) for x in out.split())
        ns = np.array(woke, np.int64)
        slots.append({"deadline": start + PERIOD * np.arange(len(ns)), "woke": ns,
                      "received": ns, "done": ns})  # fmt: skip
    return slots


def loop(seconds: float) -> None:
    """One bare loop in this process: prints its start and when it woke, ns."""
    with enter(Realtime(priority=PRIORITY)):
        start = pace.now() + 20_000_000
        woke = pace.run(start, PERIOD, round(seconds * 1e9 / PERIOD))
    print(start, *woke.tolist())


def measure(variant: str, seconds: float) -> Found:
    """One variant, once."""
    peer: list[float] = []
    parent = "/dev/shm" if "in memory" in variant else None
    with tempfile.TemporaryDirectory(dir=parent) as scratch, cyclictest(seconds, peer):
        if variant == "four bare C loops":
            slots = loops(seconds)
        else:
            more = ("--no-realtime",) if variant == "nodes, no grants" else ()
            slots = nodes(seconds, Path(scratch, "run"), *more, listen="listens" in variant)
    return judge(slots, peer)


VARIANTS = (
    "nodes",
    "nodes, journals in memory",
    "nodes, journals in memory, a ping listens",
    "nodes, no grants",
    "four bare C loops",
)

# ---- all of them ---------------------------------------------------------------------------------


def middle(rounds: list[Found]) -> Found:
    """Medians over the rounds, number by number."""
    found: dict[str, Any] = {}
    for key, value in asdict(rounds[0]).items():
        values = [asdict(r)[key] for r in rounds]
        found[key] = (
            [median(v[i] for v in values) for i in range(len(value))]
            if isinstance(value, list)
            else median(values)
        )
    return Found(**found)


def row(busy_processes: int, variant: str, f: Found) -> list[str]:
    """One line of the table."""
    shown = ["/".join(f"{v:.0f}" for v in q[1:3]) for q in (f.every, f.once, f.peer)]
    ratio = f"{f.once[1] / f.peer[1]:.2f}" if f.peer[1] else ""
    parts = [f"{part[1]:.0f}" for part in (f.receive, f.step)]
    return [str(busy_processes), variant, f"{f.every[0]:.0f}", *shown, ratio,
            f"{100 * f.late:.2f} %", f"{100 * f.behind:.0f} %", *parts]  # fmt: skip


HEADER = ("busy", "what", "p50", "p99/p99.9 every slot", "a stall once", "cyclictest",
          "p99 once to cyclictest's", "late", "of them behind a slot", "receive p99",
          "step p99")  # fmt: skip


def main() -> None:
    """Measure in turns, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of a rehearsal (default 10)")
    parser.add_argument("--busy", default="0,2,4", help="busy processes (default 0,2,4)")
    parser.add_argument("--rounds", type=int, default=3, help="of each (default 3)")
    parser.add_argument("--variants", default="", help="only those that contain this text")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--loop", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.loop:
        loop(options.loop)
        return
    for program in ("cyclictest", "unshare", "ip"):
        if shutil.which(program) is None:
            raise SystemExit(f"{program} is not installed (Debian: rt-tests, util-linux, iproute2)")
    cases = [(int(n), variant) for n in options.busy.split(",") for variant in VARIANTS
             if options.variants in variant]  # fmt: skip
    found: dict[tuple[int, str], list[Found]] = {case: [] for case in cases}
    for _ in range(options.rounds):
        for n, variant in cases:
            with busy(n):
                found[n, variant].append(measure(variant, options.seconds))
    lines = [row(n, variant, middle(found[n, variant])) for n, variant in cases]
    print(tables.grid(HEADER, lines))
    if options.json:
        rows = [{"busy": n, "variant": v, "rounds": [asdict(f) for f in found[n, v]]}
                for n, v in cases]  # fmt: skip
        facts = {"machine": tables.machine(), "seconds": options.seconds, "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
