"""The twin: a deployment on a simulated clock, in one process, before anything real is touched.

The nodes, codecs, guards, drives and delay lines are those of the rehearsal; only the clock and the
buses are not: the next deadline is always on time, and CAN buses are simulated, with arbitration
(:mod:`bridge.replay.networks`).
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import product
from pathlib import Path

from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import DATA, Ring, frame_dtype
from bridge.native.journal import Journal
from bridge.native.safety import Command
from bridge.records.node_lives import Life
from bridge.replay.networks import Networks
from bridge.wiring.beginning import begin_active, begin_cold
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import RunError
from cosim.base.interrupts import stop_on_signal

#: Frames that may wait at a node between two of its slots.
RING = 1024
#: Simulated time between two looks at whether the run is to stop, ns.
LOOK_NS = 1_000_000_000
#: Commands to all nodes, and when (ns).
Commands = Sequence[tuple[int, Sequence[Command]]]


def simulate(system: System, folder: Path) -> dict[str, Path]:
    """Run the twin into journals ``FOLDER/LIFE.journal``; returns them by node.

    Raises RunError where a component fails or a guard stops the run.
    """
    with wired_nodes(system, folder) as nodes:
        run(system, nodes)
    return {name: folder / Life(name).file("journal") for name in system.nodes}


@contextmanager
def wired_nodes(
    system: System,
    folder: Path,
    prepare: Callable[[WiredNode], None] = lambda node: None,
    *,
    cold: bool = False,
    logged: bool = False,
) -> Iterator[dict[str, WiredNode]]:
    """All nodes, enabled; `prepare` may change each before.

    `cold`: they wait for commands instead, and their drives are off. `logged`: with the log of each
    bus at each node, ``FOLDER/LIFE.BUS.frames``.
    """
    folder = folder.absolute()  # an FMU may change the working directory
    with ExitStack() as stack:
        nodes = {
            name: stack.enter_context(
                WiredNode(
                    system,
                    name,
                    memory_buses(system, name),
                    folder / Life(name).file("journal"),
                    native.SIMULATED,
                )
            )
            for name in system.nodes
        }
        for node in nodes.values():
            if logged:
                _log(system, node, folder)
            prepare(node)
            (begin_cold if cold else begin_active)(node)
        yield nodes


def memory_buses(system: System, node: str) -> dict[str, Bus]:
    """The buses of a node, by name, each between two queues in memory."""
    return {
        name: Bus.from_rings(Ring(RING), Ring(RING), number, kind=BusKind.MEMORY)
        for number, name in enumerate(system.buses_of(node))
    }


def _log(system: System, node: WiredNode, folder: Path) -> None:
    """Log each bus of a node; the logs are closed with it."""
    for name, bus in zip(system.buses_of(node.name), node.buses, strict=True):
        size = 64 if system.deployment.buses[name].kind == "can" else DATA
        path = folder / Life(node.name).frames(name)
        bus.log = Journal.create(path, frame_dtype(size), system.log_rows(name))
        bus.struct.log = c.pointer(bus.log.struct)
        node.keep(bus.log)


def run(system: System, nodes: Mapping[str, WiredNode], commands: Commands = ()) -> None:
    """All nodes to the end, with `commands` to all of them in the order of time.

    Raises RunError, and KeyboardInterrupt where a signal ends the run.
    """
    networks = Networks(system, {n.name: n.buses for n in nodes.values()})
    pointers = (c.c_void_p * len(nodes))(*(c.addressof(w.struct) for w in nodes.values()))
    end = 1 + max(n.struct.slots * n.struct.h_ns + n.struct.phase_ns for n in nodes.values())
    pressed: list[bool] = []
    with stop_on_signal(lambda: pressed.append(True)):
        for until, told in _pauses(end, commands):
            result = native.functions().nodes_simulate(
                pointers, len(nodes), networks.structs, networks.count,
                networks.routes, networks.width, until,
            )  # fmt: skip
            if result or pressed:
                break
            for node, command in product(nodes.values(), told):
                native.functions().node_tell(c.byref(node.struct), command)
    if result and not any(w.engine.end(w.struct.result) for w in nodes.values()):
        raise _failed(nodes, result)


def _pauses(end: int, commands: Commands) -> list[tuple[int, Sequence[Command]]]:
    """Times at which the run pauses until its `end` (ns), and the commands that follow there."""
    looks = [(t, ()) for t in range(LOOK_NS, end + LOOK_NS, LOOK_NS)]
    return sorted([*looks, *commands], key=lambda pause: pause[0])


def _failed(wired: Mapping[str, WiredNode], result: int) -> BaseException:
    """The error of the node that stopped."""
    for name, node in wired.items():
        if node.struct.result:
            error = node.engine.failure(node.struct.result)
            error.add_note(f"in node {name}")
            return error
    return RunError(f"the twin stopped with {result}")
