"""Ports of a scene: which inputs are added where, and where each output is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from cosim.base.component import Parameter, Port
from cosim.base.errors import MujocoError
from cosim.base.names import unknown
from cosim.mujoco import MujocoOptions
from cosim.mujoco.actuators import Actuator, actuators
from cosim.mujoco.joints import FREE, JointGroup
from cosim.mujoco.scene import BODY, SENSOR, SITE, Scene
from cosim.mujoco.sensor_units import sensor_unit


@dataclass(frozen=True, slots=True)
class InputPort:
    """An input and, for each entry, the address it is added to, and its factor."""

    port: Port
    addresses: tuple[int, ...]
    gains: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class OutputPort:
    """An output: `scale` times what is at the address of each entry.

    `derived`: a step of MuJoCo leaves the value of the step's start there.
    """

    port: Port
    addresses: tuple[int, ...]
    derived: bool = True
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class StartPort:
    """A start value: `count` entries of ``qpos`` or ``qvel`` at each index of `places`."""

    parameter: Parameter
    field: str
    places: tuple[int, ...]


def address(array: Any, index: int) -> int:
    """The address of an entry of a float64 array of MuJoCo's data."""
    return int(array.ctypes.data) + 8 * index


# ---- inputs ---------------------------------------------------------------------------------


def input_ports(scene: Scene, groups: list[JointGroup], data: Any) -> list[InputPort]:
    """Torques and references of the groups, and one input for every other actuator."""
    free = {a.index: a for a in actuators(scene)}
    found: list[InputPort] = []
    for group in groups:
        motors = [_only(free, joint, "torque") for joint in group.joints]
        found.append(_torque(scene, group, motors, data))
        found.append(_external(scene, group, data))
        for motor in motors:
            free.pop(motor.index if motor else -1, None)
        for kind, name in (("position", "q_ref"), ("velocity", "dq_ref")):
            servos = [_only(free, joint, kind) for joint in group.joints]
            if all(servos):
                taken = [free.pop(servo.index) for servo in servos if servo]
                found.append(_reference(group, name, taken, data))
    return found + [_single(actuator, data) for actuator in free.values()]


def _only(free: dict[int, Actuator], joint: int, kind: str) -> Actuator | None:
    """The actuator of a kind on a joint, if it is the only one of its kind there."""
    found = [a for a in free.values() if a.joint == joint and a.kind == kind]
    return found[0] if len(found) == 1 else None


def _torque(scene: Scene, group: JointGroup, motors: list[Actuator | None], data: Any) -> InputPort:
    places = [
        (address(data.ctrl, motor.index), 1.0 / motor.gain)
        if motor
        else (address(data.qfrc_applied, _dof(scene, joint)), 1.0)
        for motor, joint in zip(motors, group.joints, strict=True)
    ]
    port = Port(
        group.port("tau"),
        (len(places),),
        group.force_unit,
        "Torque of the motors" if all(motors) else "Torque on the joints, motors where there are",
        _held(data, [(motor.index, motor.gain) if motor else None for motor in motors]),
        not any(motors) and scene.model.nu > 0,
    )
    return InputPort(port, tuple(a for a, _ in places), tuple(g for _, g in places))


def _external(scene: Scene, group: JointGroup, data: Any) -> InputPort:
    n = len(group.joints)
    places = tuple(address(data.qfrc_applied, _dof(scene, j)) for j in group.joints)
    port = Port(
        group.port("tau_ext"), (n,), group.force_unit, "External torque fed in", optional=True
    )
    return InputPort(port, places, (1.0,) * n)


def _reference(group: JointGroup, name: str, servos: list[Actuator], data: Any) -> InputPort:
    port = Port(
        group.port(name),
        (len(servos),),
        servos[0].unit,
        f"Reference of the {servos[0].kind} servos",
        _held(data, [(servo.index, servo.gain) for servo in servos]),
    )
    places = tuple(address(data.ctrl, servo.index) for servo in servos)
    return InputPort(port, places, tuple(servo.gain for servo in servos))


def _single(actuator: Actuator, data: Any) -> InputPort:
    port = Port(
        actuator.name, (), actuator.unit, f"Actuator ({actuator.kind})",
        _held(data, [(actuator.index, 1.0)]),
    )  # fmt: skip
    return InputPort(port, (address(data.ctrl, actuator.index),), (1.0,))


def _held(data: Any, controls: Sequence[tuple[int, float] | None]) -> tuple[float, ...]:
    """The value of an input without a wire: the controls of the keyframe, over their gains."""
    found = tuple(float(data.ctrl[x[0]]) / x[1] if x else 0.0 for x in controls)
    return found if any(found) else ()


def _dof(scene: Scene, joint: int) -> int:
    return int(scene.model.jnt_dofadr[joint])


# ---- outputs --------------------------------------------------------------------------------


def output_ports(
    scene: Scene, groups: list[JointGroup], data: Any, options: MujocoOptions
) -> list[OutputPort]:
    """The outputs that the options ask for. Raises MujocoError for one that does not exist."""
    every = [
        *(port for group in groups for port in _joint_outputs(scene, group, data)),
        *_objects(scene, data),
        *_sites(scene, data),
        *_sensors(scene, data),
    ]
    names = [x.port.name for x in every]
    for pattern in options.outputs:
        if pattern != "*" and not any(fnmatchcase(name, pattern) for name in names):
            raise MujocoError(f"{scene.path}: {unknown(pattern, names, 'output')}")
    return [x for x in every if any(fnmatchcase(x.port.name, p) for p in options.outputs)]


def _joint_outputs(scene: Scene, group: JointGroup, data: Any) -> Iterator[OutputPort]:
    q = tuple(address(data.qpos, int(scene.model.jnt_qposadr[j])) for j in group.joints)
    dofs = [_dof(scene, j) for j in group.joints]
    shape = (len(q),)
    dq = tuple(address(data.qvel, i) for i in dofs)
    tau_e = tuple(address(data.qfrc_constraint, i) for i in dofs)
    yield OutputPort(Port(group.port("q"), shape, group.position_unit, "Position"), q, False)
    yield OutputPort(Port(group.port("dq"), shape, group.velocity_unit, "Velocity"), dq, False)
    yield OutputPort(
        Port(
            group.port("tau_e"),
            shape,
            group.force_unit,
            "Torque of the robot on contacts, joint limits and dry friction",
        ),
        tau_e,
        scale=-1.0,
    )


def _objects(scene: Scene, data: Any) -> Iterator[OutputPort]:
    """Position and orientation of every named body that moves freely."""
    for joint, body in _free_bodies(scene):
        at = int(scene.model.jnt_qposadr[joint])
        places = tuple(address(data.qpos, at + i) for i in range(7))
        x, quat = Port(f"x_{body}", (3,), "m", "Position"), Port(f"quat_{body}", (4,), "1")
        yield OutputPort(x, places[:3], False)
        yield OutputPort(quat, places[3:], False)


def _free_bodies(scene: Scene) -> list[tuple[int, str]]:
    names = scene.names(BODY)
    types, bodies = scene.model.jnt_type.tolist(), scene.model.jnt_bodyid.tolist()
    return [(j, names[bodies[j]]) for j, t in enumerate(types) if t == FREE and names[bodies[j]]]


def _sites(scene: Scene, data: Any) -> Iterator[OutputPort]:
    for i, name in enumerate(scene.names(SITE)):
        if name:
            places = tuple(address(data.site_xpos, 3 * i + k) for k in range(3))
            yield OutputPort(Port(f"x_{name}", (3,), "m", "Position of the site"), places)


def _sensors(scene: Scene, data: Any) -> Iterator[OutputPort]:
    for i, name in enumerate(scene.names(SENSOR)):
        at, n = int(scene.model.sensor_adr[i]), int(scene.model.sensor_dim[i])
        if name:
            kind, unit = sensor_unit(scene, i)
            port = Port(name, (n,) if n > 1 else (), unit, f"Sensor: {kind}")
            yield OutputPort(port, tuple(address(data.sensordata, at + k) for k in range(n)))


# ---- start values ---------------------------------------------------------------------------


def start_ports(scene: Scene, groups: list[JointGroup], home: Any) -> list[StartPort]:
    """Start values of the groups and of free bodies; their defaults are the state `home`."""
    model, found = scene.model, list[StartPort]()
    for group in groups:
        at = tuple(int(model.jnt_qposadr[j]) for j in group.joints)
        dofs = tuple(_dof(scene, j) for j in group.joints)
        q = Parameter(
            group.port("q"), tuple(home.qpos[list(at)].tolist()), (len(at),),
            group.position_unit, "Position at the start",
        )  # fmt: skip
        dq = Parameter(
            group.port("dq"), tuple(home.qvel[list(dofs)].tolist()), (len(at),),
            group.velocity_unit, "Velocity at the start",
        )  # fmt: skip
        found += [StartPort(q, "qpos", at), StartPort(dq, "qvel", dofs)]
    for joint, body in _free_bodies(scene):
        first = int(model.jnt_qposadr[joint])
        x, quat = tuple(range(first, first + 3)), tuple(range(first + 3, first + 7))
        found.append(StartPort(_at_start(f"x_{body}", x, "m", home), "qpos", x))
        found.append(StartPort(_at_start(f"quat_{body}", quat, "1", home), "qpos", quat))
    return found


def _at_start(name: str, places: tuple[int, ...], unit: str, home: Any) -> Parameter:
    values = tuple(home.qpos[list(places)].tolist())
    return Parameter(name, values, (len(places),), unit, "At the start")


def refuse_duplicates(scene: Scene, names: list[str]) -> None:
    """Raise MujocoError if two ports have one name."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise MujocoError(
            f"{scene.path}: two ports are called {twice[0]!r}; expected actuators, sensors and "
            "sites with other names, or joints in groups"
        )
