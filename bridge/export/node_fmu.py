"""Nodes of a deployment as network FMUs of FMI-LS-BUS 1.0.

A node FMU executes the slots of its node as the twin does, by the same C code (``bridge/c``), with
the C kernels of its components and the tables of its deployment inside. What it sends and receives
goes through CAN terminals, which have the names of its buses.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bridge.deployment.system import System
from bridge.export.kernels import kernels
from bridge.export.plan_source import node_data, outputs
from bridge.replay import twin
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError
from cosim.links.laws import Constant
from cosim.links.table import DrawnTable
from cosim.schedule.parts import Link
from fmus.build.archive import write_archive
from fmus.build.lsbus_fmu import (
    LsBusFmu,
    SignalOutput,
    binaries,
    entries,
    shell_sources,
    token_of,
)

#: Delays of a link, or values of an input, that an FMU may bring, drawn before the run.
DRAWN = 1_000_000
_C = Path(__file__).parent.parent / "c"
#: The parts of ``bridge/c`` that a node without a system consists of, in an FMU or as firmware.
UNITS = (
    *("bringup", "crc", "delay", "dispatch", "drive", "e2e", "emulated", "epoch", "forward"),
    *("guard", "inlet", "journal", "life_cycle", "limit", "message", "outlet", "receiver"),
    *("reception", "run_epoch", "sample_journal", "send", "service", "slot", "vendor"),
    *("vendor_damiao", "vendor_odrive", "vendor_cia402", "watchdog"),
)


def export_nodes(
    system: System, names: Sequence[str], folder: Path, platforms: Sequence[str] | None = None
) -> list[Path]:
    """Write ``FOLDER/NODE.fmu`` for each node, and return their paths.

    `platforms`: of :data:`fmus.build.toolchain.PLATFORMS`; default the host's. Raises ScenarioError
    for a node that cannot be such an FMU, FmuError for a component without a C kernel, and
    fmus.build.toolchain.ToolchainError from the compiler.
    """
    for name in names:
        check(system, name)
    with (
        tempfile.TemporaryDirectory(prefix="node-fmu-") as scratch,
        twin.wired_nodes(system, Path(scratch)) as nodes,
    ):
        objects = Path(scratch) / "objects"
        return [_write(nodes[name], folder / f"{name}.fmu", platforms, objects) for name in names]


def check(system: System, name: str) -> None:
    """True if a node can be a network FMU. Raises ScenarioError."""
    d = system.deployment
    if name not in d.nodes:
        raise ScenarioError(
            f"found no node {name!r}, expected one of {', '.join(d.nodes)}", str(d.path)
        )
    place, buses = d.place("nodes", name), system.buses_of(name)
    if not d.nodes[name].components or system.nodes[name].forwards:
        raise ScenarioError("found a gateway, expected a node that forwards nothing", place)
    if not buses:
        raise ScenarioError("found no bus, expected a node that sends or receives", place)
    for bus in buses:
        if d.buses[bus].kind != "can":
            raise ScenarioError(
                f"found bus {bus} of the kind {d.buses[bus].kind}, expected a CAN bus", place
            )


def notes(system: System, name: str) -> list[str]:
    """The differences of the FMU from the node of a rehearsal, for its user."""
    spec = system.deployment.nodes[name]
    buses = system.buses_of(name)
    queues = ", ".join(sorted({system.deployment.buses[bus].queue for bus in buses}))
    found = [
        "ACTIVE from t = 0, as in the twin: no ARM, START, EPOCH or previews before",
        "goes on after the end of the scenario",
        f'its transmit queue is the importer\'s; the deployment has queue = "{queues}"',
    ]
    if len(buses) > 1:
        found.append(
            f"{len(buses)} CAN terminals ({', '.join(buses)}): for other importers, since those of"
            " a scenario have one"
        )
    if spec.apart is not None:
        found.append("positions are not compared at the start (apart)")
    if system.nodes[name].plan.players:
        found.append("values of inputs over time end with the scenario; the last ones are kept")
    links = [i.link for i in system.nodes[name].inlets if i.link is not None]
    if links and system.deployment.latency and not all(_constant(link) for link in links):
        length = system.plan.ticks * system.plan.h
        found.append(f"the delays of links are those drawn for {length:g} s; then they repeat")
    return found


def _constant(link: Link) -> bool:
    """True if its delay is the same for all samples."""
    return isinstance(link.table, DrawnTable) and isinstance(link.table.law, Constant)


def _write(node: WiredNode, target: Path, platforms: Sequence[str] | None, objects: Path) -> Path:
    system = node.system
    check_tables(node)
    identifier = re.sub(r"\W", "_", f"node_{node.name}")
    found = kernels([(s.name, s.component) for s in node.plan.plan.components])
    sources = {
        **shell_sources(),
        **_bridge_sources(),
        **{name: text for k in found.values() for name, text in k.sources().items()},
        **node_data(node, found),
    }
    token = token_of(sources)
    sources["node_data.h"] = sources["node_data.h"].replace(
        "\ntypedef struct", f'#define TOKEN "{token}"\n\ntypedef struct', 1
    )
    fmu = LsBusFmu(
        name=node.name,
        identifier=identifier,
        description=f"Node {node.name} of {system.deployment.title}: "
        + ", ".join(s.name for s in node.plan.plan.components),
        token=token,
        terminals=system.buses_of(node.name),
        outputs=tuple(SignalOutput(s.name, s.shape, s.unit) for s in outputs(node)),
    )
    content = {name: text.encode() for name, text in entries(fmu, sources).items()}
    content |= binaries(identifier, sources, platforms, objects)
    write_archive(content, target)
    return target


def check_tables(node: WiredNode) -> None:
    """True if what was drawn for the run has a size for C. Raises ScenarioError."""
    sizes = {f"delays of the link to {name}": x.struct.n_delays for name, x in node.lines.items()}
    hits = {c.name: node.plan.slots // c.period for c in node.plan.plan.components}
    for player in node.plan.plan.players:
        sizes[f"values of {player.target.name}"] = hits[player.target.component]
    for what, size in sizes.items():
        if size > DRAWN:
            raise ScenarioError(
                f"found {size} {what}, expected at most {DRAWN}: a shorter run"
                " (--set run.stop=...)",
                f"node {node.name}",
            )


def _bridge_sources() -> dict[str, str]:
    """The C files of a node, by name, with all headers of ``bridge/c``."""
    files = [_C / f"{name}.c" for name in UNITS]
    files += [*_C.glob("*.h")]
    files += [file for part in ("portable", "lsbus") for file in (_C / part).glob("*.[ch]")]
    return {file.name: file.read_text(encoding="utf-8") for file in sorted(files)}
