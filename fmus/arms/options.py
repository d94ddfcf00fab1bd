"""Options of a model of a robot for scenarios: sizes and parameters from ``options.urdf``.

```toml
[components.master]
model = "fmus.models.arm"
options.urdf = "robots/two_rods.urdf"    # relative to the scenario
options.base = "floor"                   # links of the file
options.tip = "hand"
options.payload = { mass = "0.5 kg", centre = [0.0, 0.0, 0.1] }   # in the frame of the tip
options.fixed = { finger = 0.0 }         # joints that are held, rad or m
options.estimate = 0.8                   # of an adaptive law: theta_hat(0), a part of the file's
options.adapt = "base"                   # the parameters it adapts; "all", or ["m[6]", 5]
options.gain = [1.0, 0.1, 0.01]          # Gamma of m, m c and I of what is adapted
```
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.component import Preparation
from cosim.base.convert import number, numbers
from cosim.base.errors import ScenarioError
from fmus.arms.adapted import chosen
from fmus.arms.body import Placement, RigidBody, symmetric
from fmus.arms.chain import unphysical
from fmus.arms.serial import Robot, serial

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from fmus.model import Model, Variable

_KEYS = ("urdf", "base", "tip", "payload", "fixed", "estimate", "adapt", "gain")
_GAIN = [1.0, 0.1, 0.01]
_PAYLOAD = ("mass", "centre", "inertia")
#: What stands for "no limit" of a position (rad) and of a torque (N.m) in the models.
NO_LIMIT, NO_TORQUE = 1e6, 1e9


def prepare(model: Callable[..., Model], options: Mapping[str, Any], folder: Path) -> Preparation:
    """Sizes and values of a `model` that has the size `joints`; paths are relative to `folder`.

    Of the values, those whose variable the model has. Raises ScenarioError for options or a file
    that cannot be.
    """
    robot = robot_of(options, folder)
    sizes = {"joints": robot.table.joints}
    declared = {v.name: v for v in model(**sizes).variables}
    found = {
        **robot.table.values(),
        "q_min": np.maximum(robot.lower, -NO_LIMIT),
        "q_max": np.minimum(robot.upper, NO_LIMIT),
        "tau_max": np.minimum(robot.effort, NO_TORQUE),
        "damping": robot.damping,
        "friction": robot.friction,
        "tip": robot.tip.r,
    }
    if "estimate" in options:
        if "theta_hat" not in declared:
            raise ScenarioError("the model estimates nothing; expected no key 'estimate'")
        if declared["theta_hat"].shape != robot.table.inertia.shape:
            raise ScenarioError(
                "the model estimates parameters over gains that are not known; expected no key"
                " 'estimate'"
            )
        found["theta_hat"] = number(options["estimate"], "1", "estimate") * robot.table.inertia
    if "adapt" in options or "gain" in options:
        if "Gamma" not in declared:
            raise ScenarioError("the model adapts nothing; expected no keys 'adapt' and 'gain'")
        gain = numbers(options.get("gain", _GAIN), (3,), "1", "gain")
        if min(gain) < 0.0:
            raise ScenarioError(f"found {gain}, expected nothing below 0", "gain")
        of_each = np.repeat(gain, (1, 3, 6))  # m, m c, I
        found["Gamma"] = of_each * chosen(robot.table, options.get("adapt", "all"))
    values = {name: value.tolist() for name, value in found.items() if name in declared}
    file = robot.path
    sums = {str(file): sha256(file.read_bytes()).hexdigest()}
    remarks = tuple(f"{file.name}: {x}" for x in robot.unread)
    return Preparation(sizes, values, sums, remarks, _units(robot, declared.values()))


#: Units of what belongs to a joint that turns, and to one that slides.
SLIDING = {
    "rad": "m",
    "rad/s": "m/s",
    "rad/s2": "m/s2",
    "N.m": "N",
    "N.m/rad": "N/m",
    "N.m.s/rad": "N.s/m",
}


def _units(robot: Robot, declared: Iterable[Variable]) -> dict[str, tuple[str, ...]]:
    """The units of the entries of each variable that has one per joint, if a joint slides."""
    slides = robot.table.joint_type != 0
    if not slides.any():
        return {}
    return {
        v.name: tuple(
            SLIDING[v.unit] if sliding else v.unit
            for sliding in np.broadcast_to(slides, v.shape).ravel()
        )
        for v in declared
        if v.unit in SLIDING and v.shape and v.shape[-1] == len(slides)
    }


def robot_of(options: Mapping[str, Any], folder: Path) -> Robot:
    """The arm that options name; its file is relative to `folder`. Raises ScenarioError."""
    for key in options:
        if key not in _KEYS:
            raise ScenarioError(f"unknown key {key!r}; expected one of {', '.join(_KEYS)}")
    urdf, base, tip = (_text(options, key) for key in _KEYS[:3])
    return serial(folder / urdf, base, tip, _table(options, "fixed"), _payload(options))


def _text(options: Mapping[str, Any], key: str) -> str:
    value = options.get(key)
    if not isinstance(value, str) or not value:
        what = "a file" if key == "urdf" else "the name of a link"
        raise ScenarioError(f"found {key} = {value!r}, expected {what}")
    return value


def _table(options: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = options.get(key, {})
    if not isinstance(value, dict):
        raise ScenarioError(f"found {key} = {value!r}, expected a table")
    return value


def _payload(options: Mapping[str, Any]) -> RigidBody | None:
    """A body in the frame of the tip: a point at its centre, or with a tensor about it."""
    if "payload" not in options:
        return None
    given = _table(options, "payload")
    for key in given:
        if key not in _PAYLOAD:
            raise ScenarioError(
                f"unknown key {key!r}; expected one of {', '.join(_PAYLOAD)}", "payload"
            )
    mass = number(given.get("mass", 0.0), "kg", "payload.mass")
    centre = numbers(given.get("centre", 0.0), (3,), "m", "payload.centre")
    entries = numbers(given.get("inertia", 0.0), (6,), "kg.m2", "payload.inertia")
    body = RigidBody.about_centre(mass, symmetric(entries), Placement(np.eye(3), np.array(centre)))
    if (why := unphysical(body.parameters())) is not None:
        raise ScenarioError(why, "payload")
    return body
