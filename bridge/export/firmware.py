"""Nodes of a deployment as firmware: a folder with C sources that ``make`` turns into an image.

The node is that of the twin and of rehearsals, by the same C files (``bridge/c``), compiled without
a system and without a C library, with the tables of its deployment and the kernels of its
components inside. ``hal.h`` is all that it needs of a board.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bridge.deployment.system import System
from bridge.export.kernels import KernelSource, kernels
from bridge.export.node_fmu import UNITS, check, check_tables
from bridge.export.plan_source import node_data
from bridge.native import node as native
from bridge.replay.twin import memory_buses
from bridge.wiring.wiring import WiredNode, heard_dtype, row_dtype
from cosim.base.errors import ScenarioError

TARGETS = ("cortex-m4", "cortex-m7", "riscv32", "native")
#: The most values a message may have: ``MESSAGE_FIELDS`` of firmware (``target.h``).
FIELDS = 64
_C = Path(__file__).parent.parent / "c"
#: Files of firmware besides: its life on the wall clock.
_WALL = ("idle", "shutdown", "start", "wall_clock")
#: Files of a kernel for several instances at once, which a node does not have.
_LANES = ("lanes_4.c", "lanes_8.c", "steps.c")


@dataclass(frozen=True, slots=True)
class Firmware:
    """A node as C: `files` by path in the folder; `token` of its tables, 16 bytes."""

    files: Mapping[str, str]
    token: bytes


def export_firmware(system: System, name: str, folder: Path, target: str, *, real: bool) -> None:
    """Write the firmware of a node into `folder`, to be built for `target` (of :data:`TARGETS`).

    `real`: it may move real drives, and refuses samples that are marked as simulated. Raises
    ScenarioError for a node that cannot be firmware, FmuError for a component without a C kernel.
    """
    made = firmware(system, name, target, real=real)
    for path, text in made.files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


def firmware(system: System, name: str, target: str, *, real: bool = False) -> Firmware:
    """The sources of a node. Errors as of :func:`export_firmware`."""
    check(system, name)
    with (
        tempfile.TemporaryDirectory(prefix="firmware-") as scratch,
        WiredNode(
            system,
            name,
            memory_buses(system, name),
            Path(scratch) / "node.journal",
            native.SIMULATED,
            real=real,
        ) as node,
    ):
        check_tables(node)
        _check_messages(system, name)
        found = kernels([(s.name, s.component) for s in node.plan.plan.components])
        data = node_data(node, found)
        token = hashlib.sha256("".join(data.values()).encode()).digest()[:16]
        data["node_data.h"] = data["node_data.h"].replace(
            "\ntypedef struct", f"{_sizes(node, token)}\ntypedef struct", 1
        )
        files = {**_files(), **_controllers(found), **{f"node/{n}": t for n, t in data.items()}}
        files["Makefile"] = files["Makefile"].replace("TARGET = cortex-m4", f"TARGET = {target}", 1)
        files["README.md"] = _filled(files["README.md"], node, target)
        return Firmware(files, token)


def _check_messages(system: System, name: str) -> None:
    """True if firmware has room for the messages of a node. Raises ScenarioError."""
    for message, m in system.messages.items():
        width = m.outlet.width
        if width > FIELDS and (m.node == name or message in system.received_by(name)):
            raise ScenarioError(
                f"found message {message} with {width} values, expected at most {FIELDS} in"
                " firmware",
                f"node {name}",
            )


def _sizes(node: WiredNode, token: bytes) -> str:
    """Macros of what a host is told, and of the rows that it is sent."""
    system, name, plan = node.system, node.name, node.plan
    per_slot = sum(
        2 + 2 * -(-node.struct.h_ns // system.messages[m].period_ns)
        for m in system.received_by(name)
    )
    text = ", ".join(f"0x{byte:02x}" for byte in token)
    return (
        f'#define NODE_NAME "{name}"\n'
        f"#define TOKEN_BYTES {{{text}}}\n"
        f"#define ROW_SIZE {row_dtype(plan).itemsize}\n"
        f"#define HEARD_SIZE {heard_dtype(system, name).itemsize}\n"
        f"#define HEARD_ROWS {max(1, per_slot)}\n"
    )


def _filled(text: str, node: WiredNode, target: str) -> str:
    """The README, about this node."""
    d = node.system.deployment
    buses = [(name, d.buses[name]) for name in node.system.buses_of(node.name)]
    facts = {
        "node": node.name,
        "number": str(node.struct.number),
        "title": d.title,
        "target": target,
        "components": ", ".join(c.name for c in node.plan.plan.components),
        "buses": "\n".join(
            f"| {i}: {name} | {bus.bitrate} | {bus.data_bitrate if bus.fd else 'classic'} |"
            for i, (name, bus) in enumerate(buses)
        ),
        "real": "It may move real drives, and refuses samples that are marked as simulated."
        if node.real
        else "Its messages are marked as simulated, and no real drive takes them (`--real`).",
    }
    for name, value in facts.items():
        text = text.replace("{" + name + "}", value)
    return text


def _files() -> dict[str, str]:
    """The C files that do not depend on the node, by their place in the folder."""
    core = [*(_C / f"{name}.c" for name in (*UNITS, *_WALL)), *_C.glob("*.h")]
    core += (_C / "portable").glob("*.[ch]")
    found = {f"core/{file.name}": file for file in core}
    found |= {f"core/firmware.{kind}": _C / "firmware" / f"firmware.{kind}" for kind in "ch"}
    others = (file for file in (_C / "firmware").rglob("*") if file.is_file())
    for file in others:
        found.setdefault(str(file.relative_to(_C / "firmware")), file)
    for kind in "ch":
        found.pop(f"firmware.{kind}")
    return {place: found[place].read_text(encoding="utf-8") for place in sorted(found)}


def _controllers(found: Mapping[str, KernelSource]) -> dict[str, str]:
    """The kernels of the components, without their steps of several instances at once."""
    files = {}
    for kernel in found.values():
        for name, text in kernel.sources().items():
            if not name.endswith(_LANES):
                files[f"controllers/{name}"] = text
        files[f"controllers/{kernel.name}_variables.c"] = (
            f'#include "{kernel.name}/names.h"\n#include "{kernel.name}/declaration.h"\n'
            "#undef model_steps\n#undef model_lanes\n#define model_steps NULL\n"
            f'#define model_lanes NULL\n#include "{kernel.name}/variables.c"\n'
        )
    return files
