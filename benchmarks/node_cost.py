"""What a node's slot costs in C: the twin of a deployment, next to the same plan in one engine.

    python benchmarks/node_cost.py [--seconds S] [--blocks N] [--deploy can,can-1khz] [--json FILE]

No clock, no socket: what is counted is inlets, delay lines, life cycle, guard, codec, journal and
the engine's own tick. Parts are switched off one at a time, each in a block of its own, in turns:
the journal (full from the start), that of what was heard, the delay lines' configured latency, the
torque guards. The best block of each counts, as what disturbs a block only ever adds.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment.system import System, load_system
from bridge.replay import twin
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import stopwatch
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"


def everything(wired: WiredNode) -> None:
    """Nothing switched off."""


def unrecorded(wired: WiredNode) -> None:
    """A journal that is full: no rows are written."""
    wired.journal.struct.capacity = 0


def unheard(wired: WiredNode) -> None:
    """What is heard is not recorded."""
    wired.struct.heard = None


def unguarded(wired: WiredNode) -> None:
    """Torques go out as computed."""
    for outlet in wired.outlet_bindings.outlets:
        outlet.guard = None


#: Variant -> settings of the deployment, and what is done to each node.
VARIANTS: dict[str, tuple[tuple[str, ...], Callable[[WiredNode], None]]] = {
    "all": ((), everything),
    "without journal": ((), unrecorded),
    "without what was heard": ((), unheard),
    "without configured latency": (("deploy.latency=false",), everything),
    "without guard": ((), unguarded),
}


def slots_ns(system: System, prepare: Callable[[WiredNode], None]) -> float:
    """Time of a slot, ns, all nodes together."""
    with (
        tempfile.TemporaryDirectory(dir="/dev/shm") as scratch,
        twin.wired_nodes(system, Path(scratch), prepare) as nodes,
    ):
        watch = stopwatch()
        twin.run(system, nodes)
        taken = watch()
        slots = sum(int(node.struct.slot) for node in nodes.values())
    return taken / slots * 1e9


def offline_ns(system: System) -> float:
    """Time of a base tick, ns, of the whole scenario in one engine, recording off."""
    with Engine(assemble(system.scenario)) as engine:
        engine.initialize()
        watch = stopwatch()
        engine.run(system.plan.ticks)
        return watch() / system.plan.ticks * 1e9


def measured(deploy: str, seconds: float, blocks: int) -> dict[str, Any]:
    """Best of the blocks, ns, of every variant."""
    stop = f'run.stop="{seconds:g} s"'
    best: dict[str, float] = {}
    for _ in range(blocks):
        for variant, (settings, prepare) in VARIANTS.items():
            system = load_system(SCENARIO, deploy, [stop, *settings])
            found = slots_ns(system, prepare)
            best[variant] = min(found, best.get(variant, found))
        found = offline_ns(system)
        best["offline"] = min(found, best.get("offline", found))
    slots = sum(round(seconds / node.h) for node in system.nodes.values())
    return {"deployment": deploy, "slots": slots, "ticks": system.plan.ticks, "ns": best}


def shown(result: dict[str, Any]) -> str:
    """As Markdown: a slot, and a base tick of the scenario with all its slots."""
    slots = result["slots"] / result["ticks"]
    whole = result["ns"]["all"]
    rows = [
        [name, f"{ns:.0f}", f"{whole - ns:.0f}", f"{ns * slots:.0f}"]
        for name, ns in result["ns"].items()
        if name != "offline"
    ]
    rows.append(["offline, one engine", "", "", f"{result['ns']['offline']:.0f}"])
    head = (result["deployment"], "ns a slot", "switched off", "ns a base tick, all nodes")
    return tables.grid(head, rows)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of simulated time a block")
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--deploy", default="can,can-1khz")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    results = [measured(d, given.seconds, given.blocks) for d in given.deploy.split(",")]
    print("\n\n".join(map(shown, results)))
    if given.json:
        facts = {"machine": tables.machine(), "results": results}
        given.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
