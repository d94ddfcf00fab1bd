"""Exported nodes in a scenario, in FMPy, and what the twin of the same deployment does."""

from __future__ import annotations

import ctypes as c
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bridge.can.log import frame_of
from bridge.deployment.system import System
from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.replay import twin
from bridge.wiring.wiring import WiredNode
from cosim.engine.simulate import simulate
from cosim.record import Run
from cosim.scenario.spec import build
from fmus.build.archive import write_archive
from fmus.build.lsbus_fmu import binaries
from tests.bridge.deployments import document, run_twin, system_of
from tests.bridge.replay.test_networks import heard_by_all, on_one_bus

Frames = list[tuple[int, int, bytes]]


def bare(found: dict[str, Any]) -> dict[str, Any]:
    """A deployment without services, guards, drives, stale inputs and links' delays."""
    found["latency"] = False
    for bus in found["buses"].values():
        bus["services"] = []
    for key in ("sync", "set"):
        found.pop(key, None)
    for node in found["nodes"].values():
        for key in ("guard", "drive", "stale", "requires"):
            node.pop(key, None)
    return found


def one_bus(name: str = "can-one-bus") -> dict[str, Any]:
    """A deployment of configs/deploy, its two arms on one bus."""
    return document(name) if name == "can-one-bus" else on_one_bus(name)


def system(folder: Path, found: Mapping[str, Any], stop: float) -> System:
    """The teleoperator under a deployment, for `stop` s."""
    folder.mkdir(exist_ok=True)
    return system_of(found, folder, f"run.stop={stop}")


def twin_frames(found: System, folder: Path) -> Frames:
    """Frames of the twin: end of the frame (ns), identifier, data."""
    folder.mkdir(exist_ok=True)
    return [(t, f.id, f.payload) for t, f in heard_by_all(found, folder).items()]


def heard_on_buses(found: System, folder: Path) -> dict[str, Frames]:
    """Frames of the twin as :func:`twin_frames`, by bus."""
    folder.mkdir(exist_ok=True)
    logs: dict[str, list[Journal]] = {name: [] for name in found.deployment.buses}

    def log(node: WiredNode) -> None:
        for name, bus in zip(found.buses_of(node.name), node.buses, strict=True):
            path = folder / f"{node.name}-{name}.frames"
            logs[name].append(Journal.create(path, frame_dtype(64), 10_000))
            bus.struct.log = c.pointer(logs[name][-1].struct)

    with twin.wired_nodes(found, folder, log) as nodes:
        twin.run(found, nodes)
    heard = {
        name: sorted(
            {(int(row["t_ns"]), frame.id, frame.payload)
             for journal in journals for row in journal.rows
             if not row["flags"] & Flags.SENT and (frame := frame_of(row))}
        )
        for name, journals in logs.items()
    }  # fmt: skip
    for journals in logs.values():
        for journal in journals:
            journal.close()
    return heard


def rounded(frames: Frames) -> Frames:
    """The same with times in us, rounded down, as logs have them."""
    return [(t // 1000, identifier, data) for t, identifier, data in frames]


def received_ps(folder: Path) -> list[int]:
    """The times at which frames were received in a run, ps, each once."""
    (table,) = folder.glob("*.operations.tsv")
    lines = (line.split("\t") for line in table.read_text("utf-8").splitlines()[1:])
    times = {
        at for at, _, direction, what in lines if direction == "received" and "Transmit" in what
    }
    return sorted(int(at.replace(".", "")) for at in times)


def run_nodes(found: System, fmus: Mapping[str, Path], folder: Path) -> Path:
    """A scenario of node FMUs on a bus as that of their deployment; its run folder."""
    folder.mkdir(exist_ok=True)
    (name,) = {bus for node in fmus for bus in found.buses_of(node)}
    spec = found.deployment.buses[name]
    fd = {"data_bitrate": spec.data_bitrate, "fd": True} if spec.fd else {}
    nodes = {node: {"queue": spec.queue} for node in fmus}
    given = {
        "run": {"step": found.plan.h, "stop": found.plan.ticks * found.plan.h},
        "bus": {name: {"bitrate": spec.bitrate, **fd, "nodes": nodes}},
        "components": {n: {"model": str(path), "bus": name} for n, path in fmus.items()},
    }
    simulate(build(given, folder / "nodes.toml"), folder / "run")
    return folder / "run"


def logged(folder: Path) -> Frames:
    """The frames of the only bus of a run."""
    (log,) = folder.glob("*.log")
    found = []
    for line in log.read_text("utf-8").splitlines():
        at, _, frame = line.split()
        identifier, _, data = frame.partition("#")
        data = data[2:] if data.startswith("#") else data
        time = round(float(at.strip("()")) * 1e6)
        found.append((time, int(identifier, 16), bytes.fromhex(data)))
    return found


def trajectories(folder: Path, node: str, output: str) -> Any:
    """An output of a node FMU at the ticks of a run, (ticks + 1, entries)."""
    return Run.open(folder).array(f"{node}.{output}")


def twin_rows(found: System, folder: Path, node: str, output: str) -> Any:
    """The same signal in the twin at the slots of the node, (slots, entries)."""
    rows = run_twin(found, folder)
    slot = found.nodes[node].plan.slots()[output]
    return np.array(rows[node]["signals"][:, slot.start : slot.start + slot.size])


def rebuilt(path: Path, target: Path, file: str, old: str, new: str) -> Path:
    """A node FMU whose source `file` has `new` in place of `old`, compiled again."""
    with zipfile.ZipFile(path) as archive:
        content = {n: archive.read(n) for n in archive.namelist() if not n.startswith("binaries/")}
    sources = {
        name.removeprefix("sources/"): text.decode()
        for name, text in content.items()
        if name.endswith((".c", ".h"))
    }
    assert sources[file].count(old) == 1, (file, old)
    sources[file] = sources[file].replace(old, new)
    content |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    content |= binaries(f"node_{path.stem}", sources)
    write_archive(content, target)
    return target


def without_binaries(path: Path, target: Path) -> Path:
    """The same FMU with nothing but sources."""
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if not n.startswith("binaries/")]
        write_archive({n: archive.read(n) for n in names}, target)
    return target
