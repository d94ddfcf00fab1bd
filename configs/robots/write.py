"""Write the URDF files of this folder from tables: ``python configs/robots/write.py``.

OpenArm 1.0 ("v10"): masses, centres of mass and tensors of links, origins, axes and limits of
joints are those of the maker's description (openarm_description, July 2025), as numbers. The left
arm mirrors the right one by the maker's rules: the y of each centre of mass changes its sign except
of link 4, products of inertia keep theirs. The fingers of the gripper are left out: their published
tensors violate the triangle inequality. The hand is fixed to link 7.

FR3: Franka's description (franka_description), without hand. The arm of six axes is nobody's: it
stands for an arm with geared motors on classic CAN.

URDF has no word for the inertia of rotors; scenarios give it as `parameters.armature`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

FOLDER = Path(__file__).parent
RIGHT_ANGLE = 1.570796326794897

# Mass, kg; centre of mass, m; tensor there, kg.m2 (xx xy xz yy yz zz); of link 1 to 7 and the hand.
OPENARM_LINKS = """
1.1416684646 0.0011467658 0.0000331999 0.0539528438 1.567e-3 -1e-6 -2.9e-5 1.273e-3 1e-6 1.016e-3
0.2775092746 0.0083962918 -2.01451e-8 0.0325664930 3.59e-4 1e-6 -1.09e-4 3.76e-4 1e-6 2.32e-4
1.0738633382 -0.0021047521 0.0005549085 0.0884747055 4.372e-3 1e-6 1.1e-5 4.319e-3 -3.6e-5 6.61e-4
0.5598534567 -0.0029006831 -0.0303057583 0.0633963742 6.23e-4 -1e-6 -1.9e-5 5.11e-4 3.8e-5 3.34e-4
0.5506588026 -0.0030496650 0.0008866902 0.0430798030 4.23e-4 -8e-6 6e-6 4.45e-4 -6e-6 3.24e-4
0.3852027732 -0.0371365870 0.0003323053 -0.0000949837 1.43e-4 1e-6 1e-6 1.57e-4 1e-6 1.59e-4
0.3859771327 0.0000687551 0.0126617525 0.0695194541 6.39e-4 1e-6 1e-6 4.97e-4 8.9e-5 3.42e-4
0.3 0 0.002 0.019 1.0e-4 1e-6 1e-6 2.5e-4 1e-6 1.7e-4
"""
# Origin, m; roll, rad; axis; lower and upper limit, rad; velocity, rad/s; effort, N.m; right arm.
OPENARM_JOINTS = """
0 0 0.0625              0   0 0 1   -1.396263  3.490659  16.754666 40
-0.0301 0 0.06    1.57079632679  -1 0 0  -0.174533  3.316125  16.754666 40
0.0301 0 0.06625        0   0 0 1   -1.570796  1.570796   5.445426 27
0 0.0315 0.15375        0   0 1 0    0         2.443461   5.445426 27
0 -0.0315 0.0955        0   0 0 1   -1.570796  1.570796  20.943946  7
0.0375 0 0.1205         0   1 0 0   -0.785398  0.785398  20.943946  7
-0.0375 0 0             0   0 1 0   -1.570796  1.570796  20.943946  7
"""
FR3_LINKS = """
2.9274653454 4.128e-7 -0.0181251324 -0.0386035970 0.0239273165 1.33179e-5 -1.140477e-4 0.0224821613 -0.0019950321 0.0063500983
2.9355370338 0.0031828864 -0.0743221644 0.0088146084 0.0419389463 2.025733e-4 0.0040777842 0.0251451489 -0.0042252158 0.0617021447
2.2449013699 0.0407015686 -0.0048200565 -0.0289730823 0.0241014255 0.0024046946 -0.0028562693 0.0197405327 -0.0021042127 0.0190444945
2.6155955791 -0.0459100965 0.0630492960 -0.0085187868 0.0345299832 0.0132255227 0.0101514300 0.0288816219 -9.762834e-4 0.0412547117
2.3271207594 -0.0016039605 0.0292536262 -0.0972965990 0.0516102785 -0.0057151734 -0.0035673168 0.0478772971 0.0106739851 0.0164236256
1.8170376524 0.0597131221 -0.0410294666 -0.0101692726 0.0054123336 0.0061934564 0.0014219289 0.0140583295 -0.0013140754 0.0160808179
0.6271432862 0.0045225817 0.0086261921 -0.0161633251 2.109239e-4 -2.433299e-5 4.564480e-5 1.771857e-4 8.744070e-5 5.993191e-5
"""  # noqa: E501
FR3_JOINTS = f"""
0 0 0.333            0              0 0 1  -2.7437  2.7437  2.62 87
0 0 0             {-RIGHT_ANGLE}  0 0 1  -1.7837  1.7837  2.62 87
0 -0.316 0        {RIGHT_ANGLE}   0 0 1  -2.9007  2.9007  2.62 87
0.0825 0 0        {RIGHT_ANGLE}   0 0 1  -3.0421 -0.1518  2.62 87
-0.0825 0.384 0   {-RIGHT_ANGLE}  0 0 1  -2.8065  2.8065  5.26 12
0 0 0             {RIGHT_ANGLE}   0 0 1   0.5445  4.5169  4.18 12
0.088 0 0         {RIGHT_ANGLE}   0 0 1  -3.0159  3.0159  5.26 12
"""
# A made-up arm of six axes: cylinders along z. Columns as above.
SIX_AXIS_LINKS = """
2.5 0 0 0.05 4.3333e-03 0 0 4.3333e-03 0 4.5000e-03
2.0 0 0 0.175 2.1429e-02 0 0 2.1429e-02 0 2.0250e-03
1.4 0 0 0.15 1.1060e-02 0 0 1.1060e-02 0 1.1200e-03
0.6 0 0 0.04 4.5500e-04 0 0 4.5500e-04 0 2.7000e-04
0.5 0 0 0.04 3.7917e-04 0 0 3.7917e-04 0 2.2500e-04
0.3 0 0 0.025 1.0938e-04 0 0 1.0938e-04 0 9.3750e-05
"""
SIX_AXIS_JOINTS = """
0 0 0.15  0  0 0 1  -3.1  3.1  3.0 60
0 0 0.10  0  0 1 0  -1.8  1.8  3.0 60
0 0 0.35  0  0 1 0  -2.6  2.6  3.0 40
0 0 0.30  0  0 1 0  -1.8  1.8  6.0 12
0 0 0.08  0  0 0 1  -3.1  3.1  6.0 12
0 0 0.08  0  0 1 0  -1.8  1.8  6.0 12
"""


def rows(text: str) -> list[list[float]]:
    """The numbers of a table."""
    return [[float(word) for word in line.split()] for line in text.strip().splitlines()]


def numbers(values: Sequence[float]) -> str:
    """Numbers as text that reads back exactly, without -0."""
    return " ".join(repr(value + 0.0) for value in values)


def link(name: str, body: Sequence[float] = ()) -> Iterator[str]:
    """A link, with its mass, centre and tensor where it has any."""
    if not body:
        yield f'  <link name="{name}"/>'
        return
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    tensor = " ".join(f'{n}="{v!r}"' for n, v in zip(names, body[4:], strict=True))
    yield f'  <link name="{name}">'
    yield "    <inertial>"
    yield f'      <origin xyz="{numbers(body[1:4])}"/>'
    yield f'      <mass value="{body[0]!r}"/>'
    yield f"      <inertia {tensor}/>"
    yield "    </inertial>"
    yield "  </link>"


def fixed(name: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0") -> Iterator[str]:
    """A joint that does not move."""
    yield f'  <joint name="{name}" type="fixed">'
    yield f'    <parent link="{parent}"/>'
    yield f'    <child link="{child}"/>'
    yield f'    <origin xyz="{xyz}" rpy="{rpy}"/>'
    yield "  </joint>"


def moving(i: int, row: Sequence[float]) -> Iterator[str]:
    """Joint i between link i - 1 and link i."""
    yield f'  <joint name="joint{i}" type="revolute">'
    yield f'    <parent link="link{i - 1}"/>'
    yield f'    <child link="link{i}"/>'
    yield f'    <origin xyz="{numbers(row[:3])}" rpy="{row[3]!r} 0 0"/>'
    yield f'    <axis xyz="{numbers(row[4:7])}"/>'
    lower, upper, velocity, effort = row[7:]
    yield f'    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}"/>'
    yield "  </joint>"


def arm(joints: Sequence[Sequence[float]], links: Sequence[Sequence[float]]) -> Iterator[str]:
    """Links link0 to linkN and joints joint1 to jointN."""
    yield from link("link0")
    for i, (row, body) in enumerate(zip(joints, links, strict=True), start=1):
        yield from link(f"link{i}", body)
        yield from moving(i, row)


def openarm(side: str) -> Iterator[str]:
    """One arm of the robot with two, on its body, with the hand: `side` is right or left."""
    joints, (*links, hand) = rows(OPENARM_JOINTS), rows(OPENARM_LINKS)
    if side == "left":
        joints[0][7:9] = (round(limit - 2.094396, 6) for limit in joints[0][7:9])
        joints[1][3] = -joints[1][3]
        joints[1][7:9] = -joints[1][8], -joints[1][7]
        joints[6][4:7] = 0.0, -1.0, 0.0
        for i, body in enumerate(links, start=1):
            body[2] = body[2] if i == 4 else -body[2]
        hand[2] = -hand[2]
    sign = -1 if side == "right" else 1
    yield from link("body")
    yield from fixed("mount", "body", "link0", f"0 {sign * 0.031} 0.698", f"{-sign * 1.5708} 0 0")
    yield from arm(joints, links)
    yield from link("hand", hand)
    yield from fixed("wrist", "link7", "hand", "1e-6 -0.0045 0.1001")
    yield from link("tcp")
    yield from fixed("tool", "hand", "tcp", "0 0 0.08")


def document(name: str, lines: Iterator[str]) -> str:
    """The file."""
    head = '<?xml version="1.0"?>\n<!-- Written by configs/robots/write.py. -->\n'
    return head + "\n".join([f'<robot name="{name}">', *lines, "</robot>", ""])


def documents() -> dict[str, str]:
    """Name and text of each file."""
    return {
        "openarm_right.urdf": document("openarm_right", openarm("right")),
        "openarm_left.urdf": document("openarm_left", openarm("left")),
        "fr3.urdf": document("fr3", arm(rows(FR3_JOINTS), rows(FR3_LINKS))),
        "six_axis.urdf": document("six_axis", arm(rows(SIX_AXIS_JOINTS), rows(SIX_AXIS_LINKS))),
    }


if __name__ == "__main__":
    for name, text in documents().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
