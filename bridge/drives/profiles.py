"""Profiles of drives: a codec and limits in one file (``configs/drives/NAME.toml``).

A profile names a DBC file, the message that carries torque and those that carry feedback, which of
their signals belong to which joint, frames that enable, disable and clear, and how the drive's own
watchdog is set and read back. Its DBC describes node 0 (node n: `step`·n added to the identifier),
or a message for each node (``"LINK_{node}"``). Units come from the DBC; beyond
:mod:`cosim.base.units` a torque in ``%`` is of `rated_torque` and a position in ``count`` of
`counts` a turn. ``base`` names another profile of the
same protocol: tables and values that are not in the file are those of its base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import pi
from pathlib import Path
from typing import Any, Literal, TypeVar

from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.layout import LayoutError, MessageLayout, find
from bridge.drives.model import DEFAULTS, VALUES, DriveSpec
from bridge.drives.raw_frames import OwnWatchdog, Raw
from bridge.drives.status import NO_STATUS, DriveStatus, read_status
from bridge.native.frame import Flags
from bridge.native.vendor import VendorKind
from bridge.safety.limits import to_si
from cosim.base import toml
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import conversion

PORTS = {"tau": "N.m", "q": "rad", "dq": "rad/s"}
SEQUENCES = ("enable", "disable", "clear")
_LIMITS = {"tau_max": "N.m", "q_max": "rad", "dq_max": "rad/s"}
#: What feeds the watchdog of a drive.
FED_BY = ("frame", "torque", "heartbeat", "link")
T = TypeVar("T")


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
    """What :func:`load_profile` reads; `limits` in SI, `drive` describes the emulated one."""

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
        """Of all frames to and from these drives, as their command has it: FD, BRS, or none."""
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


def load_profile(path: str | Path) -> DriveProfile:
    """Read a profile and its DBC. Raises ScenarioError with file and place, also LayoutError's."""
    text = str(path)
    found, protocol = _read(Path(path))
    known = {"title", "dbc", "command", "feedback", "sequences", "watchdog", "limits", "drive"}
    known |= {"vendor", "host", "status", "side", "rated_torque", "counts", "refuses_simulated"}
    _known(found, known, text)
    if not isinstance(found.get("dbc"), str):
        raise ScenarioError(f"is {found.get('dbc')!r}, expected a DBC file", f"{text}: dbc")
    try:
        layouts = dbc.load(Path(path).parent / found["dbc"])
    except LayoutError as error:
        raise ScenarioError(str(error), f"{text}: dbc") from None
    profile = replace(_profile(found, layouts, text), protocol=protocol)
    _check(profile)
    return profile


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """A profile as data, completed with the tables of its `base`, and the file of its protocol."""
    found = toml.read(path, "the profile of a drive (.toml)")
    if "base" not in found:
        return found, str(path)
    base = found.pop("base")
    if not isinstance(base, str):
        raise ScenarioError(f"is {base!r}, expected the file of another profile", f"{path}: base")
    of = toml.read(path.parent / base, "the profile of a drive (.toml)")
    if "base" in of:
        raise ScenarioError(f"{base} has a base itself, expected none", f"{path}: base")
    return of | found, str(path.parent / base)


def _profile(found: dict[str, Any], layouts: tuple[MessageLayout, ...], path: str) -> DriveProfile:
    table = {name: _table(found, name, path) for name in ("sequences", "limits", "drive")}
    _known(table["sequences"], set(SEQUENCES), f"{path}: sequences")
    _known(table["limits"], set(_LIMITS), f"{path}: limits")
    own = _table(found, "watchdog", path)
    for name in ("write", "read", "reply"):
        if name in own:
            own[name] = _raw(own[name], f"{path}: watchdog.{name}")
    side = found.get("side", "joint")
    if side not in ("joint", "motor"):
        raise ScenarioError(f"is {side!r}, expected 'joint' or 'motor'", f"{path}: side")
    return DriveProfile(
        path=path,
        title=str(found.get("title", "")),
        layouts=layouts,
        command=_part(_table(found, "command", path), f"{path}: command"),
        feedback=tuple(
            _part(_table(found["feedback"], name, path), f"{path}: feedback.{name}")
            for name in _table(found, "feedback", path)
        ),
        sequences={
            name: tuple(
                _raw(raw, f"{path}: sequences.{name}[{n}]")
                for n, raw in enumerate(table["sequences"].get(name, ()))
            )
            for name in SEQUENCES
        },
        watchdog=_made(OwnWatchdog, own, f"{path}: watchdog"),
        limits={
            name: to_si(value, _LIMITS[name], f"{path}: limits.{name}")
            for name, value in table["limits"].items()
        },
        drive=_drive(table["drive"], f"{path}: drive"),
        side=side,
        rated_torque=to_si(found.get("rated_torque", 0.0), "N.m", f"{path}: rated_torque"),
        counts=to_si(found.get("counts", 0.0), "1", f"{path}: counts"),
        vendor=_vendor(found.get("vendor", ""), f"{path}: vendor"),
        refuses_simulated=bool(found.get("refuses_simulated", False)),
        host=_made(Host, _table(found, "host", path), f"{path}: host"),
        status=read_status(_table(found, "status", path), f"{path}: status"),
    )


def _check(profile: DriveProfile) -> None:
    """Everything a profile names is there and fits, before a bus is opened."""
    if not profile.joints:
        raise ScenarioError("has no signal; expected one per joint", f"{profile.path}: command.tau")
    for part in (profile.command, *profile.feedback):
        codec = profile.codec(part, 1)
        for signal in part.signals:
            profile.conversion(part, signal)
        carries = codec.layout.status_mask & 128
        if part is profile.command and profile.refuses_simulated and not carries:
            raise ScenarioError(
                f"message {part.message} has no status; expected one with the flag simulated",
                f"{profile.path}: refuses_simulated",
            )
    _check_states(profile)
    try:
        profile.host_heartbeat(1)
        profile.host_sync()
    except LayoutError as error:
        raise ScenarioError(str(error), f"{profile.path}: host") from None
    profile.drive.build(profile.joints, 1e-3, f"{profile.path}: drive")


def _check_states(profile: DriveProfile) -> None:
    """Steps expect states that the profile has, and end with an enabled drive."""
    if profile.watchdog.fed_by not in FED_BY:
        text = f"is {profile.watchdog.fed_by!r}, expected one of {', '.join(FED_BY)}"
        raise ScenarioError(text, f"{profile.path}: watchdog.fed_by")
    status, place = profile.status, f"{profile.path}: sequences"
    if not status.message:
        return
    profile.status_layout(1)
    known = {name for state in status.states for name in (state.name, state.kind)}
    for sequence in SEQUENCES:
        for i, raw in enumerate(profile.sequences[sequence]):
            if odd := [name for name in raw.expect if name not in known]:
                text = f"expects {odd[0]!r}, which is no state of [status]"
                raise ScenarioError(text, f"{place}.{sequence}[{i}]")
    enable = profile.sequences["enable"]
    last = status.bits(enable[-1].expect) if enable else 0
    if not last or last & ~status.bits(("enabled",)):
        raise ScenarioError("the last frame does not expect an enabled state", f"{place}.enable")


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


def _part(table: dict[str, Any], place: str) -> ProfileMessage:
    ports = {name: tuple(table[name]) for name in PORTS if name in table}
    return _made(ProfileMessage, {**table, **ports}, place)


def _vendor(name: object, place: str) -> str:
    names = tuple(kind.name.lower() for kind in VendorKind)
    if name and name not in names:
        raise ScenarioError(f"is {name!r}, expected one of {', '.join(names)}", place)
    return str(name)


def _raw(table: dict[str, Any], place: str) -> Raw:
    expect = table.get("expect", ())
    expect = (expect,) if isinstance(expect, str) else tuple(expect)
    raw = _made(Raw, {**table, "expect": expect}, place)
    raw.check(place)
    return raw


def _drive(table: Mapping[str, Any], place: str) -> DriveSpec:
    """Of the ``[drive]`` table of a profile; an array is one number a joint."""
    _known(table, set(VALUES), place)
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    return DriveSpec(**values).over(DEFAULTS)


def _made(kind: type[T], table: Mapping[str, Any], place: str) -> T:
    _known(table, {field.name for field in fields(kind)}, place)  # type: ignore[arg-type]
    try:
        return kind(**table)
    except TypeError as error:
        raise ScenarioError(f"{error}", place) from None


def _table(found: Mapping[str, Any], name: str, path: str) -> dict[str, Any]:
    value = found.get(name, {})
    if not isinstance(value, dict):
        raise ScenarioError(f"is {value!r}, expected a table", f"{path}: {name}")
    return dict(value)


def _known(table: Mapping[str, Any], names: set[str], place: str) -> None:
    for name in table:
        if name not in names:
            raise ScenarioError(
                f"has no {name!r}, expected some of {', '.join(sorted(names))}", place
            )
