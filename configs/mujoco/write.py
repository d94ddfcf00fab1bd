"""Write ``openarm.xml`` from the arm's URDF: ``python configs/mujoco/write.py``.

The numbers of joints and links are copied; what URDF has no word for is added here: inertia of the
rotors, friction of the joints, motors, the shapes that touch something, and the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

FOLDER = Path(__file__).parent
URDF = FOLDER.parent / "robots" / "openarm_right.urdf"
#: By joint: rotor inertia times gear ratio squared, kg.m2 (DM8009, DM4340, DM4310), and viscous
#: friction, N.m.s/rad: those of configs/openarm.toml.
ARMATURE = (0.0158, 0.0158, 0.032, 0.032, 0.0018, 0.0018, 0.0018)
DAMPING = (0.063, 0.063, 0.604, 0.813, 0.029, 0.072, 0.084)

HEAD = """\
<!-- Written by configs/mujoco/write.py: the right arm of OpenArm 1.0 above a table. -->
<mujoco model="openarm">
  <compiler angle="radian" eulerseq="XYZ"/>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="touching">
      <geom contype="1" conaffinity="1" condim="3" friction="0.5" solref="0.05 1"/>
    </default>
  </default>
  <worldbody>
    <light pos="1 -1 2" dir="-1 1 -2"/>
    <geom name="table" class="touching" type="box" pos="0.4 -0.25 0.28" size="0.25 0.3 0.02"/>
"""
FOOT = """\
  </worldbody>
  <actuator>
{motors}
  </actuator>
  <sensor>
    <contact name="table_force" geom1="finger" geom2="table" data="force" reduce="netforce"/>
  </sensor>
</mujoco>
"""


def write() -> str:
    """The scene as text."""
    robot = ElementTree.parse(URDF).getroot()
    limits = {j.get("name"): j.find("limit") for j in robot.iter("joint")}
    moving = [name for name, limit in limits.items() if limit is not None]
    motors = [
        f'    <motor name="motor{i}" joint="{name}" ctrlrange="-{effort} {effort}"/>'
        for i, name in enumerate(moving, start=1)
        for effort in (_attribute(limits[name], "effort"),)
    ]
    body = "\n".join(_link(robot, "body", 4, moving))
    return HEAD + body + "\n" + FOOT.format(motors="\n".join(motors))


def _link(
    robot: ElementTree.Element, name: str, indent: int, moving: list[str | None]
) -> Iterator[str]:
    """A link with its inertia and shape, and what hangs on it."""
    space = " " * indent
    link = next(x for x in robot.iter("link") if x.get("name") == name)
    inertial = link.find("inertial")
    if inertial is not None:
        yield space + _inertial(inertial)
    if name == "tcp":
        yield f'{space}<geom name="finger" class="touching" type="sphere" size="0.02" mass="0"/>'
        yield f'{space}<site name="tcp" size="0.005"/>'
    for joint in robot.iter("joint"):
        if _attribute(joint.find("parent"), "link") != name:
            continue
        child, origin = _attribute(joint.find("child"), "link"), joint.find("origin")
        xyz, rpy = _attribute(origin, "xyz"), _attribute(origin, "rpy")
        if inertial is not None and any(abs(float(x)) > 1e-3 for x in xyz.split()):
            yield f'{space}<geom type="capsule" fromto="0 0 0 {xyz}" size="0.03"/>'
        yield f'{space}<body name="{child}" pos="{xyz}" euler="{rpy}">'
        limit = joint.find("limit")
        if limit is not None:
            at, axis = moving.index(joint.get("name")), _attribute(joint.find("axis"), "xyz")
            yield (
                f'{space}  <joint name="{joint.get("name")}" axis="{axis}"'
                f' range="{limit.get("lower")} {limit.get("upper")}" armature="{ARMATURE[at]}"'
                f' damping="{DAMPING[at]}"/>'
            )
        yield from _link(robot, child, indent + 2, moving)
        yield f"{space}</body>"


def _inertial(inertial: ElementTree.Element) -> str:
    tensor = inertial.find("inertia")
    entries = " ".join(_attribute(tensor, n) for n in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return (
        f'<inertial pos="{_attribute(inertial.find("origin"), "xyz")}"'
        f' mass="{_attribute(inertial.find("mass"), "value")}" fullinertia="{entries}"/>'
    )


def _attribute(element: ElementTree.Element | None, name: str) -> str:
    assert element is not None
    return element.attrib[name]


if __name__ == "__main__":
    (FOLDER / "openarm.xml").write_text(write(), encoding="utf-8")
