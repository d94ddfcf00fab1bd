"""The table of a node as C: ``table.h`` and ``table.c``."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import final

from bridge.export.image import braces, number
from bridge.native.message import FieldKind
from bridge.sdk.table import FieldEntry, LayoutEntry, NodeTable, ReceivedEntry, SentEntry
from cosim.base.errors import ScenarioError

#: The most messages and neighbours of a node, and values of a message: participant.h.
RECEIVED, SENT, NEIGHBOURS, BUSES, VALUES = 16, 8, 31, 8, 64


def header(table: NodeTable) -> str:
    """``table.h``: the numbers of the messages, with the names and units of their values."""
    lines = [
        f"/* table.h: node {table.node} of its deployment. Written by `cosim new participant`. */",
        "#ifndef TABLE_H",
        "#define TABLE_H",
        "",
        '#include "participant.h"',
        "",
        "/* Received messages: participant_input(p, IN_NAME)[value]. */",
        *_numbers("IN", table.received),
        "/* Sent messages: participant_output(p, OUT_NAME)[value]. */",
        *_numbers("OUT", table.sent),
        "",
        "extern const participant_table_t TABLE;",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _numbers(prefix: str, entries: Sequence[ReceivedEntry] | Sequence[SentEntry]) -> list[str]:
    if not entries:
        return ["/* none */"]
    names = (f"{prefix}_{identifier(m.name)} /* {', '.join(m.values)} */" for m in entries)
    return ["enum {", *(f"    {name}," for name in names), "};"]


def identifier(name: str) -> str:
    """A name of the deployment as an identifier of C."""
    return "".join(x if x.isascii() and x.isalnum() else "_" for x in name)


def source(table: NodeTable) -> str:
    """``table.c``. Raises ScenarioError for a node that is too large for ``participant.h``."""
    _check(table)
    return _Source(table).text()


def _check(table: NodeTable) -> None:
    layouts = [*(m.layout for m in table.received), *(m.layout for m in table.sent)]
    for what, found, most in (
        ("received messages", len(table.received), RECEIVED),
        ("sent messages", len(table.sent), SENT),
        ("other nodes", len(table.neighbours), NEIGHBOURS),
        ("buses", len(table.buses), BUSES),
        ("values of a message", max((len(x.fields) for x in layouts), default=0), VALUES),
    ):
        if found > most:
            raise ScenarioError(
                f"found {found} {what}, expected at most {most} (participant.h)", table.node
            )


@final
class _Source:
    """The definitions, in the order in which C needs them."""

    def __init__(self, table: NodeTable) -> None:
        self._table = table
        self._lines: list[str] = []
        self._known: dict[tuple[str, str], str] = {}

    def text(self) -> str:
        """The whole file."""
        t = self._table
        received = self._array("received_t", [self._received(m) for m in t.received])
        sent = self._array("sent_t", [self._sent(m) for m in t.sent])
        neighbours = self._array(
            "neighbour_t",
            [
                _struct(
                    name=_text(n.name), key=_text(n.heartbeat.key),
                    heartbeat=self._layout(n.heartbeat), bus=t.bus_number(n.bus), number=n.number,
                    required=n.required, takes=n.takes, within_ns=n.within_ns,
                )
                for n in t.neighbours
            ],
        )  # fmt: skip
        buses = self._array("bus_table_t", self._buses())
        whole = _struct(
            node=_text(t.node), number=t.number, simulated=1, h_ns=t.h_ns, phase_ns=t.phase_ns,
            slots=t.slots, heartbeat_slots=t.heartbeat_slots, sync_slots=t.sync_slots,
            ramp_slots=t.ramp_slots, overrun_ns=t.overrun_ns, patience_ns=t.patience_ns,
            n_buses=len(t.buses), n_received=len(t.received), n_sent=len(t.sent),
            n_neighbours=len(t.neighbours), buses=buses, received=received, sent=sent,
            neighbours=neighbours,
        )  # fmt: skip
        head = f"/* table.c: node {t.node}. Written by `cosim new participant`. */"
        table = f"const participant_table_t TABLE = {whole};"
        return "\n".join([head, '#include "table.h"', "", *self._lines, "", table, ""])

    def _array(self, kind: str, entries: Sequence[str]) -> str:
        """The name of an array with these entries, or NULL without any."""
        if not entries:
            return "NULL"
        body = ",\n    ".join(entries)
        name = self._known.get((kind, body))
        if name is None:
            name = f"{kind.removesuffix('_t').upper()}_{len(self._known) + 1}"
            self._known[kind, body] = name
            self._lines.append(f"static const {kind} {name}[] = {{\n    {body}}};")
        return name

    def _buses(self) -> list[str]:
        found = []
        for bus in self._table.buses:
            layouts = {what: f"&{self._message(layout)}" for what, layout in bus.services.items()}
            keys = {f"{what}_key": _text(layout.key) for what, layout in bus.services.items()}
            keys.pop("sync_key", None)
            found.append(_struct(name=_text(bus.name), prefix=_text(bus.prefix), **keys, **layouts))
        return found

    def _message(self, layout: LayoutEntry) -> str:
        return f"{self._array('message_t', [self._layout(layout)])}[0]"

    def _received(self, m: ReceivedEntry) -> str:
        limits = [
            _struct(low=low, high=high, rate=rate, falls=falls)
            for low, high, rate, falls in m.limits
        ]
        sender = next((n.number for n in self._table.neighbours if n.name == m.sender), 0)
        return _struct(
            name=_text(m.name), key=_text(m.layout.key), layout=self._layout(m.layout),
            bus=self._table.bus_number(m.bus), sender=sender, period_ns=m.period_ns,
            offset_ns=m.offset_ns, max_age_ns=m.max_age_ns, stop_ns=m.stop_ns,
            watchdog_ns=m.watchdog_ns, torque=m.torque, awaited=m.awaited,
            limits=self._array("limit_t", limits),
        )  # fmt: skip

    def _sent(self, m: SentEntry) -> str:
        return _struct(
            name=_text(m.name), key=_text(m.layout.key), layout=self._layout(m.layout),
            bus=self._table.bus_number(m.bus), every=m.every, first_torque=m.torque[0],
            torques=m.torque[1], start=self._array("double", [number(x) for x in m.start]),
            tau_max=self._array("double", [number(x) for x in m.tau_max]),
        )  # fmt: skip

    def _layout(self, m: LayoutEntry) -> str:
        header = [f for f in (m.status, m.time) if f is not None]
        flags = ("FRAME_FD" * m.fd, "FRAME_BRS" * m.brs, "FRAME_EXTENDED" * m.extended)
        fields = self._array("field_t", [_field(f) for f in m.fields])
        headers = self._array("field_t", [_field(f) for f in header])
        return _struct(
            id=f"0x{m.id:X}", length=m.bytes, flags=" | ".join(filter(None, flags)) or 0,
            e2e=f"E2E_{m.profile}", data_ids=_bytes(m.data_id), n_fields=len(m.fields),
            status=0 if m.status else -1, time=len(header) - 1 if m.time else -1,
            fields=f"(field_t *){fields}", header=f"(field_t *){headers}", fill=_bytes(m.fill),
        )  # fmt: skip


def _field(f: FieldEntry) -> str:
    low, high = f.low, f.high
    if f.kind == FieldKind.FLOAT.name.lower():
        low, high = struct.unpack("<qq", struct.pack("<dd", low, high))
    return _struct(
        start=f.start, length=f.bits, motorola=f.motorola, kind=f"FIELD_{f.kind.upper()}",
        has_invalid=f.invalid is not None, scale=f.scale, offset=f.offset,
        low=int(low), high=int(high), invalid=f.invalid or 0,
    )  # fmt: skip


def _struct(**members: str | float | int | bool) -> str:
    """An initializer; what is 0 or NULL is left out."""
    parts = []
    for name, value in members.items():
        text = value if isinstance(value, str) else number(int(value) if value is True else value)
        if text not in ("NULL", "0", "0.0", "False", "{0}"):
            parts.append(f".{name} = {text}")
    return braces(parts or ["0"])


def _text(value: str | None) -> str:
    return "NULL" if value is None else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _bytes(hexadecimal: str) -> str:
    data = bytes.fromhex(hexadecimal).rstrip(b"\0")
    return braces([f"0x{byte:02X}" for byte in data]) if data else "NULL"
