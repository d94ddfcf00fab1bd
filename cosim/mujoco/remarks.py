"""Remarks on a scene for ``cosim check``: delays of its own, parts without ports, bad numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from cosim.mujoco.joints import BALL, FREE, HINGE, SLIDE, JointGroup
from cosim.mujoco.scene import ACTUATOR, BODY, JOINT, SENSOR, Scene

#: The radius of gyration of a body that raises no doubt, m, and in lengths of the robot.
_SMALL, _LENGTHS = 1.0, 2.0


def scene_remarks(scene: Scene) -> tuple[str, ...]:
    """Statements of the file for which the scene has no port, or which act besides the scenario."""
    return (*scene.said, *_delays(scene), *_without_port(scene), *_inertias(scene))


def _delays(scene: Scene) -> Iterator[str]:
    """MuJoCo's own delays, which the scenario does not know."""
    model = scene.model
    for kind, delays in ((ACTUATOR, model.actuator_delay), (SENSOR, model.sensor_delay)):
        for name, delay in zip(scene.names(kind), delays.tolist(), strict=True):
            if delay > 0.0:
                yield (
                    f"the {kind.lower()} {name!r} has a delay of {1e3 * delay:g} ms of its own,"
                    " which adds to those of the links"
                )


def _without_port(scene: Scene) -> Iterator[str]:
    """Joints that no port shows."""
    model = scene.model
    joints, bodies = scene.names(JOINT), scene.names(BODY)
    for name, kind, body in zip(
        joints, model.jnt_type.tolist(), model.jnt_bodyid.tolist(), strict=True
    ):
        if kind == BALL:
            yield f"the ball joint {name!r} moves, but has no port"
        if kind == FREE and not bodies[body]:
            yield "a body that moves freely has no name, and so no port"


def _inertias(scene: Scene) -> Iterator[str]:
    """Bodies with the inertia of one that is much greater than the scene."""
    model = scene.model
    length = float(np.linalg.norm(model.body_pos, axis=1).sum())
    limit = max(_SMALL, _LENGTHS * length)
    for name, mass, moments in zip(
        scene.names(BODY), model.body_mass, model.body_inertia, strict=True
    ):
        if mass > 0.0 and float(max(moments)) > mass * limit**2:
            yield (
                f"the body {name!r} has {float(max(moments)):.4g} kg.m2 and {float(mass):.4g} kg:"
                f" a radius of gyration of {float(max(moments) / mass) ** 0.5:.3g} m"
            )


def start_remarks(
    scene: Scene, groups: list[JointGroup], values: Mapping[str, tuple[float, ...]], home: Any
) -> Iterator[str]:
    """Joints that start outside of their limits; `values` (rad or m) given, the rest as `home`."""
    model, names = scene.model, scene.names(JOINT)
    q = home.qpos.copy()
    for group in groups:
        for joint, value in zip(group.joints, values.get(group.port("q"), ()), strict=False):
            q[int(model.jnt_qposadr[joint])] = value
    for joint, kind in enumerate(model.jnt_type.tolist()):
        low, high = model.jnt_range[joint].tolist()
        at = float(q[int(model.jnt_qposadr[joint])])
        if kind in (SLIDE, HINGE) and model.jnt_limited[joint] and not low <= at <= high:
            yield (
                f"the joint {names[joint]!r} starts at {at:.4g}, outside of its limits {low:.4g} to"
                f" {high:.4g}: a force of the limit moves it at once"
            )
