"""A URDF file as links and joints; what is wrong in it is one sentence with file and element.

Shapes, meshes and colours are not read. Source: the URDF specification, wiki.ros.org/urdf/XML
(2012 and later): roll, pitch and yaw turn about fixed axes, the default axis is x.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import NoReturn, TypeAlias, final
from xml.etree import ElementTree

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.toml import is_usable_number
from cosim.base.urdf import OF_INERTIA, unread, wrong_word
from cosim.loading.file_kinds import use
from fmus.arms.body import Placement, RigidBody, from_rpy, symmetric
from fmus.model.numeric import Array

#: Greatest size of a length, an angle, a mass or a moment of inertia (SI): some files have 1e+16 as
#: a limit of a joint, which stands for none, but nothing else is so large.
MOST = 1e9
MOVING = ("revolute", "continuous", "prismatic")
#: The inertia of each link by name; None for one without.
Links: TypeAlias = dict[str, RigidBody | None]


@final
@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint: its frame in the parent link, its axis (3,) there, its limits in rad or m.

    `effort` (N.m or N) and `velocity` (rad/s or m/s) are infinite where the file has none.
    """

    name: str
    type: str
    parent: str
    child: str
    frame: Placement
    axis: Array
    lower: float
    upper: float
    effort: float
    velocity: float
    damping: float
    friction: float
    mimics: str

    @property
    def moves(self) -> bool:
        """True if it is not fixed."""
        return self.type in MOVING


@final
@dataclass(frozen=True, slots=True)
class Urdf:
    """A robot as in the file; `links` by name, None for one without inertia.

    `unread`: what the file says about the motion and is not read, a sentence each.
    """

    path: Path
    links: Links
    joints: tuple[UrdfJoint, ...]
    unread: tuple[str, ...]

    def place(self, kind: str, name: str) -> str:
        """``FILE, joint 'elbow'``, for messages."""
        return f"{self.path}, {kind} {name!r}"

    def joint_above(self, link: str) -> UrdfJoint | None:
        """The joint that carries a link; None for the root."""
        return next((j for j in self.joints if j.child == link), None)

    def joints_on(self, link: str) -> Iterator[UrdfJoint]:
        """The joints that a link carries."""
        return (j for j in self.joints if j.parent == link)


@final
class _Element:
    """An XML element with its place for messages; errors are ScenarioError."""

    def __init__(self, element: ElementTree.Element, place: str) -> None:
        self.element, self.place = element, place

    def refuse(self, message: str) -> NoReturn:
        raise ScenarioError(message, self.place)

    def child(self, tag: str) -> _Element | None:
        found = self.element.findall(tag)
        if len(found) > 1:
            self.refuse(f"{len(found)} elements <{tag}>, expected one")
        return _Element(found[0], f"{self.place}, <{tag}>") if found else None

    def text(self, attribute: str) -> str:
        found = self.element.get(attribute)
        if not found:
            self.refuse(f"no attribute {attribute!r}")
        return found

    def number(self, attribute: str, default: float | None = None, most: float = MOST) -> float:
        if default is not None and attribute not in self.element.keys():  # noqa: SIM118
            return default
        return self._floats(attribute, 1, most)[0]

    def vector(self, attribute: str, default: tuple[float, float, float]) -> Array:
        if attribute not in self.element.keys():  # noqa: SIM118
            return np.array(default)
        return np.array(self._floats(attribute, 3, MOST))

    def _floats(self, attribute: str, count: int, most: float) -> list[float]:
        words = self.text(attribute).split()
        try:
            found = [float(word) for word in words]
        except ValueError:
            found = []
        if len(found) != count or not all(is_usable_number(x) and abs(x) <= most for x in found):
            numbers = "a finite number" if count == 1 else f"{count} finite numbers"
            expected = numbers if most == inf else f"{numbers} of at most {most:g}"
            self.refuse(f'found {attribute}="{self.text(attribute)}", expected {expected}')
        return found


def read(path: str | Path) -> Urdf:
    """Read a URDF file. Raises ScenarioError for everything that is wrong in it."""
    path = Path(path)
    root = _parse(path)
    if (wrong := wrong_word(root)) is not None:
        raise ScenarioError(wrong[1], f"{path}, {wrong[0]}")
    links: Links = {}
    for element in root.findall("link"):
        name = _name(path, "link", element, links)
        links[name] = _inertia(_Element(element, f"{path}, link {name!r}"))
    joints: dict[str, UrdfJoint] = {}
    for element in root.findall("joint"):
        name = _name(path, "joint", element, joints)
        joints[name] = _joint(_Element(element, f"{path}, joint {name!r}"), name, links)
    _check_tree(path, links, joints)
    return Urdf(path, links, tuple(joints.values()), tuple(unread(root)))


def _parse(path: Path) -> ElementTree.Element:
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror}", str(path)) from None
    if b"\0" in text or re.search(rb"<!(DOCTYPE|ENTITY)", text):
        raise ScenarioError("found a DTD, an entity or a NUL, expected plain XML", str(path))
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        kind = "" if path.suffix == ".urdf" else use(path)
        found = kind or f"is not XML: {error}"
        raise ScenarioError(f"{found}; expected a URDF file", str(path)) from None
    for element in root.iter():
        words = (str(element.tag), *element.keys(), *element.attrib.values())
        if any("xacro}" in word or "${" in word for word in words):
            raise ScenarioError(
                f"found xacro in <{str(element.tag).rpartition('}')[2]}>, expected an expanded file"
                " (xacro robot.urdf.xacro > robot.urdf)",
                str(path),
            )
    if root.tag != "robot":
        raise ScenarioError(f"found <{root.tag}>, expected <robot> of a URDF", str(path))
    return root


def _name(path: Path, kind: str, element: ElementTree.Element, known: object) -> str:
    name = element.get("name")
    if not name:
        raise ScenarioError(f"found a <{kind}> without name", str(path))
    if isinstance(known, dict) and name in known:
        raise ScenarioError(f"declared twice, expected names of {kind}s once", f"{path}, {name!r}")
    return name


def _origin(element: _Element) -> Placement:
    origin = element.child("origin")
    if origin is None:
        return Placement(np.eye(3), np.zeros(3))
    zero = (0.0, 0.0, 0.0)
    return Placement(from_rpy(origin.vector("rpy", zero)), origin.vector("xyz", zero))


def _inertia(link: _Element) -> RigidBody | None:
    """The inertia of a link about the origin of its frame, as it is in the file."""
    inertial = link.child("inertial")
    if inertial is None:
        return None
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    if mass is None or inertia is None:
        inertial.refuse(f"no <{'mass' if mass is None else 'inertia'}>")
    tensor = symmetric([inertia.number(entry) for entry in OF_INERTIA["inertia"]])
    return RigidBody.about_centre(mass.number("value"), tensor, _origin(inertial))


def _joint(element: _Element, name: str, links: Links) -> UrdfJoint:
    kind = element.text("type")
    if kind not in (*MOVING, "fixed"):
        element.refuse(f"found type {kind!r}, expected one of {', '.join(MOVING)}, fixed")
    lower, upper, effort, velocity = _limits(element, kind)
    dynamics, mimic = element.child("dynamics"), element.child("mimic")
    damping, friction = 0.0, 0.0
    if dynamics is not None:
        damping, friction = dynamics.number("damping", 0.0), dynamics.number("friction", 0.0)
        if min(damping, friction) < 0.0:
            dynamics.refuse("found a negative value, expected damping and friction of at least 0")
    return UrdfJoint(
        name,
        kind,
        parent=_end(element, "parent", links),
        child=_end(element, "child", links),
        frame=_origin(element),
        axis=_axis(element, kind),
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        damping=damping,
        friction=friction,
        mimics="" if mimic is None else mimic.text("joint"),
    )


def _end(joint: _Element, tag: str, links: Links) -> str:
    """The name of the parent or the child of a joint."""
    end = joint.child(tag)
    if end is None:
        joint.refuse(f"no <{tag}>")
    name = end.text("link")
    if name not in links:
        end.refuse(f"there is no link {name!r}")
    return name


def _axis(element: _Element, kind: str) -> Array:
    given = element.child("axis")
    axis = np.array([1.0, 0.0, 0.0]) if given is None else given.vector("xyz", (1.0, 0.0, 0.0))
    length = float(np.linalg.norm(axis))
    if kind in MOVING and length < 1e-6:
        element.refuse("found an <axis> of length 0, expected a direction")
    return axis / length if length else axis


def _limits(element: _Element, kind: str) -> tuple[float, float, float, float]:
    """(lower, upper, effort, velocity), infinite where a joint need not have them."""
    limit = element.child("limit")
    bounded = kind in ("revolute", "prismatic")
    if limit is None:
        if bounded:
            element.refuse(f"no <limit>, expected one of a {kind} joint")
        return -inf, inf, inf, inf
    lower, upper, effort, velocity = (
        limit.number(name, 0.0, inf) for name in ("lower", "upper", "effort", "velocity")
    )
    if bounded and not lower < upper:
        limit.refuse(f"found lower {lower:g} and upper {upper:g}, expected lower below upper")
    if min(effort, velocity) < 0.0:
        limit.refuse(f"found {min(effort, velocity):g}, expected effort and velocity of at least 0")
    bounds = (lower, upper) if bounded else (-inf, inf)
    return *bounds, effort or inf, velocity or inf


def _check_tree(path: Path, links: Links, joints: dict[str, UrdfJoint]) -> None:
    """Every link has at most one parent, and one link has none."""
    carried: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        if joint.child in carried:
            raise ScenarioError(
                f"carried by the joints {carried[joint.child].name!r} and {joint.name!r}, expected"
                " one: closed loops are not supported",
                f"{path}, link {joint.child!r}",
            )
        carried[joint.child] = joint
    for link in links:
        above, seen = link, {link}
        while above in carried:
            above = carried[above].parent
            if above in seen:
                raise ScenarioError("it carries itself: a closed loop", f"{path}, link {link!r}")
            seen.add(above)
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        found = ", ".join(map(repr, roots)) or "none"
        raise ScenarioError(f"links that no joint carries: {found}; expected one", str(path))
