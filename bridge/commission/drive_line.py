"""Drives on their buses before a run: brought up, fed and disabled by the functions of a node.

``bridge/c/bringup.c`` does the same here as in a node that is armed: each frame of the bring-up
after the answer to the one before it, torque 0 in a fifth of the watchdog's time, the host's
heartbeat and SYNC. Only slots, components and their torques are missing.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Self, TypeVar, final

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.commission.line_drives import LineDrive
from bridge.deployment.services import BEATS
from bridge.deployment.spec import Deployment
from bridge.native.bus import BusStruct
from bridge.native.commanded import CommandedStruct, Phase
from bridge.native.frame import Frame
from bridge.native.message import Decoded
from bridge.native.node import WALL, NodeStruct, Services, functions
from bridge.native.safety import LifeState
from bridge.node.buses import can_spec
from bridge.wiring.commanded import CommandedDrives
from cosim.base.clock import monotonic_ns, sleep

#: s between two looks at a bus; ns between two SYNCs.
LOOK, SYNC_NS = 0.002, 10_000_000
#: Bring-ups that are tried where this machine stood still for so long, s.
TRIES, LATE = 3, 0.05
T = TypeVar("T")


@final
class _LineHost:
    """A node of the deployment, as far as the drives that it commands hear it before a run."""

    def __init__(
        self, d: Deployment, name: str, drives: Sequence[LineDrive], ends: Mapping[str, Attachment]
    ) -> None:
        self.drives, self._place = tuple(drives), d.place("nodes", name)
        self._buses = tuple(dict.fromkeys(drive.foreign.bus for drive in drives))
        self.struct = NodeStruct(clock=WALL, number=d.nodes[name].number, h_ns=SYNC_NS)
        self.struct.life.state = LifeState.INACTIVE
        self._commanded: CommandedDrives | None = None
        sent = (BusStruct * len(self._buses))(*(ends[bus].bus.struct for bus in self._buses))
        services = (Services * len(self._buses))()
        self.struct.buses, self.struct.n_buses = sent, len(self._buses)
        self.struct.services = services
        self._alive: list[Any] = [sent, services]
        for bus, entry in zip(self._buses, services, strict=True):
            self._serve_bus(bus, entry)

    def _serve_bus(self, bus: str, entry: Services) -> None:
        """The heartbeat and the SYNC that the drives of a bus require."""
        profile = next(x.foreign.profile for x in self.drives if x.foreign.bus == bus)
        beat, sync = profile.host_heartbeat(self.struct.number), profile.host_sync()
        if beat is not None:
            period = round(profile.timeout * 1e9) // BEATS
            self.struct.host_ns = min(self.struct.host_ns or period, period)
            entry.host_heartbeat = c.pointer(beat.message)
        if sync is not None:
            entry.host_sync, entry.host_sync_slots = c.pointer(sync.message), 1
        self._alive += [beat, sync]

    def take(self, drives: Sequence[LineDrive], *, enable: bool) -> None:
        """Begin the bring-up of these drives; without `enable` it ends when they are cleared."""
        self._commanded = found = CommandedDrives(
            [drive.foreign for drive in drives], self._buses, self.struct, self._place
        )
        for drive, entry in zip(drives, found.structs, strict=False):
            drive.entry = entry
            if not enable:
                entry.n_steps -= len(drive.foreign.profile.sequences["enable"])
        self.struct.life.armed = bool(drives)

    @property
    def entries(self) -> list[CommandedStruct]:
        """The drives of the last bring-up."""
        found = self._commanded
        return [] if found is None else list(found.structs)[: len(found.drives)]

    @property
    def rises(self) -> bool:
        """Tell if a bring-up is under way."""
        phases = {Phase(entry.phase) for entry in self.entries}
        under_way = phases & {Phase.RESTING, Phase.RISING} and Phase.FAILED not in phases
        return bool(self.struct.life.armed and under_way)

    def given_up(self) -> list[str]:
        """A sentence for each drive whose bring-up failed."""
        return [] if self._commanded is None else self._commanded.given_up()

    def hear(self, bus: str, frame: Frame) -> None:
        """Take a frame of a bus."""
        if bus in self._buses:
            frame.bus = self._buses.index(bus)
            functions().bringup_hear(c.byref(self.struct), c.byref(frame))

    def turn(self, now_ns: int, feeding: bool) -> None:
        """Send what is due now; without `feeding` SYNC only, at which drives tell their state."""
        if feeding and self.struct.life.armed:
            functions().bringup_step(c.byref(self.struct), now_ns, 1)
            functions().node_host(c.byref(self.struct), now_ns)
        if self._commanded is not None:
            functions().node_host_sync_early(c.byref(self.struct), now_ns)

    def rest(self) -> None:
        """Disable the drives of the last bring-up."""
        self.struct.life.armed = 0
        functions().bringup_rest(c.byref(self.struct), monotonic_ns())


@final
class DriveLine:
    """The buses of these drives. Use as a context manager: all drives are disabled at its end."""

    def __init__(self, d: Deployment, drives: Sequence[LineDrive]) -> None:
        self.deployment, self.drives = d, tuple(drives)
        self._ends: dict[str, Attachment] = {}
        self._hosts: list[_LineHost] = []
        self._stack = ExitStack()
        self._heard: list[tuple[str, Frame]] = []
        self.feeding = True
        self.late = 0.0  # s, the longest time without a look at the buses since the last bring-up
        self._looked_ns = 0

    def __enter__(self) -> Self:
        for bus in {drive.foreign.bus for drive in self.drives}:
            self._ends[bus] = interface.attach(can_spec(self.deployment, bus))
            self._stack.callback(self._ends[bus].close)
        for name in dict.fromkeys(drive.host for drive in self.drives):
            own = [drive for drive in self.drives if drive.host == name]
            self._hosts.append(_LineHost(self.deployment, name, own, self._ends))
        return self

    def __exit__(self, *_: object) -> None:
        for host in self._hosts:
            host.take(host.drives, enable=True)
            host.rest()
        self._stack.close()

    def bring_up(self, drives: Sequence[LineDrive], *, enable: bool = True) -> str:
        """Clear these drives and enable them, all others rest; the reason why one did not follow.

        Without `enable` they are cleared only. "": all followed. It is tried again where this
        machine stood still in between, so that an answer may not have been seen in time.
        """
        for _ in range(TRIES):
            self.rest()
            self.late, self._looked_ns = 0.0, monotonic_ns()
            for host in self._hosts:
                host.take([drive for drive in drives if drive in host.drives], enable=enable)
            while any(host.rises for host in self._hosts):
                self.serve(LOOK)
            why = "; ".join(text for host in self._hosts for text in host.given_up())
            if not why or self.late < LATE:
                break
        return why

    def rest(self) -> None:
        """Disable all drives that were brought up last."""
        for host in self._hosts:
            host.rest()

    def torque(self, drive: LineDrive, tau: float) -> None:
        """Send this torque (N.m at the joint) in place of 0 from now on, as long as it is up."""
        assert drive.entry is not None
        values = [tau] + [0.0] * (len(drive.command.signals) - 1)
        identifier, data = drive.command.layout.identifier, drive.command.encode(values)
        frame = drive.foreign.frame(identifier, data)
        frame.bus = drive.entry.feed.bus
        drive.entry.feed, drive.entry.feeds = frame, 1

    def ask_state(self, drive: LineDrive) -> None:
        """Send torque 0 once to a drive that tells its state only as an answer."""
        if drive.entry is not None and drive.entry.feeds:
            self.send(drive, Frame.from_buffer_copy(drive.entry.feed))

    def send(self, drive: LineDrive, frame: Frame) -> None:
        """Send a frame on the bus of a drive."""
        self._ends[drive.foreign.bus].bus.send(frame)

    def ask(
        self, drive: LineDrive, frame: Frame, read: Callable[[Frame], T | None], within: float = 0.5
    ) -> T | None:
        """Send a frame; what `read` makes of the first answer that it takes, None: none came.

        `within`: time for the answer, s.
        """
        self.send(drive, frame)
        end = monotonic_ns() + round(within * 1e9)
        while monotonic_ns() < end:
            self.serve(LOOK)
            for bus, heard in self._heard:
                value = read(heard) if bus == drive.foreign.bus else None
                if value is not None:
                    return value
        return None

    def serve(self, seconds: float) -> None:
        """Take what the drives tell, and feed those that are up, unless `feeding` is off.

        `seconds`: for so long, s.
        """
        end = monotonic_ns() + round(seconds * 1e9)
        self._heard.clear()
        while True:
            now = monotonic_ns()
            self.late, self._looked_ns = max(self.late, (now - self._looked_ns) * 1e-9), now
            for bus, attached in self._ends.items():
                for frame in attached.bus.drain():
                    self._take(bus, frame)
            for host in self._hosts:
                host.turn(now, self.feeding)
            if now >= end:
                return
            sleep(LOOK)

    def _take(self, bus: str, frame: Frame) -> None:
        self._heard.append((bus, frame))
        for host in self._hosts:
            host.hear(bus, frame)
        for drive in self.drives:
            codec, status = drive.position, drive.foreign.profile.status
            if drive.foreign.bus != bus or codec is None or frame.id != codec.layout.identifier:
                continue
            state = status.at(int.from_bytes(frame.payload[:8], "little"))
            tells = not status.message or drive.foreign.status.takes(frame)
            if tells and state is not None and state.kind == "other":
                continue  # the answer of a register
            result, values, _ = codec.decode(frame.payload)
            drive.q = float(values[0]) if result is Decoded.OK else drive.q
