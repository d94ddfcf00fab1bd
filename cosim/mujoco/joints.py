"""Joints of a scene in groups: those whose values are the entries of one vector port."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from cosim.base.errors import MujocoError
from cosim.base.names import unknown
from cosim.mujoco import MujocoOptions
from cosim.mujoco.scene import JOINT, Scene

FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint


@dataclass(frozen=True, slots=True)
class JointGroup:
    """Joints of one kind: their indices in the model. `suffix`: of the names of their ports."""

    suffix: str
    joints: tuple[int, ...]
    slides: bool

    @property
    def position_unit(self) -> str:
        """Unit of a position."""
        return "m" if self.slides else "rad"

    @property
    def velocity_unit(self) -> str:
        """Unit of a velocity."""
        return "m/s" if self.slides else "rad/s"

    @property
    def force_unit(self) -> str:
        """Unit of a force or torque."""
        return "N" if self.slides else "N.m"

    def port(self, name: str) -> str:
        """The name of a port of this group."""
        return f"{name}_{self.suffix}" if self.suffix else name


def joint_groups(scene: Scene, options: MujocoOptions) -> list[JointGroup]:
    """The groups that the options ask for. Raises MujocoError for joints that cannot be grouped."""
    if options.joints:
        return [_group(scene, "", options.joints)]
    if options.groups:
        return [_group(scene, suffix, names) for suffix, names in options.groups.items()]
    types = scene.model.jnt_type.tolist()
    hinges = tuple(i for i, t in enumerate(types) if t == HINGE)
    slides = tuple(i for i, t in enumerate(types) if t == SLIDE)
    found = [JointGroup("", hinges, slides=False)] if hinges else []
    return [*found, JointGroup("slide" if hinges else "", slides, slides=True)] if slides else found


def _group(scene: Scene, suffix: str, patterns: Sequence[str]) -> JointGroup:
    names, types = scene.names(JOINT), scene.model.jnt_type.tolist()
    joints: list[int] = []
    for pattern in patterns:
        matching = [i for i, name in enumerate(names) if name and fnmatchcase(name, pattern)]
        if not matching:
            raise MujocoError(f"{scene.path}: {unknown(pattern, filter(None, names), 'joint')}")
        joints += [i for i in matching if i not in joints]
    kinds = {types[i] for i in joints}
    if not kinds <= {SLIDE, HINGE} or len(kinds) > 1:
        listed = ", ".join(f"{names[i]} is {_kind(types[i])}" for i in joints)
        raise MujocoError(
            f"{scene.path}: {listed}; expected joints of one vector to be all hinges or all slides"
        )
    return JointGroup(suffix, tuple(joints), slides=kinds == {SLIDE})


def _kind(joint_type: int) -> str:
    return ("a free joint", "a ball joint", "a slide", "a hinge")[joint_type]
