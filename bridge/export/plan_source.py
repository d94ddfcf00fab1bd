"""The plan of a node as C: components, operations and outputs (``bridge/c/portable``)."""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import c_double
from typing import final

from bridge.deployment.spec import BusSpec
from bridge.export.image import NodeImage, braces, number
from bridge.export.kernels import KernelSource
from bridge.native import node as native
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError
from cosim.native.enums import Code
from cosim.native.structs import PlayerStruct, UnitStruct
from cosim.schedule.operations import Operation
from cosim.schedule.parts import Slot, Step

_CODES = {
    Code.COPY: "PLAN_COPY",
    Code.SCALE: "PLAN_COPY",
    Code.STEP: "PLAN_STEP",
    Code.GATE: "PLAN_GATE",
    Code.PLAY: "PLAN_PLAY",
    Code.RECORD: "PLAN_RECORD",
}
_LINKS = (Code.PUSH, Code.PULL, Code.AGE)
_KERNEL = """\
size_t {0}_kernel_size(void);
void {0}_kernel_reset(double *x);
const char *{0}_kernel_initial(double *x);
const char *{0}_kernel_step(double *x, double t, double h);
static const kernel_t {0}_kernel = {{{0}_kernel_size, {0}_kernel_reset, {0}_kernel_initial,
                                    {0}_kernel_step}};
"""


def outputs(node: WiredNode) -> list[Slot]:
    """The outputs of its components, in the order of the FMU's."""
    return [slot for step in node.plan.plan.components for slot in step.outputs]


def node_data(node: WiredNode, kernels: Mapping[str, KernelSource]) -> dict[str, str]:
    """``node_data.h`` and ``node_data.c``.

    Raises ScenarioError for a plan with an operation that these FMUs do not have.
    """
    image = NodeImage(node.struct)
    units = _Units(node, kernels)
    tables = _tables(node, image, units)
    head = f"generated from the node {node.name} of a deployment. */"
    parts = [
        f'/* node_data.c - {head}\n#include <math.h>\n\n#include "portable.h"\n#include "inlet.h"\n'
        '#include "outlet.h"',
        *(_KERNEL.format(name) for name in sorted({k.name for k in kernels.values()})),
        *image.constants,
        *units.tables,
        *_played(node),
        *(f"const {name} = {braces(entries)};" for name, entries in tables.items()),
    ]
    return {
        "node_data.h": f"/* node_data.h - {head}\n" + _header(node, image, units),
        "node_data.c": "\n\n".join(parts) + "\n",
    }


def _tables(node: WiredNode, image: NodeImage, units: _Units) -> dict[str, list[str]]:
    """Entries of each table of ``portable.h``, by its declaration."""
    operations = [_operation(o, node.name) for o in node.plan.plan.operations]
    gates = braces(_gates(node, image))
    signals = braces([number(float(v)) for v in node.engine.signals])
    return {
        "rates_t node_rates[N_BUSES]": [
            f"{{{bus.bitrate}u, {bus.data_bitrate if bus.fd else 0}u}}" for bus in _buses(node)
        ],
        "unit_t node_units[N_UNITS]": units.entries,
        "plan_operation_t node_operations[N_OPERATIONS]": operations,
        "move_t node_outputs[N_OUTPUTS]": [
            f"{{{s.start}, {i}, {s.size}}}" for i, s in enumerate(outputs(node))
        ],
        "played_values_t node_players[N_PLAYERS]": [
            f"{{played_{i}, {p.rows}}}" for i, p in enumerate(_players(node))
        ]
        or ["{NULL, 0}"],
        "memory_t node_first": [*image.initial, f".gates = {gates}", f".signals = {signals}"],
        "size_t node_pointers[N_POINTERS]": [f"offsetof(memory_t, {p})" for p in image.pointers],
    }


def _buses(node: WiredNode) -> list[BusSpec]:
    """The buses of the node, in the order of its terminals."""
    d = node.system.deployment
    return [d.buses[name] for name in node.system.buses_of(node.name)]


def _players(node: WiredNode) -> list[PlayerStruct]:
    """Inputs that follow a table, with the values of the whole run."""
    count = len(node.plan.plan.players)
    return list((PlayerStruct * count).from_address(node.engine.state.players)) if count else []


def _played(node: WiredNode) -> list[str]:
    return [
        f"static const double played_{i}[] = "
        f"{braces([number(v) for v in (c_double * p.rows).from_address(p.values)])};"
        for i, p in enumerate(_players(node))
    ]


def _header(node: WiredNode, image: NodeImage, units: _Units) -> str:
    """Sizes, and ``memory_t``. To be made after the tables, which find pointers."""
    plan = node.plan.plan
    counts = {
        "N_SIGNALS": plan.n_signals,
        "N_GATES": max(1, len(plan.gates)),
        "N_VARIABLES": max(1, units.size),
        "N_UNITS": len(plan.components),
        "N_OPERATIONS": len(plan.operations),
        "N_PLAYERS": max(1, len(plan.players)),
        "N_OUTPUTS": len(outputs(node)),
        "N_POINTERS": len(image.pointers),
        "N_BUSES": len(_buses(node)),
        "H": repr(plan.h),
    }
    macros = "".join(f"#define {name} {text}\n" for name, text in counts.items())
    members = "".join(f"    {m}\n" for m in image.members)
    return f"""\
#ifndef NODE_DATA_H
#define NODE_DATA_H

{macros}
typedef struct {{
    node_t node;
{members}    gate_t gates[N_GATES];
    double signals[N_SIGNALS], seen[N_SIGNALS];
    double kernels[N_VARIABLES];
}} memory_t;

#endif
"""


@final
class _Units:
    """Components: `tables` of their values and moves, `entries` of the table of units."""

    def __init__(self, node: WiredNode, kernels: Mapping[str, KernelSource]) -> None:
        self.tables: list[str] = []
        self.entries: list[str] = []
        self.size = 0
        steps = node.plan.plan.components
        units = (UnitStruct * len(steps)).from_address(node.engine.state.units)
        for index, (step, unit) in enumerate(zip(steps, units, strict=True)):
            self._unit(index, step, unit, kernels[step.name])

    def _unit(self, index: int, step: Step, unit: UnitStruct, kernel: KernelSource) -> None:
        values: list[float] = []
        given = []
        for name, flat in step.values.items():
            given.append(f"{{{len(values)}, {kernel.places[name][0]}, {len(flat)}}}")
            values += flat
        moves = {
            "given": given,
            "inputs": [f"{{{s.start}, {kernel.places[s.port][0]}, {s.size}}}" for s in step.inputs],
            "outputs": [
                f"{{{kernel.places[s.port][0]}, {s.start}, {s.size}}}" for s in step.outputs
            ],
        }
        fields = [f'.name = "{step.name}"', f".kernel = &{kernel.name}_kernel"]
        if values:
            numbers = braces([number(float(v)) for v in values])
            self.tables.append(f"static const double values_{index}[] = {numbers};")
            fields.append(f".values = values_{index}")
        for what, entries in moves.items():
            if entries:
                table = f"static const move_t {what}_{index}[]"
                self.tables.append(f"{table} = {braces(entries)};")
                fields.append(f".{what} = {what}_{index}, .n_{what} = {len(entries)}")
        fields += [f".first = {self.size}, .size = {kernel.size}"]
        fields += [f".lag = {unit.lag}, .h = {number(unit.h)}"]
        self.entries.append(braces(fields))
        self.size += kernel.size


def _operation(o: Operation, node: str) -> str:
    """A line of the table of operations. Raises ScenarioError for one that is not there."""
    code = Code(o.code)
    if code not in _CODES:
        what = "a link between its components" if code in _LINKS else "an extrapolated input"
        raise ScenarioError(
            f"found {what}, expected wires between the components of a node, and links from other"
            " nodes: one without Python has no others",
            f"node {node}",
        )
    fields = (_CODES[code], o.index, o.period, o.first, o.source, o.target, o.count)
    return "{" + ", ".join(map(str, fields)) + f", {o.gain!r}, {o.offset!r}}}"


def _gates(node: WiredNode, image: NodeImage) -> list[str]:
    """The calls of the plan at each of its gates, with the struct that each is given."""
    kinds = {
        native.address("inlet_pass"): ("inlet_pass", native.InletStruct),
        native.address("outlet_pass"): ("outlet_pass", native.OutletStruct),
        native.address("inside_pass"): ("inside_pass", native.Inside),
    }
    found = {**node.inlet_bindings.gates, **node.outlet_bindings.gates}
    entries = []
    for i, gate in enumerate(node.plan.plan.gates):
        address, context = found[gate.name]
        name, kind = kinds[address]
        entries.append(f"{{{name}, {image.pointer(context, kind, f'gates[{i}].context')}}}")
    return entries or ["{NULL, NULL}"]
