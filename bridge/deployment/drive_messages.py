"""Messages of foreign drives: a profile's frames, carrying values at the joint in SI.

Gear, direction, zero and the drive's units are folded into scale and offset of the signals, so
encoding stays one table in C: value at the joint = scale · raw + offset.
"""

from __future__ import annotations

from bridge.can.codec import Codec
from bridge.can.codec_check import verify
from bridge.can.layout import MessageLayout
from bridge.deployment.cut import Outlet
from bridge.deployment.spec import Deployment, MessageSpec
from bridge.drives.profile_files import load_profile
from bridge.drives.profiles import PORTS, DriveProfile, Joint, ProfileMessage
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.units import quantity


def codec(outlet: Outlet, d: Deployment) -> Codec:
    """The codec of a message that names a profile. Raises ScenarioError, LayoutError."""
    spec, place = d.messages[outlet.message], d.place("messages", outlet.message)
    profile = profile_of(d, outlet.message)
    if d.buses[spec.bus].kind != "can":
        raise ScenarioError(f"{spec.bus} is not a CAN bus; a profile belongs to a CAN drive", place)
    if spec.name or spec.signals:
        raise ScenarioError("the profile defines name and signals; expected neither", place)
    part, names = _part(profile, outlet, place)
    layout = profile.layout(part, spec.drive)
    verify(Codec(layout, names))  # before the units are folded in
    made = _si_signals(layout, profile, part, _joint(spec))
    return Codec(made, names, exact=part is profile.command)


def feedback_codec(d: Deployment, message: str, port: str) -> Codec | None:
    """The codec of what the drive of a message reports of `port`, in SI at the joint, or None.

    Raises ScenarioError, LayoutError.
    """
    profile, spec = profile_of(d, message), d.messages[message]
    for part in profile.feedback:
        if names := getattr(part, port):
            layout = profile.layout(part, spec.drive)
            return Codec(_si_signals(layout, profile, part, _joint(spec)), names)
    return None


def command_codec(d: Deployment, message: str) -> Codec:
    """The codec of the torques of a message that names a profile, N.m at the joint.

    Raises ScenarioError, LayoutError.
    """
    profile, spec = profile_of(d, message), d.messages[message]
    part = profile.command
    made = _si_signals(profile.layout(part, spec.drive), profile, part, _joint(spec))
    return Codec(made, part.tau, exact=True)


def _joint(spec: MessageSpec) -> Joint:
    """The gear, direction and zero between the drive of a message and its joint."""
    zero = spec.zero if isinstance(spec.zero, int | float) else quantity(spec.zero, "rad")
    return Joint(spec.gear, spec.direction, float(zero))


def profile_of(d: Deployment, message: str) -> DriveProfile:
    """The profile of a message's drive, with the frame format of this drive."""
    spec = d.messages[message]
    return load_profile(d.file(spec.profile)).with_format(spec.fd)


def _part(profile: DriveProfile, outlet: Outlet, place: str) -> tuple[ProfileMessage, list[str]]:
    """The message of the profile that has all these ports, and its signals in their order."""
    ports = [part.port for part in outlet.parts for _ in range(part.size)]
    odd = [port for port in ports if port not in PORTS]
    if odd:
        raise ScenarioError(f"port {odd[0]!r} is none of {', '.join(PORTS)}", f"{place}.carries")
    parts = (profile.command,) if "tau" in ports else profile.feedback
    for part in parts:
        left = {port: list(getattr(part, port)) for port in PORTS}
        if all(ports.count(port) <= len(left[port]) for port in PORTS):
            return part, [left[port].pop(0) for port in ports]
    sizes = "; ".join(
        f"{p.message}: " + ", ".join(f"{len(getattr(p, n))} {n}" for n in PORTS) for p in parts
    )
    text = f"{profile.path} has no message for {', '.join(ports)}; it has {sizes}"
    raise ScenarioError(text, f"{place}.carries")


def _si_signals(
    layout: MessageLayout, profile: DriveProfile, part: ProfileMessage, joint: Joint
) -> MessageLayout:
    """Signals of the part as values at the joint, in SI."""
    carried = set(part.signals)
    signals = tuple(
        s.converted(*profile.conversion(part, s.name, joint), s.unit) if s.name in carried else s
        for s in layout.signals
    )
    return replace(layout, signals=signals)
