"""The structs of a node as C: a node that is wired in memory, written as the data of a C file.

Everything that the node points to is found by the types of its pointers. What a node changes
becomes a member of ``memory_t``, of which each instance has a copy that points into itself; what
stays as it is becomes a constant.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isnan
from typing import Any, final

from bridge.native import message, node, safety
from bridge.native.commanded import CommandedStruct, StepStruct, ToldStruct
from bridge.native.delay import Delay, SampleStruct, WaitingStruct
from bridge.native.frame import Frame
from cosim.base.errors import CosimError

Count = Callable[[Any], int]
_I64_MIN = -(1 << 63)
_NAMES: Mapping[type, str] = {
    node.NodeStruct: "node_t",
    node.Reception: "reception_t",
    node.InletStruct: "inlet_t",
    node.OutletStruct: "outlet_t",
    node.MotorStruct: "motor_t",
    node.Inside: "inside_t",
    node.Apart: "apart_t",
    node.Services: "services_t",
    message.Message: "message_t",
    message.Field: "field_t",
    message.Limit: "limit_t",
    message.Receiver: "receiver_t",
    safety.Guard: "guard_t",
    safety.DriveStruct: "drive_t",
    safety.Peer: "peer_t",
    Delay: "delay_t",
    SampleStruct: "sample_t",
    WaitingStruct: "waiting_t",
    Frame: "frame_t",
    CommandedStruct: "commanded_t",
    ToldStruct: "told_t",
    StepStruct: "step_t",
    c.c_double: "double",
    c.c_int64: "int64_t",
}


@dataclass(frozen=True, slots=True)
class _Target:
    """The target of a pointer: `count` elements; `kept`: the node does not change them."""

    kind: Any
    count: Count
    kept: bool = False
    empty: bool = False  # its contents do not matter at the start


def _one(kind: type, *, kept: bool = False) -> _Target:
    return _Target(kind, lambda x: 1, kept)


def _many(kind: type, field: str, *, kept: bool = False, empty: bool = False) -> _Target:
    return _Target(kind, lambda x: int(getattr(x, field)), kept, empty)


def _joints(*, kept: bool = True) -> _Target:
    return _many(c.c_double, "joints", kept=kept)


_MESSAGE = _one(message.Message, kept=True)
#: By struct, what each pointer points to. Pointers that are in no table are NULL in the FMU.
_POINTERS: Mapping[type, Mapping[str, _Target]] = {
    node.NodeStruct: {
        "receptions": _many(node.Reception, "n_receptions"),
        "inlets": _many(node.InletStruct, "n_inlets"),
        "outlets": _many(node.OutletStruct, "n_outlets"),
        "insides": _many(node.Inside, "n_insides"),
        "aparts": _many(node.Apart, "n_aparts"),
        "peers": _many(safety.Peer, "n_peers"),
        "services": _many(node.Services, "n_buses"),
        "commanded": _many(CommandedStruct, "n_commanded"),
        "motors": _many(node.MotorStruct, "n_motors"),
    },
    node.Reception: {
        "message": _MESSAGE,
        "receiver": _one(message.Receiver),
        "values": _many(c.c_double, "width"),
        "limits": _many(message.Limit, "width", kept=True),
    },
    node.InletStruct: {
        "node": _one(node.NodeStruct),
        "reception": _one(node.Reception),
        "delay": _one(Delay),
        "drive": _one(safety.DriveStruct),
        "command": _many(c.c_double, "count"),
        "initial": _many(c.c_double, "count"),
        "motor": _one(node.MotorStruct),
        "faults": _many(node.MotorFault, "n_faults"),
    },
    node.OutletStruct: {
        "node": _one(node.NodeStruct),
        "message": _MESSAGE,
        "sources": _many(c.c_int64, "width", kept=True),
        "values": _many(c.c_double, "width"),
        "guard": _one(safety.Guard),
        "drive": _one(safety.DriveStruct),
        "commanded": _one(CommandedStruct),
        "motor": _one(node.MotorStruct),
    },
    CommandedStruct: {
        "told": _many(ToldStruct, "n_told", kept=True),
        "steps": _many(StepStruct, "n_steps", kept=True),
        "disabling": _many(Frame, "n_disabling", kept=True),
    },
    node.Inside: {"node": _one(node.NodeStruct), "guard": _one(safety.Guard)},
    node.Apart: {name: _one(node.Reception) for name in ("a", "b")},
    node.Services: {
        name: _MESSAGE
        for name in ("heartbeat", "sync", "nmt", "estop", "epoch", "host_heartbeat", "host_sync")
    },
    message.Message: {
        "fields": _many(message.Field, "n_fields", kept=True),
        "header": _Target(message.Field, lambda m: max(m.status, m.time) + 1, kept=True),
    },
    safety.Guard: {
        **{name: _joints() for name in ("tau_max", "rate_max", "q_low", "q_high", "dq_max")},
        **{name: _joints() for name in ("power_max", "q_jump")},
        **{name: _joints(kept=False) for name in ("last_tau", "last_q")},
    },
    safety.DriveStruct: {"tau_max": _joints(), "tau": _joints(kept=False)},
    Delay: {
        "delays": _many(c.c_double, "n_delays", kept=True),
        "samples": _many(SampleStruct, "capacity", empty=True),
        "queue": _many(WaitingStruct, "capacity", empty=True),
        "line": _many(c.c_int64, "depth", empty=True),
        "values": _Target(c.c_double, lambda d: (d.capacity + 1) * d.width, empty=True),
    },
}
#: Parts of a node that whoever runs it sets, or that exist on Linux only.
_OUTSIDE = frozenset(
    {"engine", "run", "signals", "record", "record_row", "buses", "journal", "heard", "pending"}
    | {"has_pending", "played", "n_played", "joined", "faults", "replayed", "lead_ns"}
    | {"drive_events", "boots"}
)
_FIRST = "node_first"


@dataclass(frozen=True, slots=True)
class _Block:
    """Memory that has its place in C: `count` elements of `size` bytes from `address`."""

    address: int
    size: int
    count: int
    text: str
    kind: type
    inside: bool


@final
class NodeImage:
    """A node as C. `members`: of ``memory_t`` behind `node`; `constants`: definitions of tables;
    `initial`: initializers of the members; `pointers`: the members that point into ``memory_t``.
    """

    def __init__(self, struct: node.NodeStruct) -> None:
        self._node = struct
        self._blocks: list[_Block] = []
        self.members: list[str] = []
        self.constants: list[str] = []
        self.initial: list[str] = []
        self.pointers: list[str] = []
        self._add(_Block(c.addressof(struct), c.sizeof(struct), 1, "node", type(struct), True))
        for name in ("commanded", "motors"):  # whole, before inlets and outlets point into them
            at = c.cast(getattr(struct, name), c.c_void_p).value
            if at:
                self._place(at, _POINTERS[node.NodeStruct][name], struct, name)
        self.initial.insert(0, f".node = {self._struct(struct, 'node')}")

    def pointer(self, address: int, kind: type, place: str) -> str:
        """An address in memory that is in the image, as an expression of the member `place`.

        Raises CosimError where it is not in the image.
        """
        for b in self._blocks:
            index, rest = divmod(address - b.address, b.size)
            if b.kind is kind and 0 <= index < b.count and rest == 0:
                if not b.inside:
                    return f"({_NAMES[kind]} *)&{b.text}[{index}]"
                self.pointers.append(place)
                single = b.text == "node"
                at = f"{_FIRST}.{b.text}" + ("" if single else f"[{index}]")
                return f"({_NAMES[kind]} *)&{at}"
        raise CosimError(f"found a pointer to memory that belongs to no part of the node: {place}")

    def _add(self, block: _Block) -> None:
        self._blocks.append(block)

    def _known(self, address: int, kind: type) -> bool:
        return any(
            b.kind is kind and b.address <= address < b.address + b.size * b.count
            for b in self._blocks
        )

    def _place(self, address: int, target: _Target, owner: Any, name: str) -> None:
        """Give what is at an address its place in C, with all that it points to."""
        kind, count = target.kind, target.count(owner)
        if self._known(address, kind) or count < 1:
            return
        text = f"{name}_{len(self._blocks)}"
        self._add(_Block(address, c.sizeof(kind), count, text, kind, not target.kept))
        if not target.kept:
            self.members.append(f"{_NAMES[kind]} {text}[{count}];")
        if target.empty:
            return
        found = (kind * count).from_address(address)
        entries = [self._entry(x, f"{text}[{i}]") for i, x in enumerate(found)]
        if target.kept:
            head = f"static const {_NAMES[kind]} {text}[{count}]"
            self.constants.append(f"{head} = {braces(entries)};")
        else:
            self.initial.append(f".{text} = {braces(entries)}")

    def _entry(self, value: Any, place: str) -> str:
        return self._struct(value, place) if isinstance(value, c.Structure) else number(value)

    def _struct(self, x: c.Structure, place: str) -> str:
        """An initializer of a struct: what is 0 or NULL is left out."""
        parts = []
        for name, kind, *_ in x._fields_:
            if isinstance(x, node.NodeStruct) and name in _OUTSIDE:
                continue
            text = self._field(x, str(name), kind, f"{place}.{name}")
            parts += [f".{name} = {text}"] if text else []
        return braces(parts or ["0"])

    def _field(self, x: c.Structure, name: str, kind: Any, place: str) -> str:
        value = getattr(x, name)
        if isinstance(x, node.Services) and name == "peers":
            return self._peers(value, place)
        target = _POINTERS.get(type(x), {}).get(name)
        if target is not None:
            address = value if kind is c.c_void_p else c.cast(value, c.c_void_p).value
            if not address or target.count(x) < 1:
                return ""
            self._place(address, target, x, name)
            return self.pointer(address, target.kind, place)
        if isinstance(value, c.Structure):
            text = self._struct(value, place)
            return "" if text == "{0}" else text
        if isinstance(value, c.Array) and not any(bytes(value)):
            return ""
        if isinstance(value, c.Array):
            last = max((i for i, v in enumerate(value) if v), default=-1)  # the others are 0 in C
            return braces([number(v) for v in value[: last + 1]]) if last >= 0 else ""
        if kind is c.c_void_p or hasattr(kind, "contents"):
            if value:
                raise CosimError(f"{type(x).__name__}.{name}: found a pointer, expected none")
            return ""
        return number(value) if value else ""

    def _peers(self, address: int, place: str) -> str:
        """The heartbeats of the peers, NULL of those without."""
        count = self._node.n_peers
        if not count:
            return ""
        entries = []
        for at in (c.c_void_p * count).from_address(address):
            if at:
                self._place(at, _MESSAGE, None, "heartbeat")
            entries.append(self.pointer(at, message.Message, place) if at else "NULL")
        name = f"peers_{len(self._blocks)}"
        self.constants.append(f"static const message_t *const {name}[] = {braces(entries)};")
        return f"(const message_t **){name}"


def braces(entries: Sequence[str]) -> str:
    """An initializer of C, in lines of 100 columns where it can be."""
    lines, line = [], "{"
    for i, entry in enumerate(entries):
        text = entry + ("," if i + 1 < len(entries) else "}")
        if len(line) + len(text) > 96 and line.strip("{ "):
            lines.append(line)
            line = ""
        line += (" " if line.strip("{ ") else "") + text
    return "\n    ".join([*lines, line])


def number(value: float | int) -> str:
    """A literal of C with this very value, which has no unit here."""
    if isinstance(value, float):
        if isnan(value):
            return "NAN"
        return {inf: "INFINITY", -inf: "-INFINITY"}.get(value) or repr(value)
    if value == _I64_MIN:
        return "INT64_MIN"
    if -(1 << 31) < value < 1 << 31:
        return str(int(value))
    return f"INT64_C({value})" if value < 1 << 63 else f"UINT64_C({value})"
