"""The buses of a twin, compared with a second implementation of arbitration in Python."""

from __future__ import annotations

import ctypes as c
from collections import defaultdict

import pytest

from bridge.can.load import kind_of
from bridge.can.log import frame_of
from bridge.native.frame import Flags, frame_dtype
from bridge.native.journal import Journal
from bridge.replay import twin
from cosim.bus.arbitration import rank
from cosim.bus.timing import frame_bits
from tests.bridge.deployments import document, system_of

STOP = "run.stop=0.3"


def on_one_bus(name, **changes):
    """A deployment whose two arms share one bus, so that their frames ask for it at once."""
    found = document(name)
    del found["buses"]["right"]
    found["buses"]["left"].update(changes)
    for message in found["messages"].values():
        message["bus"] = "left"
    return found


def heard_by_all(system, folder):
    """Frames on the only bus of a twin, by time of arrival: (t_ns, identifier, frame)."""
    logs = []

    def log(node):
        path = folder / f"{node.name}.frames"
        logs.append(Journal.create(path, frame_dtype(64), 10_000))
        node.buses[0].struct.log = c.pointer(logs[-1].struct)

    with twin.wired_nodes(system, folder, log) as nodes:
        twin.run(system, nodes)
        assert not any(n.buses[0].struct.send_failed for n in nodes.values())
    rows = [row for log in logs for row in log.rows if not row["flags"] & Flags.SENT]
    for log in logs:
        log.close()
    return {int(row["t_ns"]): frame_of(row) for row in sorted(rows, key=lambda r: r["t_ns"])}


def senders(system):
    """By identifier: node, period and first request (ns)."""
    found = {}
    service = system.services["left"]
    for m in system.messages.values():
        found[m.encoding.message.id] = m.node, m.period_ns, m.offset_ns
    for name, spec in system.deployment.nodes.items():
        phase = round(system.deployment.seconds(spec.phase) * 1e9)
        found[service.heartbeats[spec.number].message.id] = name, 50_000_000, phase
        if name == system.deployment.sync:
            found[service.sync.message.id] = name, round(system.sync_ticks * 1e6), phase
    return found


def arbitrated(frames, system):
    """When each frame arrives: every node sends in its order, the lowest identifier wins."""
    timing, who, count = system.deployment.buses["left"].timing, senders(system), defaultdict(int)
    queues = defaultdict(list)
    for frame in frames:
        node, period, first = who[frame.id]
        queues[node].append((first + period * count[frame.id], frame))
        count[frame.id] += 1
    for queue in queues.values():
        assert [t for t, _ in queue] == sorted(t for t, _ in queue)
    arrivals, free, contended = [], 0, 0
    while any(queues.values()):
        start = max(free, min(q[0][0] for q in queues.values() if q))
        asking = [q for q in queues.values() if q and q[0][0] <= start]
        contended += len(asking) > 1
        frame = min(asking, key=lambda q: rank(q[0][1].id)).pop(0)[1]
        bits = frame_bits(frame.id, frame.payload, kind_of(frame.flags))
        free = start + timing.time_ns(bits)
        arrivals.append((free - 3 * timing.bit_ns, frame.id))
    return arrivals, contended


@pytest.mark.parametrize("name", ["can", "can-classic"])
def test_frames_arrive_as_arbitration_has_it(name, tmp_path):
    system = system_of(on_one_bus(name), tmp_path, STOP)
    frames = heard_by_all(system, tmp_path)
    found, contended = arbitrated(frames.values(), system)
    assert contended > 100
    assert [(t, frame.id) for t, frame in frames.items()] == found


def test_a_sorted_queue_sends_the_most_urgent_frame_first(tmp_path):
    """A node queues VEL_1 (0x4a1) before POS_1 (0x3a1), which must wait behind it in a FIFO."""
    orders = []
    for kind in ("fifo", "sorted"):
        folder = tmp_path / kind
        folder.mkdir()
        found = on_one_bus("can-classic", queue=kind)
        for arm in (1, 3):  # a node sends its messages in the order of their keys
            found["messages"][f"A_{arm}"] = {
                **found["messages"].pop(f"VEL_{arm}"), "name": f"VEL_{arm}"
            }  # fmt: skip
        frames = heard_by_all(system_of(found, folder, "run.stop=0.004"), folder)
        orders.append([frame.id for frame in frames.values()][:4])
    assert orders == [[0x4A1, 0x3A1, 0x4A3, 0x3A3], [0x3A1, 0x3A3, 0x4A1, 0x4A3]]
