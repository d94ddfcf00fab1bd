"""Actuators of a scene: what the number that controls one means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cosim.mujoco.joints import HINGE, SLIDE
from cosim.mujoco.library import package
from cosim.mujoco.scene import ACTUATOR, Scene


@dataclass(frozen=True, slots=True)
class Actuator:
    """An actuator. `kind`: "torque", "position", "velocity" or "other", the meaning of its control.

    `gain`: torque of the joint per unit of control, of a servo the control per unit of the joint's
    value. `joint`: what it moves, -1 if that is not one hinge or slide.
    """

    index: int
    name: str
    kind: str
    unit: str
    joint: int
    gain: float


def actuators(scene: Scene) -> list[Actuator]:
    """All actuators; one without a name is called ``actuator`` with its number."""
    names = scene.names(ACTUATOR)
    return [_actuator(scene, i, name or f"actuator{i}") for i, name in enumerate(names)]


def _actuator(scene: Scene, i: int, name: str) -> Actuator:
    model, mujoco = scene.model, package()
    joint = _joint(model, mujoco, i)
    gain, gear = model.actuator_gainprm[i], float(model.actuator_gear[i][0])
    kind = _kind(model, mujoco, i)
    if joint < 0 or gear == 0.0 or float(gain[0]) == 0.0:
        return Actuator(i, name, kind if joint >= 0 else "other", "1", -1, 1.0)
    slides = int(model.jnt_type[joint]) == SLIDE
    units = {"torque": ("N", "N.m"), "position": ("m", "rad"), "velocity": ("m/s", "rad/s")}.get(
        kind, ("1", "1")
    )
    factor = float(gain[0]) * gear if kind == "torque" else gear
    return Actuator(i, name, kind, units[0 if slides else 1], joint, factor)


def _joint(model: Any, mujoco: Any, i: int) -> int:
    """The hinge or slide that an actuator moves, or -1."""
    joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    joint = int(model.actuator_trnid[i][0]) if int(model.actuator_trntype[i]) in joints else -1
    return joint if joint >= 0 and int(model.jnt_type[joint]) in (SLIDE, HINGE) else -1


def _kind(model: Any, mujoco: Any, i: int) -> str:
    """The meaning of the control, from the parameters that MJCF's shortcuts set."""
    fixed = int(model.actuator_gaintype[i]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    direct = int(model.actuator_dyntype[i]) == int(mujoco.mjtDyn.mjDYN_NONE)
    bias, parameters = int(model.actuator_biastype[i]), model.actuator_biasprm[i].tolist()
    if not fixed or not direct:
        return "other"
    if bias == int(mujoco.mjtBias.mjBIAS_NONE):
        return "torque"
    gain = float(model.actuator_gainprm[i][0])
    if bias == int(mujoco.mjtBias.mjBIAS_AFFINE) and parameters[0] == 0.0:
        if parameters[1] == -gain:
            return "position"
        if parameters[1] == 0.0 and parameters[2] == -gain:
            return "velocity"
    return "other"
