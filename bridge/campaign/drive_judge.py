"""Torques to drives that were not enabled, counted from the log of their bus.

A judge apart from the nodes: it reads frames by the vendors' documents, with tables of its own, and
knows which faults were injected. Of each torque other than 0 it asks what the drive had told until
the frame was sent, and what it was in truth.

*Forbidden* is a torque to a drive whose newest state on the bus is another than enabled, that was
asked to disable itself, or that has been silent for longer than a silence may last. *Unheard* is a
torque that was sent when the drive was off but could not have told so yet: physics allows no less.
A Damiao drive tells its state with each answer, a CiA 402 drive with each SYNC, so these are the
frames of a period; an ODrive axis tells it in its heartbeat, every 100 ms unless configured
otherwise. An unplugged or rebooting drive tells nothing: its silence has to last for `silent`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.deployment.carried import Carried
from bridge.deployment.drive_sequences import commanded_drives, own_torques
from bridge.deployment.system import System
from bridge.faults.script import DriveFault, FaultScript
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.native.safety import LifeState
from bridge.native.vendor import VendorFault
from bridge.records.node_lives import Life, frame_files

Times = NDArray[np.int64]
Bools = NDArray[np.bool_]
LogRows = NDArray[np.void]
#: What the judge takes for a state: the drive is enabled, it is not, the frame tells no state.
State = bool | None
NS = 1_000_000_000
OWN = "ours"
REQUEST = b"\xff" * 7


@dataclass(frozen=True, slots=True)
class Reading:
    """A vendor's frames to and from drive n.

    `torque`: identifier of its commands; `nonzero`: whether one asks for a torque other than 0.
    `requests`: identifiers of which some frames disable it; `disables`: whether this one does.
    `state`: identifier of the frames that tell its state; `says`: of one of drive n. `silent`: ns
    after which its silence says that it is off.
    """

    torque: Callable[[int], int]
    nonzero: Callable[[bytes], bool]
    requests: Callable[[int], list[int]]
    disables: Callable[[bytes], bool]
    state: Callable[[int], int]
    says: Callable[[int, bytes], State]
    silent: int


def _damiao_nonzero(d: bytes) -> bool:
    """12 bits of torque: no code is 0 N.m, two are nearest to it. FF seven times is a request."""
    return len(d) == 8 and d[:7] != REQUEST and (d[6] & 15) << 8 | d[7] not in (2047, 2048)


def _damiao_says(n: int, d: bytes) -> State:
    """Upper half of byte 0, 1: enabled. The answer of a register repeats its number and request."""
    if len(d) != 8 or d[0] & 15 != n & 15 or (d[:2] == bytes([n, 0]) and d[2] in (0x33, 0x55)):
        return None
    return d[0] >> 4 == 1


READINGS = {
    "damiao": Reading(
        torque=lambda n: n,
        nonzero=_damiao_nonzero,
        requests=lambda n: [n],
        disables=lambda d: d == REQUEST + b"\xfd",
        state=lambda n: 0x10 + n,
        says=_damiao_says,
        silent=NS // 10,
    ),
    "odrive": Reading(
        torque=lambda n: n << 5 | 0x0E,
        nonzero=lambda d: len(d) >= 4 and struct.unpack("<f", d[:4])[0] != 0.0,
        requests=lambda n: [n << 5 | 7],  # axis state: 8 is closed loop
        disables=lambda d: d[:1] != b"\x08",
        state=lambda n: n << 5 | 1,  # heartbeat: axis error, axis state
        says=lambda n, d: len(d) >= 5 and not any(d[:4]) and d[4] == 8,
        silent=35 * NS // 100,
    ),
    "cia402": Reading(
        torque=lambda n: 0x200 + n,
        nonzero=lambda d: len(d) >= 5 and d[3:5] != b"\0\0",
        requests=lambda n: [0x200 + n],  # control word: xxxx 1111 keeps it enabled
        disables=lambda d: len(d) >= 2 and d[0] & 0x0F != 0x0F,
        state=lambda n: 0x180 + n,  # status word: xx10 0111 is operation enabled
        says=lambda n, d: len(d) >= 2 and d[0] & 0x6F == 0x27,
        silent=NS // 10,
    ),
}


@dataclass(frozen=True, slots=True)
class JudgedDrive:
    """The judge's account of one drive: `torques` (other than 0) that its `host` has sent to it.

    `forbidden`: when (s) torques were sent that must not be; `unheard`: torques to a drive that
    was off and could not have told so; `off`: from when to when it was off (s), the last one until
    the end of the log.
    """

    name: str
    vendor: str
    host: str
    torques: int
    forbidden: tuple[float, ...]
    unheard: int
    off: tuple[tuple[float, float], ...]


def judge_drives(
    system: System, script: FaultScript, nodes: Path, cold: bool
) -> Iterator[JudgedDrive]:
    """The accounts of all drives of a vendor that a node commands.

    `nodes`: the folder with the logs of a run in simulated time; `cold`: its drives began disabled.
    """
    for name, plan in system.nodes.items():
        for drive in commanded_drives(system.deployment, plan):
            reading = READINGS.get(drive.profile.vendor)
            path = frame_files(nodes, drive.bus).get(Life(name))
            if reading is None or path is None:
                continue
            mine = [f for f in script.drives if (f.bus, f.drive) == (drive.bus, drive.node)]
            found = _judged(
                drive.node, drive.profile.timeout, reading, Journal.open(path), mine, cold
            )
            yield JudgedDrive(drive.name, drive.profile.vendor, name, *found)
        for message in own_torques(system.deployment, name, plan):
            taken, number = system.messages[message], system.deployment.nodes[name].number
            path = frame_files(nodes, taken.bus).get(Life(taken.node))
            if path is not None:
                mine = [f for f in script.drives if (f.bus, f.drive) == (taken.bus, number)]
                reading = _own_reading(system, taken, name)
                found = _judged(number, 1.0, reading, Journal.open(path), mine, cold)
                yield JudgedDrive(f"drive {number} on bus {taken.bus}", OWN, taken.node, *found)


def _own_reading(system: System, taken: Carried, node: str) -> Reading:
    """Frames to and from a drive of our own protocol: its samples carry the state of its node."""
    state = next(m for m in system.messages.values() if (m.node, m.bus) == (node, taken.bus))
    torque, told = (m.encoding for m in (taken, state))
    assert isinstance(torque, Codec) and isinstance(told, Codec)
    parts = [p.port == "tau" for p in taken.outlet.parts for _ in range(p.size)]

    def nonzero(d: bytes) -> bool:
        values = torque.decode(d)[1]
        return any(v != 0.0 for v, is_torque in zip(values, parts, strict=False) if is_torque)

    def says(_: int, d: bytes) -> State:
        return (told.decode(d)[2].status & 7) in (LifeState.ACTIVE, LifeState.STOPPING)

    return Reading(
        torque=lambda n: torque.message.id, nonzero=nonzero,
        requests=lambda n: [], disables=lambda d: False,
        state=lambda n: told.message.id, says=says, silent=NS // 5,
    )  # fmt: skip


def _judged(
    number: int,
    seconds: float,
    reading: Reading,
    log: LogRows,
    faults: Sequence[DriveFault],
    cold: bool,
) -> tuple[int, tuple[float, ...], int, tuple[tuple[float, float], ...]]:
    """The last four fields of a :class:`JudgedDrive`; `seconds`: the time of its watchdog."""
    sent = log["flags"] & Flags.SENT != 0
    torques = _times(log, sent & _of(log, reading.torque(number)), reading.nonzero)
    told, on = _told(log, sent, number, reading, cold)
    newest = np.searchsorted(told, torques, side="right") - 1
    bad = ~on[newest] | (torques - told[newest] > reading.silent)
    timeout = round(seconds * NS)
    off = _off(told, on, faults, timeout, int(log["t_ns"].max(initial=0)) + 1)
    hidden = np.zeros(len(torques), bool)
    for a, b in off:
        hidden |= (torques >= a) & (torques < b)
    return (
        len(torques),
        tuple((torques[bad] * 1e-9).tolist()),
        int(np.count_nonzero(hidden & ~bad)),
        tuple((a * 1e-9, b * 1e-9) for a, b in off),
    )


def _of(log: LogRows, identifier: int) -> Bools:
    found: Bools = log["id"] == identifier
    return found


def _data(rows: LogRows) -> list[bytes]:
    return [d.tobytes()[:n] for d, n in zip(rows["data"], rows["length"].tolist(), strict=True)]


def _times(log: LogRows, there: Bools, wanted: Callable[[bytes], bool]) -> Times:
    """The times of the wanted frames, ns."""
    rows = log[there]
    chosen = np.array([wanted(d) for d in _data(rows)], bool)
    return np.asarray(rows["t_ns"][chosen], np.int64)


def _told(
    log: LogRows, sent: Bools, node: int, reading: Reading, cold: bool
) -> tuple[Times, Bools]:
    """Times (n,), ns, at which the drive's state was known, and a mask (n,): it was enabled.

    The first entry is before the log; a request to disable it makes its state known, too.
    """
    found: list[tuple[int, bool]] = [(-NS if cold else 0, not cold)]
    heard = log[~sent & _of(log, reading.state(node))]
    for t, d in zip(heard["t_ns"].tolist(), _data(heard), strict=True):
        state = reading.says(node, d)
        found += [] if state is None else [(t, state)]
    asked = log[sent & (np.isin(log["id"], reading.requests(node)))]
    for t, d in zip(asked["t_ns"].tolist(), _data(asked), strict=True):
        found += [(t, False)] if reading.disables(d) else []
    found.sort(key=lambda entry: entry[0])
    return np.array([t for t, _ in found], np.int64), np.array([on for _, on in found], bool)


def _off(
    told: Times, on: Bools, faults: Sequence[DriveFault], timeout: int, end: int
) -> list[tuple[int, int]]:
    """Intervals (ns) in which the drive was off, by what it told and what faults did to it.

    A fault switches it off at once, its cable when its watchdog has run out; then it is off until
    it has told so, and has told that it is enabled again.
    """
    changes = [(int(t), bool(x)) for t, x in zip(told, on, strict=True)]
    struck = sorted(_struck(faults, timeout))
    found: list[tuple[int, int]] = []
    since, hidden = (None if changes[0][1] else 0), False
    for t, x, fault in sorted(
        [(t, x, False) for t, x in changes] + [(t, False, True) for t in struck]
    ):
        if fault:
            hidden = True
        elif not x:
            hidden = False
        if not x and since is None:
            since = t
        elif x and since is not None and not hidden:
            found.append((since, t))
            since = None
    return found if since is None else [*found, (since, end)]


def _struck(faults: Sequence[DriveFault], timeout: int) -> Iterator[int]:
    """The times at which a drive that is enabled goes off by a fault, ns."""
    plugged = [round(f.t * NS) for f in faults if f.fault is VendorFault.PLUG]
    for one in faults:
        t = round(one.t * NS)
        if one.fault in (VendorFault.TRIP, VendorFault.REBOOT) or (
            one.fault is VendorFault.HOT and one.code
        ):
            yield t
        elif one.fault is VendorFault.UNPLUG and not any(t <= p <= t + timeout for p in plugged):
            yield t + timeout
