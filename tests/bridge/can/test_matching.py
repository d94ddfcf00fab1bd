"""A frame with the identifier of a message but another format is never accepted as the message.

The rule is `frame_accepted` of frame.h; the functions tested here use it, as nodes do.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bridge.can.log import merge_node_logs
from bridge.faults.load import build
from bridge.monitor import listener as listen
from bridge.monitor import snapshot
from bridge.native import lockstep as native
from bridge.native.bus import Accept, Bus
from bridge.native.faults import CORRUPT, INJECTED
from bridge.native.frame import Flags, Frame, Ring, frame_dtype
from bridge.native.journal import Journal
from bridge.native.message import Header
from bridge.native.node import NEVER_STARTED
from bridge.native.safety import LifeState
from bridge.node.lockstep import Lockstep
from bridge.recording import run_folder
from bridge.records.node_lives import Life
from bridge.replay import bus_log, from_log
from bridge.results import detection, undetected
from tests.bridge.deployments import named

#: Differences of format: flags that are inverted. None: the message itself.
STRANGE = [Flags.EXTENDED, Flags.REMOTE, Flags.FD, Flags.ERROR, Flags.EXTENDED | Flags.FD]
FORMATS = [Flags(0), *STRANGE]
#: Logs end here, ns; a frame sent so shortly before must have come.
END = 10**10
DROP = {"kind": "drop", "node": "master", "message": "LINK_*"}
DUE = END - round((snapshot.SLACK + snapshot.SPAN / 2) * 1e9)


@pytest.fixture(scope="module")
def system():
    return named("can")


def altered(frame, flags, t_ns=None):
    """The same number and data in another format."""
    found = Frame.of(frame.id, frame.payload, frame.flags ^ flags, frame.t_ns)
    found.t_ns = frame.t_ns if t_ns is None else t_ns
    return found


def link(system, message="LINK_2", counter=0):
    carried = system.messages[message]
    header = Header(counter=counter, status=LifeState.ACTIVE)
    return carried.encoding.frame([0.0] * carried.outlet.width, header)


def rows_of(*frames):
    """Rows of a log."""
    rows = np.zeros(len(frames), frame_dtype())
    for row, frame in zip(rows, frames, strict=True):
        for name in ("t_ns", "id", "flags", "length"):
            row[name] = getattr(frame, name)
        row["data"][: frame.length] = np.frombuffer(frame.payload, np.uint8)
    return rows


# ---- the rule -----------------------------------------------------------------------------------


def test_rows_are_chosen_as_frames_are(system):
    frames = [altered(link(system, m), f) for m in ("STATE_1", "LINK_2") for f in FORMATS]
    frames += [altered(frames[0], Flags.SENT | Flags.BRS | Flags.ESI)]
    message = system.messages["STATE_1"].encoding.message
    estop = system.services["left"].estop.message
    whole = Accept(0x3A0, 0x7F0, Flags.FD, Flags.FD)
    for accept in (Accept.of(message), Accept.for_estop(estop), whole, Accept(0, 0, 0, 0)):
        found = accept.among(rows_of(*frames)).tolist()
        assert found == [accept.takes(f) for f in frames]
    assert [accept.takes(f) for accept in [Accept.of(message)] for f in frames] == [
        *[True, *[False] * 5], *[False] * 6, True
    ]  # fmt: skip


# ---- who listens --------------------------------------------------------------------------------


@pytest.mark.parametrize("flags", FORMATS)
def test_a_listener_hears_messages_and_heartbeats_in_their_format(system, monkeypatch, flags):
    beat = system.services["left"].heartbeats[1].encode([LifeState.ACTIVE, 0, 1, 1])
    number = system.services["left"].heartbeats[1].message.id
    coming = [altered(link(system), flags), altered(Frame.of(number, beat), flags)]
    ear = SimpleNamespace(drain=lambda: coming, close=lambda: None)
    monkeypatch.setattr(listen, "CanEar", lambda *_: ear)
    with listen.Listener(system, only=["left"]) as listener:
        listener.receive(1)
        assert (listener.heard["LINK_2"].t_ns >= 0) == (flags == 0)
        assert (listener.beats["master"].t_ns >= 0) == (flags == 0)
        assert listener.unknown["left"] == (0 if flags == 0 else 2)


# ---- logs ---------------------------------------------------------------------------------------


def test_samples_of_a_log_are_frames_of_the_message(system):
    carried = system.messages["LINK_2"]
    rows = rows_of(*(altered(link(system), f, k) for k, f in enumerate(FORMATS)))
    found = bus_log.samples(carried, rows, system.deployment.buses["left"])
    assert [s.t_ns for s in found] == [0]


def test_a_node_hears_what_only_has_the_number_of_its_own_frames(system):
    """Also what it sends on another bus."""
    name = system.messages["LINK_2"].node
    number = system.deployment.nodes[name].number
    beat = system.services["left"].heartbeats[number]
    own = [link(system, "LINK_2"), Frame.of(beat.message.id, beat.encode([3, 0, 1, 1]))]
    own = [altered(f, flags) for f in own for flags in FORMATS]
    buses = {bus: rows_of(*own) for bus in system.buses_of(name)}
    rows, _ = from_log._arrivals(system, name, buses, 0)["left"]
    assert rows["flags"].tolist() == [f.flags for f in (*own[1:6], *own[7:])]
    elsewhere = next(m for m in system.messages.values() if m.bus == "right")
    frame = link(system, elsewhere.name)
    both = next(n for n in system.nodes if set(system.buses_of(n)) == {"left", "right"})
    arrived = from_log._arrivals(system, both, {"left": rows_of(frame)}, 0)
    assert len(arrived["left"][0]) == 1


def test_the_log_of_a_bus_has_strangers_with_the_numbers_of_nodes(system, tmp_path):
    sent = altered(link(system), Flags.SENT, 0)
    heard = [altered(link(system), f, 1 + k) for k, f in enumerate(FORMATS)]
    parts = {"master_control": [sent], "master": heard}
    assert merge_node_logs([rows_of(*p) for p in parts.values()])["t_ns"].tolist() == [
        0,
        2,
        3,
        4,
        5,
        6,
    ]
    for node, frames in parts.items():
        with Journal.create(tmp_path / f"{node}.left.frames", frame_dtype(), 10) as journal:
            for row in rows_of(*frames):
                journal.append(*row)
    log = run_folder.bus_logs(system, tmp_path)["left"]
    assert log.rows["t_ns"].tolist() == [0, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("flags", FORMATS)
def test_a_frame_in_another_format_is_no_arrival(system, flags):
    """The monitor: LINK_2 was sent, and something with its number was heard."""
    carried = system.messages["LINK_2"]
    first, last = (Frame.of(0x123, t_ns=t) for t in (1, END))
    out = rows_of(altered(link(system), Flags.SENT, DUE), last)
    into = rows_of(first, altered(link(system), flags, DUE), last)
    lives = {carried.node: Life(carried.node, 1), "master": Life("master", 1)}
    watched = SimpleNamespace(lives_of=lambda node: [lives[node]])
    logs = {(lives[carried.node], "left"): out, (lives["master"], "left"): into}
    assert snapshot._lost(watched, "master", carried, logs) == (int(flags != 0), 1)


# ---- the record of faults -----------------------------------------------------------------------


def test_the_record_of_faults_is_read_by_format_and_bus(system):
    """Of LINK_2, which master_control sends on its first bus."""
    name = "master"
    carried, fault = system.messages["LINK_2"], build({"fault": [DROP]}, Path("x")).frames[0]
    rows = np.zeros(2 * len(FORMATS), INJECTED)
    rows["id"] = carried.encoding.message.id
    rows["flags"] = [carried.encoding.message.flags ^ f for f in FORMATS] * 2
    rows["bus"] = np.repeat([0, 1], len(FORMATS))
    rows["kinds"], rows["copies"], rows["crc_after"] = 1 << CORRUPT, 1, 1
    assert system.buses_of(name) == (carried.bus,) == ("left",)
    hit = detection.received(Life(name), rows, system).hit(fault)
    assert {m: np.flatnonzero(there).tolist() for m, there in hit.items()} == {"LINK_2": [0]}
    accept = Accept.of(carried.encoding.message)
    assert len(undetected.corrupted_frames(rows[: len(FORMATS)], accept)) == 1


# ---- lock-step ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flags", "counter", "result", "kept"),
    [(Flags(0), 0, NEVER_STARTED, 1), (Flags(0), 7, native.LOST, 0)]
    + [(flags, counter, NEVER_STARTED, 0) for flags in STRANGE for counter in (0, 7)],
)
def test_a_sample_in_lock_step_has_its_format(flags, counter, result, kept, tmp_path):
    system = named("zenoh", "deploy.buses.net.options.lockstep=true", "run.stop=1")
    incoming = Ring(8)
    ends = {"net": SimpleNamespace(bus=Bus.from_rings(incoming, Ring(8)))}
    incoming.put(altered(link(system, "xi_slave", counter), flags))
    incoming.put(system.services["net"].estop.frame([1, 0], Header()))
    with Lockstep(system, "master", ends, tmp_path / "master.journal") as found:
        assert found.run() == result
        assert found.streams[0].received == kept
