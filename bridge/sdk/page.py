"""``README.md`` of a participant's folder: build and start, and the messages of its node."""

from __future__ import annotations

from collections.abc import Iterator

from bridge.deployment.system import System
from bridge.sdk.table import LayoutEntry, NodeTable

_TEXT = """\
# Node {node} of {deployment}

{build}Rehearse it with the other nodes:

    cosim rehearse {scenario} --deploy {deploy} --outside {node}='{start}'

The protocol is in docs/participants.md of cosim-bridge. What follows is of this node (number
{number}, slots of {h:g} ms at {phase:g} ms + k * {h:g} ms, {slots} slots).

| message | bus | | {place} | bytes | protection | data ID | every | values |
|---|---|---|---|---|---|---|---|---|
{rows}
"""


def page(table: NodeTable, system: System, build: str, start: str) -> str:
    """The page. `build`, `start`: the commands that build and start the program."""
    return _TEXT.format(
        node=table.node,
        deployment=system.deployment.title or system.deployment.name,
        deploy=system.deployment.path,
        scenario=system.scenario.path,
        build=f"Build: `{build}`\n\n" if build else "",
        start=start,
        number=table.number,
        h=table.h_ns * 1e-6,
        phase=table.phase_ns * 1e-6,
        slots=table.slots,
        place="key" if table.buses[0].kind == "zenoh" else "identifier",
        rows="\n".join(_rows(table)),
    )


def _rows(table: NodeTable) -> Iterator[str]:
    for m in table.received:
        way = f"from {m.sender}"
        yield _row(m.name, m.bus, way, m.layout, f"{m.period_ns * 1e-6:g} ms", ", ".join(m.values))
    for s in table.sent:
        every = f"{s.every * table.h_ns * 1e-6:g} ms"
        yield _row(s.name, s.bus, "sent", s.layout, every, ", ".join(s.values))
    for n in table.neighbours:
        need = "required" if n.required else ""
        yield _row(f"heartbeat of {n.name}", n.bus, "from it", n.heartbeat, "50 ms", need)
    for bus in table.buses:
        for what, layout in bus.services.items():
            every = (
                f"{table.heartbeat_slots * table.h_ns * 1e-6:g} ms" if what == "heartbeat" else ""
            )
            yield _row(what, bus.name, "sent" if what == "heartbeat" else "", layout, every, "")


def _row(name: str, bus: str, way: str, m: LayoutEntry, every: str, values: str) -> str:
    place = f"`{m.key}`" if m.key is not None else f"0x{m.id:03X}{' FD' if m.fd else ''}"
    data_id = bytes.fromhex(m.data_id)
    ids = {
        "P05": data_id[1::-1].hex(),
        "P04": data_id[3::-1].hex(),
        "P02": data_id.hex(),
        "NONE": "",
    }
    profile = "" if m.profile == "NONE" else m.profile
    cells = (name, bus, way, place, str(m.bytes), profile, ids[m.profile], every, values)
    return f"| {' | '.join(cells)} |"
