"""Words of URDF: which a file may use, and which no simulator here gives a meaning.

A reader that skips what it does not know takes a misspelt ``lower`` for the default of a limit. So
the attributes of joints and inertias are compared with those of the format. What is left out on
purpose becomes a remark, if it would change the motion; shapes, colours and sensors do not.

Source: the URDF specification, wiki.ros.org/urdf/XML (2012 and later).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from xml.etree.ElementTree import Element

#: Attributes by element of a joint, and of an inertia.
OF_JOINT: Mapping[str, tuple[str, ...]] = {
    "origin": ("xyz", "rpy"),
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
    "calibration": ("rising", "falling", "reference_position"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
OF_INERTIA: Mapping[str, tuple[str, ...]] = {
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
}
#: Elements whose numbers are a place or a mass: there an unknown attribute is refused. Elsewhere
#: some makers write attributes of their own, and only what is nearly a known word is refused.
_EXACT, _ALIKE = ("origin", "axis", "mass", "inertia"), 0.75
#: What extensions say about the motion: of a transmission, and of a link or joint in Gazebo.
_EXTENSIONS = {
    "transmission": ("mechanicalReduction", "motorInertia"),
    "gazebo": (
        *("springStiffness", "springReference", "dampingFactor", "turnGravityOff", "gravity"),
        *("mu1", "mu2", "kp", "kd"),
    ),
}


def wrong_word(root: Element) -> tuple[str, str] | None:
    """The first word of a joint or an inertia that the format does not have; None: all are known.

    Returns (place in the file, what is wrong). `root`: the element <robot>.
    """
    for joint in root.findall("joint"):
        if why := _unknown(joint, OF_JOINT):
            return f"joint {joint.get('name')!r}", why
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            if why := _unknown(inertial, OF_INERTIA):
                return f"link {link.get('name')!r}, <inertial>", why
    return None


def _unknown(outer: Element, known: Mapping[str, tuple[str, ...]]) -> str:
    """The first word in an element that is not among the known, as a sentence; "": none."""
    for element in outer:
        if element.tag not in known:
            return f"unknown element <{element.tag}>, expected one of {', '.join(known)}"
        for name in _strange(element, known):
            missing = [word for word in known[element.tag] if word not in element.attrib]
            if element.tag in _EXACT or get_close_matches(name, missing, cutoff=_ALIKE):
                expected = ", ".join(known[element.tag])
                return f"unknown attribute {name!r} of <{element.tag}>, expected one of {expected}"
    return ""


def _strange(element: Element, known: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    return (name for name in element.attrib if name not in known.get(element.tag, ()))


def unread(root: Element) -> Iterator[str]:
    """Statements of a file about the motion that no simulator here obeys, a sentence each."""
    joints = root.findall("joint")
    if soft := [j.get("name") for j in joints if j.find("safety_controller") is not None]:
        names = ", ".join(map(repr, soft))
        yield f"<safety_controller> of the joints {names} is not read: its soft limits do not act"
    found = {(x.tag, name) for j in joints for x in j for name in _strange(x, OF_JOINT)}
    for tag, name in sorted(found):
        yield f"the attribute {name!r} of <{tag}> is not read: URDF does not have it"
    for tag, words in _EXTENSIONS.items():
        said = [x.tag for outer in root.findall(tag) for x in outer.iter() if x.tag in words]
        if said:
            names = ", ".join(f"<{word}>" for word in dict.fromkeys(said))
            yield f"{names} in <{tag}> is not read and does not act"
