"""Run folders for the monitor: a twin's journals under the names of a rehearsal, and bus logs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from bridge.deployment.system import System
from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.rehearsal.supervisor import NODES, STARTED
from tests.bridge.deployments import TELEOPERATION, named, run_twin

SETTINGS = ("run.stop=2",)
CAN = TELEOPERATION.parent / "deploy" / "can.toml"


def folder_of(place: Path, *, pid: int = 0, wall_ns: int = 10**18) -> System:
    """A run of 2 s, as a rehearsal with this supervisor would leave it, without ``run.json``."""
    system = named("can", *SETTINGS)
    place.mkdir(parents=True, exist_ok=True)
    run_twin(system, place / NODES)
    facts = {
        "scenario": str(TELEOPERATION),
        "deployment": str(CAN),
        "settings": list(SETTINGS),
        "pid": pid,
        "start_ns": 5 * 10**9,
        "wall_ns": wall_ns,
    }
    (place / STARTED).write_text(json.dumps(facts))
    return system


def own_pid() -> int:
    """The number of a process that is certainly there."""
    return os.getpid()


def frames(path: Path, rows: list[tuple[int, int, int, bytes]]) -> None:
    """A bus log of (t_ns, identifier, flags, data)."""
    with Journal.create(path, frame_dtype(), max(1, len(rows))) as journal:
        for t_ns, identifier, flags, data in rows:
            padded = np.frombuffer(data.ljust(64, b"\0"), np.uint8)
            journal.append(t_ns, identifier, flags, 0, len(data), 0, 0, padded)


def talk(nodes: Path, system: System, message: str, lost: int, n: int = 400) -> None:
    """Logs of a message's sender and its receiver, 5 ms apart; every `lost`-th is not heard.

    What is behind a frame's data differs in the two, as it may.
    """
    carried = system.messages[message]
    hearer = next(n for n in system.nodes if message in system.received_by(n))
    number = carried.encoding.message.id
    both = int(Flags.FD | Flags.BRS)
    sent, heard = [], []
    for k in range(n):
        data = k.to_bytes(4, "little") * 6
        sent.append((k * 5_000_000, number, both | int(Flags.SENT), data))
        if k % lost:
            heard.append((k * 5_000_000 + 200_000, number, both, data))
    heard.append((n * 5_000_000, 0x700, both, b""))  # somebody else, so that time goes on
    sent.append((n * 5_000_000, 0x700, both, b""))
    frames(nodes / f"{carried.node}.{carried.bus}.frames", sent)
    frames(nodes / f"{hearer}.{carried.bus}.frames", heard)
