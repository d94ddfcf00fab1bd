"""The serial chain of a URDF from a base to a tip, in the normal form of ``fmus.arms.chain``.

Fixed joints, and moving ones held at a value, merge their links. What is beyond the tip, and what
branches off a moving link, is carried along: it must not move by itself. The axis of each joint
becomes the z axis of its frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from cosim.base.convert import numbers
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from fmus.arms.body import Placement, RigidBody
from fmus.arms.chain import MOST, Table, skew
from fmus.arms.urdf import Urdf, UrdfJoint, read
from fmus.model.numeric import Array

#: Standard gravity of the project, m/s2, along -z of the file's root link.
GRAVITY = 9.81


#: What each joint of the file gives to the vectors of a robot.
_OF_JOINTS = ("lower", "upper", "effort", "velocity", "damping", "friction")


@final
@dataclass(frozen=True, slots=True)
class Robot:
    """A serial arm; vectors are of shape (n,), of rad and N.m or of m and N by the joint.

    `tip` is the frame of the tip link in the last link of the table. `effort` and `velocity` are
    infinite where the file has none. `unread`: as of ``fmus.arms.urdf.Urdf``.
    """

    path: Path
    names: tuple[str, ...]
    table: Table
    tip: Placement
    lower: Array
    upper: Array
    effort: Array
    velocity: Array
    damping: Array
    friction: Array
    unread: tuple[str, ...] = ()

    @property
    def mass(self) -> float:
        """The mass that moves, kg."""
        return float(self.table.inertia[:, 0].sum())


def serial(
    path: str | Path,
    base: str,
    tip: str,
    fixed: Mapping[str, float | str] | None = None,
    payload: RigidBody | None = None,
) -> Robot:
    """The arm of a URDF file from link `base` to link `tip`.

    `fixed`: joints that are held, with their values: numbers in rad (m where a joint slides), or
    texts with a unit. `payload`: a body in the frame of
    the tip. Gravity points along -z of the root of the file. Raises ScenarioError.
    """
    urdf = read(path)
    chain = _Chain(urdf, _held(urdf, fixed or {}))
    parts = list(_parts(chain, base, tip))
    if not 1 <= len(parts) <= MOST:
        raise ScenarioError(
            f"{len(parts)} moving joints between {base!r} and {tip!r}, expected 1 to {MOST}",
            chain.at,
        )
    if payload is not None:
        last = parts[-1]
        parts[-1] = replace(last, body=last.body + payload.moved(last.end))
    moving = [part.joint for part in parts]
    return Robot(
        chain.urdf.path,
        tuple(joint.name for joint in moving),
        _table(parts, _gravity(chain, base)),
        Placement(_to_z(moving[-1].axis).T, np.zeros(3)) @ parts[-1].end,
        unread=chain.urdf.unread,
        **{name: np.array([getattr(joint, name) for joint in moving]) for name in _OF_JOINTS},
    )


def _held(urdf: Urdf, fixed: Mapping[str, float | str]) -> dict[str, float]:
    """The values of the joints that are held, rad or m.

    Raises ScenarioError for a joint that cannot be held, or not at its value.
    """
    moving = {joint.name: joint for joint in urdf.joints if joint.moves}
    found = {}
    for name, given in fixed.items():
        if name not in moving:
            known = ", ".join(moving) or "none"
            raise ScenarioError(
                f"no moving joint {name!r} to hold, as in `fixed`; there are: {known}",
                str(urdf.path),
            )
        joint, place = moving[name], urdf.place("joint", name)
        how, unit = ("slides", "m") if joint.type == "prismatic" else ("turns", "rad")
        (value,) = numbers(given, (), unit, f"{place}, which {how}, in `fixed`")
        if not joint.lower <= value <= joint.upper:
            raise ScenarioError(
                f"held at {value:g} in `fixed`, expected {joint.lower:g} to {joint.upper:g}", place
            )
        found[name] = value
    return found


@final
@dataclass(frozen=True, slots=True)
class _Part:
    """A moving joint: its frame in the moving link before it, and all that moves with its link.

    `end` is the frame, in its link, where the path to the tip leaves the link: at the next moving
    joint, or at the tip.
    """

    joint: UrdfJoint
    frame: Placement
    body: RigidBody
    end: Placement


@final
@dataclass(frozen=True, slots=True)
class _Chain:
    """A robot, and the joints that are held at a value (rad or m)."""

    urdf: Urdf
    held: Mapping[str, float]

    @property
    def at(self) -> str:
        """The place of the file in messages."""
        return str(self.urdf.path)

    def is_free(self, joint: UrdfJoint) -> bool:
        """True if it moves."""
        return joint.moves and joint.name not in self.held

    def frame(self, joint: UrdfJoint) -> Placement:
        """The frame of the child of a joint that does not move, in the frame of its parent."""
        value = self.held.get(joint.name, 0.0)
        if joint.type == "prismatic":
            return joint.frame @ Placement(np.eye(3), joint.axis * value)
        return joint.frame @ Placement(_about(joint.axis, value), np.zeros(3))

    def path(self, base: str, tip: str) -> list[UrdfJoint]:
        """The joints from base to tip. Raises ScenarioError where there is no such path."""
        for end, name in (("base", base), ("tip", tip)):
            if name not in self.urdf.links:
                known = ", ".join(self.urdf.links)
                raise ScenarioError(f"no link {name!r} as {end}; there are: {known}", self.at)
        joints: list[UrdfJoint] = []
        link = tip
        while link != base:
            above = self.urdf.joint_above(link)
            if above is None:
                raise ScenarioError(
                    f"link {base!r} does not carry {tip!r}; expected a base between the root"
                    f" {link!r} and the tip",
                    self.at,
                )
            joints.insert(0, above)
            link = above.parent
        return joints

    def carried(self, link: str, apart: str) -> Iterator[RigidBody]:
        """Bodies that move with a link, in its frame; not the child `apart` and what that carries.

        Raises ScenarioError for a body that cannot be, and for a joint that moves.
        """
        left = [(link, Placement(np.eye(3), np.zeros(3)))]
        while left:
            name, frame = left.pop()
            body = self.urdf.links[name]
            if body is not None:
                body.check(self.urdf.place("link", name))
                yield body.moved(frame)
            for joint in self.urdf.joints_on(name):
                if joint.child == apart:
                    continue
                if self.is_free(joint):
                    raise ScenarioError(
                        "it moves, but is not between base and tip; expected it in `fixed` with"
                        f" the value that it is held at: fixed = {{ {joint.name} = 0.0 }}"
                        f" (cosim new arm: --fixed {joint.name}=0)",
                        self.urdf.place("joint", joint.name),
                    )
                left.append((joint.child, frame @ self.frame(joint)))


def _parts(chain: _Chain, base: str, tip: str) -> Iterator[_Part]:
    """The moving joints from base to tip."""
    here = Placement(np.eye(3), np.zeros(3))
    joint, start = None, here
    for each in chain.path(base, tip):
        if not chain.is_free(each):
            here = here @ chain.frame(each)
            continue
        if each.mimics:
            raise ScenarioError(
                f"it mimics the joint {each.mimics!r}, expected joints that move independently, or"
                f" this one in `fixed` (cosim new arm: --fixed {each.name}=0)",
                chain.urdf.place("joint", each.name),
            )
        if joint is not None:
            yield _Part(joint, start, _body(chain, joint, each.child), here)
        joint, start = each, here @ each.frame
        here = Placement(np.eye(3), np.zeros(3))
    if joint is not None:
        yield _Part(joint, start, _body(chain, joint, ""), here)


def _body(chain: _Chain, joint: UrdfJoint, apart: str) -> RigidBody:
    """All that moves with the child of a joint, in its frame. Raises ScenarioError for nothing."""
    body = sum(chain.carried(joint.child, apart), start=RigidBody.nothing())
    if body.mass == 0.0:
        raise ScenarioError(
            f"no <inertial> with a mass, expected one: the joint {joint.name!r} moves the link",
            chain.urdf.place("link", joint.child),
        )
    return body


def _table(parts: list[_Part], g: Array) -> Table:
    """The normal form: each link turned so that the axis of its joint is z."""
    turned = [_to_z(part.joint.axis) for part in parts]
    outer = [np.eye(3), *turned[:-1]]
    to_turned = [Placement(A.T, np.zeros(3)) for A in turned]
    return Table(
        joint_type=np.array([float(part.joint.type == "prismatic") for part in parts]),
        rotation=np.array(
            [B.T @ part.frame.R @ A for B, part, A in zip(outer, parts, turned, strict=True)]
        ),
        origin=np.array([B.T @ part.frame.r for B, part in zip(outer, parts, strict=True)]),
        inertia=np.array(
            [part.body.moved(f).parameters() for part, f in zip(parts, to_turned, strict=True)]
        ),
        armature=np.zeros(len(parts)),
        g=g,
    )


def _gravity(chain: _Chain, base: str) -> Array:
    """G in the frame of the base, (3,) m/s2. Raises ScenarioError for a base that moves."""
    frame = Placement(np.eye(3), np.zeros(3))
    root = next(name for name in chain.urdf.links if chain.urdf.joint_above(name) is None)
    for joint in chain.path(root, base):
        if chain.is_free(joint):
            raise ScenarioError(
                f"it moves the base {base!r}, expected it in `fixed`",
                chain.urdf.place("joint", joint.name),
            )
        frame = frame @ chain.frame(joint)
    return np.asarray(frame.R.T @ np.array([0.0, 0.0, -GRAVITY]))


def _about(axis: Array, angle: float) -> Array:
    """The rotation, (3, 3), about a unit `axis` (3,) by `angle`, rad."""
    a = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * a + (1.0 - np.cos(angle)) * a @ a)


def _to_z(axis: Array) -> Array:
    """The least rotation A, (3, 3), with A e_z = `axis`, a unit vector; about x for -e_z."""
    if axis[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = skew(np.array([-axis[1], axis[0], 0.0]))  # of e_z x axis
    return np.asarray(np.eye(3) + v + v @ v / (1.0 + axis[2]))
