"""The unit of each kind of sensor of MJCF."""

from __future__ import annotations

from cosim.mujoco.joints import SLIDE
from cosim.mujoco.library import package
from cosim.mujoco.scene import Scene

#: By MuJoCo's word (``mjSENS_``); kinds that measure several things, or pixels, have no unit.
UNITS = {
    "TOUCH": "N", "ACCELEROMETER": "m/s2", "VELOCIMETER": "m/s", "GYRO": "rad/s", "FORCE": "N",
    "TORQUE": "N.m", "RANGEFINDER": "m", "TENDONPOS": "m", "TENDONVEL": "m/s",
    "TENDONACTFRC": "N", "BALLANGVEL": "rad/s", "TENDONLIMITPOS": "m", "TENDONLIMITVEL": "m/s",
    "TENDONLIMITFRC": "N", "FRAMEPOS": "m", "FRAMELINVEL": "m/s", "FRAMEANGVEL": "rad/s",
    "FRAMELINACC": "m/s2", "FRAMEANGACC": "rad/s2", "SUBTREECOM": "m", "SUBTREELINVEL": "m/s",
    "SUBTREEANGMOM": "kg.m2/s", "GEOMDIST": "m", "GEOMFROMTO": "m", "E_POTENTIAL": "J",
    "E_KINETIC": "J", "CLOCK": "s",
}  # fmt: skip
#: Kinds of a joint: (unit for a slide, for a hinge).
JOINT_UNITS = {
    "JOINTPOS": ("m", "rad"), "JOINTVEL": ("m/s", "rad/s"), "JOINTACTFRC": ("N", "N.m"),
    "JOINTLIMITPOS": ("m", "rad"), "JOINTLIMITVEL": ("m/s", "rad/s"),
    "JOINTLIMITFRC": ("N", "N.m"),
}  # fmt: skip
#: The same of an actuator that moves one joint.
ACTUATOR_UNITS = {
    "ACTUATORPOS": ("m", "rad"),
    "ACTUATORVEL": ("m/s", "rad/s"),
    "ACTUATORFRC": ("N", "N.m"),
}

#: The data of a contact sensor, where it has one of them.
CONTACT_UNITS = {
    "FORCE": "N",
    "TORQUE": "N.m",
    "DIST": "m",
    "POS": "m",
    "LINVEL": "m/s",
    "ANGVEL": "rad/s",
}


def sensor_unit(scene: Scene, index: int) -> tuple[str, str]:
    """(kind in lower case, unit) of a sensor; "1" where the kind has no single unit."""
    mujoco, model = package(), scene.model
    kind = str(mujoco.mjtSensor(int(model.sensor_type[index])).name).removeprefix("mjSENS_")
    object_ = int(model.sensor_objid[index])
    if kind == "CONTACT":
        return "contact", _contact_unit(int(model.sensor_intprm[index][0]))
    if kind in ACTUATOR_UNITS:
        joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        if int(model.actuator_trntype[object_]) not in joints:
            return kind.lower(), "1"
        object_ = int(model.actuator_trnid[object_][0])
    pairs = JOINT_UNITS | ACTUATOR_UNITS
    if kind in pairs:
        slide, hinge = pairs[kind]
        return kind.lower(), slide if int(model.jnt_type[object_]) == SLIDE else hinge
    return kind.lower(), UNITS.get(kind, "1")


def _contact_unit(fields: int) -> str:
    """The unit of a contact sensor, whose data are bits."""
    for name, unit in CONTACT_UNITS.items():
        if fields == 1 << int(getattr(package().mjtConDataField, f"mjCONDATA_{name}")):
            return unit
    return "1"
