"""A reproducible run with faults on a simulated clock, as fast as it can be computed.

Nodes, receivers, guards, drives, the injector, journals, reports and the evaluation are those of a
rehearsal. There are no processes, no networks and no wall clock.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from pathlib import Path

from bridge.deployment.system import System
from bridge.faults.script import FaultScript, NodeFaults
from bridge.native import node as native
from bridge.native.message import E2EProfile, Message
from bridge.native.safety import LifeState
from bridge.node.fault_injection import inject
from bridge.node.run import NodeOptions, node_statement
from bridge.records.node_lives import Life
from bridge.rehearsal.supervisor import RehearsalRecord
from bridge.replay import twin
from bridge.results.outcome import begin, complete
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.wiring.wiring import WiredNode
from cosim.record.folder import NODES


def run(
    system: System,
    script: FaultScript,
    folder: Path,
    settings: Sequence[str] = (),
    *,
    blind: bool = False,
    commands: twin.Commands = (),
) -> RehearsalOutcome:
    """Simulate with the faults of a script, and complete the run folder.

    `settings`: those that `system` was made with. `blind`: without the checks of CRC and counter in
    every receiver, to show that what depends on them is noticed. `commands`: of nodes that begin
    INACTIVE, their drives off; none: all are ACTIVE from the first slot on. Raises CosimError,
    RunError where a component fails.
    """
    nodes = folder / NODES
    nodes.mkdir(parents=True, exist_ok=True)
    facts = {
        "settings": list(settings),
        "faults": str(script.path),
        "real": False,
        "clock": "simulated",
    }
    begin(system, folder, facts)
    faults: dict[str, NodeFaults | None] = {}
    kept: list[Message] = []

    def prepare(node: WiredNode) -> None:
        faults[node.name] = inject(node, script, nodes / Life(node.name).file("faults"))
        if blind:
            kept.extend(_blinded(node))

    cold = bool(commands)
    with twin.wired_nodes(system, nodes, prepare, cold=cold, logged=True) as wired:
        twin.run(system, wired, commands)
        for name, node in wired.items():
            failed = node.struct.life.state in (LifeState.FAULT, LifeState.STOPPING)
            result = native.FAULT if failed else native.FINISHED
            options = NodeOptions(Life(name), nodes)
            node_statement(node, {}, options, result, {}, "", faults[name]).write(nodes)
    return complete(
        system, folder, RehearsalRecord(), facts, with_twin=False, formats=(), script=script
    )


def _blinded(node: WiredNode) -> list[Message]:
    """Receivers that check neither CRC nor counter; the messages they read by."""
    made = []
    for reception in node.inlet_bindings.receptions.values():
        message = Message.from_buffer_copy(reception.message.contents)
        message.e2e = E2EProfile.NONE
        reception.message = c.pointer(message)
        receiver = reception.receiver.contents
        receiver.counter_bits = receiver.time_bits = 0
        made.append(message)
    return made
