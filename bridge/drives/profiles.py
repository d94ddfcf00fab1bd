"""Profiles of drives: codec, units, states and limits of one kind of drive.

The files (``configs/drives/NAME.toml``) are read by :mod:`bridge.drives.profile_files`. A profile
names messages of a DBC file, which describes node 0 (node n: `step`·n added to the identifier), or
a message for each node (``"LINK_{node}"``). Units come from the DBC; beyond
:mod:`cosim.base.units` a torque in ``%`` is of `rated_torque` and a position in ``count`` of
`counts` a turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Literal

from bridge.can.codec import Codec
from bridge.can.layout import LayoutError, MessageLayout, find
from bridge.drives.model import DriveSpec
from bridge.drives.raw_frames import OwnWatchdog, Raw
from bridge.drives.status import NO_STATUS, DriveStatus
from bridge.native.frame import Flags
from bridge.safety.limits import to_si
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import conversion

PORTS = {"tau": "N.m", "q": "rad", "dq": "rad/s"}


@dataclass(frozen=True, slots=True)
class ProfileMessage:
    """A message of a profile: the signals that are tau, q, dq, one a joint each."""

    message: str
    step: int = 0
    tau: tuple[str, ...] = ()
    q: tuple[str, ...] = ()
    dq: tuple[str, ...] = ()

    @property
    def signals(self) -> tuple[str, ...]:
        """All of them, in the order tau, q, dq."""
        return self.tau + self.q + self.dq


@dataclass(frozen=True, slots=True)
class Host:
    """Messages of the profile that drives require from the node that commands them; "": none.

    `heartbeat`: its identifier is that of the DBC file plus the number of that node; it has one
    signal, ``state``.
    """

    heartbeat: str = ""
    sync: str = ""


@dataclass(frozen=True, slots=True)
class Joint:
    """Drive and joint: q = direction q_m / gear + zero, tau = direction gear tau_m."""

    gear: float = 1.0
    direction: Literal[1, -1] = 1
    zero: float = 0.0  # rad


@dataclass(frozen=True, slots=True)
class DriveProfile:
    """The content of a profile's file; `limits` in SI, `drive` describes the emulated one."""

    path: str
    title: str
    layouts: tuple[MessageLayout, ...]
    command: ProfileMessage
    feedback: tuple[ProfileMessage, ...]
    sequences: Mapping[str, tuple[Raw, ...]]
    watchdog: OwnWatchdog
    limits: Mapping[str, float]
    drive: DriveSpec
    side: str = "joint"
    rated_torque: float = 0.0  # N.m
    counts: float = 0.0  # a turn
    refuses_simulated: bool = False
    host: Host = Host()
    status: DriveStatus = NO_STATUS
    vendor: str = ""  # whose state machine the emulated drive is; "": none
    protocol: str = ""  # the file that profiles of one protocol share

    @property
    def format(self) -> Flags:
        """The format of all frames of these drives, that of the command: FD, BRS, or none."""
        flags = find(self.layouts, self.command.message.format(node=1)).flags
        return Flags(flags) & (Flags.FD | Flags.BRS)

    def with_format(self, fd: bool | None) -> DriveProfile:
        """The profile with frames of CAN FD with bit rate switch, or classic; None: as it is."""
        if fd is None:
            return self
        own = Flags.FD | Flags.BRS
        kinds = [layout.flags & ~own | (own if fd else 0) for layout in self.layouts]
        made = zip(self.layouts, kinds, strict=True)
        return replace(self, layouts=tuple(replace(x, flags=int(kind)) for x, kind in made))

    @property
    def timeout(self) -> float:
        """The time-out of the drive's watchdog as it is set, s."""
        return to_si(self.drive.watchdog or 0.0, "s", f"{self.path}: drive.watchdog")

    def host_heartbeat(self, number: int) -> Codec | None:
        """Heartbeat of a host with this number, as these drives take it; None: they do not."""
        if not self.host.heartbeat:
            return None
        return Codec(
            _of_node(self.layouts, ProfileMessage(self.host.heartbeat, 1), number, self.path),
            ("state",),
        )

    def host_sync(self) -> Codec | None:
        """SYNC as these drives take it; None: they do not."""
        return Codec(find(self.layouts, self.host.sync), ()) if self.host.sync else None

    @property
    def joints(self) -> int:
        """Joints in one command: 1 for a frame a drive."""
        return len(self.command.tau)

    def layout(self, part: ProfileMessage, node: int) -> MessageLayout:
        """The message of a part for a node. Raises ScenarioError where there is none."""
        return _of_node(self.layouts, part, node, self.path)

    def codec(self, part: ProfileMessage, node: int) -> Codec:
        """Its codec; values in the order tau, q, dq, in the DBC's units.

        Of a command no other frame is one: other bits ask for more than torque.
        """
        return Codec(self.layout(part, node), part.signals, exact=part is self.command)

    def conversion(
        self, part: ProfileMessage, signal: str, joint: Joint | None = None
    ) -> tuple[float, float]:
        """(gain, offset): SI value at the joint = gain · value of the DBC + offset.

        `joint`: where a gear, a direction or a zero lies between; ignored by side = "joint" but for
        direction and zero. Raises ScenarioError for units that do not fit.
        """
        port = next(name for name in PORTS if signal in getattr(part, name))
        unit = self.layout(part, 1).signal(signal).unit
        gain = self._gain(port, unit, signal)
        at = joint or Joint()
        if not at.gear > 0 or at.direction not in (1, -1):
            raise ScenarioError(f"{at}, expected gear > 0 and direction 1 or -1", self.path)
        gear = at.gear if self.side == "motor" else 1.0
        gain *= at.direction * (gear if port == "tau" else 1 / gear)
        return gain, at.zero if port == "q" else 0.0

    def status_layout(self, node: int) -> MessageLayout:
        """The message in which a drive tells its state. Raises ScenarioError."""
        return _of_node(
            self.layouts, ProfileMessage(self.status.message, self.status.step), node, self.path
        )

    def frames(self, sequence: str, node: int) -> tuple[tuple[int, bytes], ...]:
        """The frames of ``enable``, ``disable`` or ``clear``; none where the profile needs none."""
        return tuple(raw.at(node) for raw in self.sequences[sequence])

    def _gain(self, port: str, unit: str, signal: str) -> float:
        place = f"{self.path}: {signal}"
        if port == "tau" and unit == "%":
            if not self.rated_torque > 0:
                raise ScenarioError("is in %, expected rated_torque in the profile", place)
            return 0.01 * self.rated_torque
        if unit.startswith("count"):
            if not self.counts > 0:
                raise ScenarioError("is in counts, expected counts in the profile", place)
            return 2 * pi / self.counts
        try:
            return conversion(unit, PORTS[port])[0]
        except UnitError as error:
            raise ScenarioError(f"{error}", place) from None


def _of_node(
    layouts: tuple[MessageLayout, ...], part: ProfileMessage, node: int, path: str
) -> MessageLayout:
    try:
        found = find(layouts, part.message.format(node=node))
        for signal in part.signals:
            found.signal(signal)
    except LayoutError as error:
        raise ScenarioError(str(error), path) from None
    if "{node}" in part.message:
        return found
    return replace(found, identifier=found.identifier + part.step * node)
