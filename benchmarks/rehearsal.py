"""A whole rehearsal: how late its nodes are, what a slot costs, how old what they use is.

    python benchmarks/rehearsal.py [--seconds S] [--deploy can,can-1khz] [--interface socketcan]
                                   [--launcher "COMMAND ..."] [--json FILE]

Every deployment is rehearsed once by ``cosim rehearse``; the numbers are those of its journals.
Where there is no vcan0 the script starts itself again under the launcher. In User-Mode Linux a
system call costs some 15 us, and four nodes share one CPU: lateness there is theirs and the
host's. ``--interface udp_multicast`` rehearses on this kernel, without CAN; do that in a network
namespace of its own. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import shlex
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np

from benchmarks import tables
from bridge.deployment.system import System, load_system
from bridge.records.node_lives import Life
from bridge.replay import replay

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
COSIM = [sys.executable, "-c", "from cosim.cli import main; main()"]
Q = (50, 99, 99.9, 100)
#: Parts of a slot: name -> from, to (fields of a row). Frames of a slot are sent within its step.
PARTS = {
    "receive": ("woke_ns", "received_ns"),
    "step and send": ("received_ns", "done_ns"),
    "all": ("woke_ns", "done_ns"),
}


def rehearse(deploy: str, interface: str, seconds: float, folder: Path) -> dict[str, Any]:
    """One rehearsal; its rows as numbers."""
    settings = [f'run.stop="{seconds:g} s"']
    command = [*COSIM, "rehearse", str(SCENARIO), "--deploy", deploy, "-i", interface]
    command += ["--set", settings[0], "--no-plot", "--quiet", "--out", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if not (folder / "run.json").is_file():
        raise SystemExit(done.stderr or done.stdout)
    facts = json.loads((folder / "run.json").read_text(encoding="utf-8"))["rehearsal"]
    system = load_system(SCENARIO, deploy, settings)
    lives = replay.load(folder / "nodes")
    there = [name for name in system.nodes if Life(name) in lives]
    return {
        "deployment": deploy,
        "interface": interface,
        "seconds": seconds,
        "finished": facts["finished"],
        "nodes": [node_facts(system, name, lives[name]) for name in there],
        "ages": [age for name in there for age in ages(system, name, lives[name])],
        "twin_rms": facts["twin_rms"],
        "replay": facts["replay"],
    }


def node_facts(system: System, name: str, rows: np.ndarray) -> dict[str, Any]:
    """Lateness (us) and cost of a slot (us), as quantiles."""
    late = (rows["woke_ns"] - rows["deadline_ns"]) / 1e3
    return {
        "node": name,
        "rate": 1.0 / system.nodes[name].h,
        "slots": len(rows),
        "missed": int((late >= system.nodes[name].h * 1e6).sum()),
        "late": np.percentile(late, Q).tolist(),
        "cost": {
            part: np.percentile((rows[b] - rows[a]) / 1e3, Q[:2]).tolist()
            for part, (a, b) in PARTS.items()
        },
    }


def ages(system: System, name: str, rows: np.ndarray) -> Iterator[dict[str, Any]]:
    """What the network took (ms), p50 and p99, for all that a node receives."""
    for i, inlet in enumerate(system.nodes[name].inlets):
        heard = rows["inlets"][rows["inlets"]["held"][:, i] >= 0, i]
        if len(heard):
            real = np.percentile(heard["transit_ns"] / 1e6, (50, 99)).tolist()
            yield {"signal": f"{inlet.source.name} -> {inlet.target.name}", "real": real}


# ---- tables --------------------------------------------------------------------------------------


def shown(result: dict[str, Any]) -> str:
    """One rehearsal as Markdown."""
    head = ["node", "rate", "late p50", "p99", "p99.9", "max, us", "missed"]
    head += [f"{part} p50 / p99, us" for part in PARTS]
    rows = []
    for n in result["nodes"]:
        cost = [f"{c[0]:.0f} / {c[1]:.0f}" for c in n["cost"].values()]
        late = [f"{v:.0f}" for v in n["late"]]
        rows.append(
            [n["node"], f"{n['rate']:g} Hz", *late, f"{n['missed']} of {n['slots']}", *cost]
        )
    aged = [[a["signal"], f"{a['real'][0]:.3f}", f"{a['real'][1]:.3f}"] for a in result["ages"]]
    exact = "exactly 0" if result["replay"] == 0.0 else f"{result['replay']}"
    said = "" if result["finished"] else "; did NOT finish"
    return "\n\n".join(
        (
            f"**{result['deployment']}, {result['interface']}, {result['seconds']:g} s**{said}",
            tables.grid(head, rows),
            tables.grid(("signal", "on the way p50", "p99, ms"), aged),
            f"Twin: {result['twin_rms']:.2g} rad RMS; replay: difference {exact}.",
        )
    )


def options() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--deploy", default="can,can-1khz")
    parser.add_argument("--interface", default="socketcan")
    parser.add_argument("--launcher", default=f"{sys.executable} -m bridge.vcan run --")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def main() -> int:
    """Rehearse, print; under the launcher where there is no such interface."""
    given = options()
    if given.interface == "socketcan" and "vcan0" not in (n for _, n in socket.if_nameindex()):
        launcher = shlex.split(given.launcher)
        return subprocess.call([*launcher, sys.executable, *sys.argv], cwd=ROOT)
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        for deploy in given.deploy.split(","):
            folder = Path(scratch) / deploy
            results.append(rehearse(deploy, given.interface, given.seconds, folder))
            print(shown(results[-1]), end="\n\n", flush=True)
    if given.json:
        facts = {"machine": tables.machine(), "results": results}
        given.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
