"""A scene of MuJoCo (MJCF or URDF) as a Component; MuJoCo itself is loaded when a scene is.

Here are the options of such a component, and how a scenario names it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from cosim.base.convert import convert
from cosim.base.errors import ScenarioError

#: What the name of a model begins with; the rest is a file.
PREFIX = "mujoco:"


class MujocoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The joints and signals of a scene that are ports, and its start.

    `joints`: names of hinge or slide joints, in the order of the entries of ``q``, ``dq``, ``tau``,
    where ``*`` stands for any text; `groups`: several such lists, whose names are the suffixes of
    their ports (``q_left``). Neither: all hinges, and all slides. `outputs`: the outputs that are
    ports, by name or pattern (default: all). `keyframe`: the state of the scene at the start.
    """

    joints: tuple[str, ...] = ()
    groups: dict[str, tuple[str, ...]] = {}
    outputs: tuple[str, ...] = ("*",)
    keyframe: str = ""


def read_options(options: Mapping[str, Any], place: str) -> MujocoOptions:
    """The options of a component. Raises ScenarioError at `place`."""
    found = convert(dict(options), MujocoOptions, Path(place))
    if found.joints and found.groups:
        raise ScenarioError("found joints and groups, expected one of the two", place)
    return found


def scene_path(model: str, folder: Path) -> Path:
    """The file that a model such as ``mujoco:scene.xml`` names, relative to `folder`."""
    path = Path(model.removeprefix(PREFIX))
    return path if path.is_absolute() else folder / path
