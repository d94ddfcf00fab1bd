"""Files of drive profiles (``configs/drives/NAME.toml``): read and checked.

A profile names a DBC file, the message that carries torque and those that carry feedback, which of
their signals belong to which joint, frames that enable, disable and clear, and how the drive's own
watchdog is set and read back. ``base`` names another profile of the same protocol: tables and
values that are not in the file are those of its base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from bridge.can import dbc
from bridge.can.layout import LayoutError, MessageLayout
from bridge.drives.model import DEFAULTS, VALUES, DriveSpec
from bridge.drives.profiles import PORTS, DriveProfile, Host, ProfileMessage
from bridge.drives.raw_frames import OwnWatchdog, Raw
from bridge.drives.status import read_status
from bridge.native.vendor import VendorKind
from bridge.safety.limits import to_si
from cosim.base import toml
from cosim.base.copies import field_names, replace
from cosim.base.errors import ScenarioError

SEQUENCES = ("enable", "disable", "clear")
_LIMITS = {"tau_max": "N.m", "q_max": "rad", "dq_max": "rad/s"}
#: What feeds the watchdog of a drive.
FED_BY = ("frame", "torque", "heartbeat", "link")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Kept:
    """A profile that was read, and the files that it came from, each with its version."""

    profile: DriveProfile
    files: tuple[tuple[Path, tuple[int, ...]], ...]


_KEPT: dict[str, _Kept] = {}


def load_profile(path: str | Path) -> DriveProfile:
    """Read a profile and its DBC, or take what was read before of the same files.

    Raises ScenarioError with file and place, also LayoutError's.
    """
    text = str(path)
    known = _KEPT.get(text)
    if known is not None and all(_version(file) == version for file, version in known.files):
        return known.profile
    files: list[Path] = []
    profile = _load(Path(path), files)
    _KEPT[text] = _Kept(profile, tuple((file, _version(file)) for file in files))
    return profile


def _version(file: Path) -> tuple[int, ...]:
    """Numbers that change with the content of a file; () where there is none."""
    try:
        s = file.stat()
    except OSError:
        return ()
    return s.st_dev, s.st_ino, s.st_mtime_ns, s.st_size


def _load(path: Path, files: list[Path]) -> DriveProfile:
    text = str(path)
    found, protocol = _read(path)
    known = {"title", "dbc", "command", "feedback", "sequences", "watchdog", "limits", "drive"}
    known |= {"vendor", "host", "status", "side", "rated_torque", "counts", "refuses_simulated"}
    _known(found, known, text)
    if not isinstance(found.get("dbc"), str):
        raise ScenarioError(f"is {found.get('dbc')!r}, expected a DBC file", f"{text}: dbc")
    try:
        layouts = dbc.load(path.parent / found["dbc"])
    except LayoutError as error:
        raise ScenarioError(str(error), f"{text}: dbc") from None
    profile = replace(_profile(found, layouts, text), protocol=protocol)
    _check(profile)
    files += [path, Path(protocol)]
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
    """The drive of the ``[drive]`` table of a profile; an array is one number a joint."""
    _known(table, set(VALUES), place)
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    return DriveSpec(**values).over(DEFAULTS)


def _made(kind: type[T], table: Mapping[str, Any], place: str) -> T:
    _known(table, {*field_names(kind)}, place)
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
