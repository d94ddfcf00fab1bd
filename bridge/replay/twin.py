"""The twin: a deployment on a simulated clock, in one process, before anything real is touched.

The nodes, codecs, guards, drives and delay lines are those of the rehearsal; only the clock and the
buses are not: the next deadline is always on time, and CAN buses are simulated, with arbitration
(:mod:`bridge.replay.networks`).
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Ring
from bridge.native.safety import LifeState
from bridge.records.lives import Life
from bridge.replay.networks import Networks
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import RunError
from cosim.base.interrupts import stop_on_signal

#: Frames that may wait at a node between two of its slots.
RING = 1024
#: Simulated time between two looks at whether the run is to stop, ns.
LOOK_NS = 1_000_000_000


def simulate(system: System, folder: Path) -> dict[str, Path]:
    """Run the twin into journals ``FOLDER/LIFE.journal``; returns them by node.

    Raises RunError where a component fails or a guard stops the run.
    """
    with wired_nodes(system, folder) as nodes:
        run(system, nodes)
    return {name: folder / Life(name).file("journal") for name in system.nodes}


@contextmanager
def wired_nodes(
    system: System, folder: Path, prepare: Callable[[WiredNode], None] = lambda node: None
) -> Iterator[dict[str, WiredNode]]:
    """All nodes, enabled; `prepare` may change each before."""
    folder = folder.absolute()  # an FMU may change the working directory
    with ExitStack() as stack:
        nodes = {
            name: stack.enter_context(
                WiredNode(
                    system,
                    name,
                    _buses(system, name),
                    folder / Life(name).file("journal"),
                    native.SIMULATED,
                )
            )
            for name in system.nodes
        }
        for node in nodes.values():
            prepare(node)
            node.struct.life.state, node.struct.life.armed = LifeState.ACTIVE, 1
            native.functions().node_enable(c.byref(node.struct), 0)
        yield nodes


def _buses(system: System, node: str) -> dict[str, Bus]:
    return {
        name: Bus.from_rings(Ring(RING), Ring(RING), number, kind=BusKind.MEMORY)
        for number, name in enumerate(system.buses_of(node))
    }


def run(system: System, nodes: Mapping[str, WiredNode]) -> None:
    """All nodes to the end. Raises RunError, and KeyboardInterrupt where a signal ends the run."""
    networks = Networks(system, {n.name: n.buses for n in nodes.values()})
    pointers = (c.c_void_p * len(nodes))(*(c.addressof(w.struct) for w in nodes.values()))
    end = 1 + max(n.struct.slots * n.struct.h_ns + n.struct.phase_ns for n in nodes.values())
    pressed: list[bool] = []
    with stop_on_signal(lambda: pressed.append(True)):
        for until in range(LOOK_NS, end + LOOK_NS, LOOK_NS):
            result = native.functions().nodes_simulate(
                pointers, len(nodes), networks.structs, networks.count,
                networks.routes, networks.width, until,
            )  # fmt: skip
            if result or pressed:
                break
    if result and not any(w.engine.end(w.struct.result) for w in nodes.values()):
        raise _failed(nodes, result)


def _failed(wired: Mapping[str, WiredNode], result: int) -> BaseException:
    """The error of the node that stopped."""
    for name, node in wired.items():
        if node.struct.result:
            error = node.engine.failure(node.struct.result)
            error.add_note(f"in node {name}")
            return error
    return RunError(f"the twin stopped with {result}")
