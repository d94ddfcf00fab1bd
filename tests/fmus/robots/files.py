"""URDF files for tests, written from tables: OpenArm, the FR3, and small arms with mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fmus.chains import FR3_LINKS

# OpenArm 1.0 of openarm_description: mass, centre, tensor there (xx xy xz yy yz zz), hand last.
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
# Origin, roll, axis, lower, upper, velocity, effort of the right arm's joints.
OPENARM_JOINTS = """
0 0 0.0625              0   0 0 1   -1.396263  3.490659  16.754666 40
-0.0301 0 0.06    1.57079632679  -1 0 0  -0.174533  3.316125  16.754666 40
0.0301 0 0.06625        0   0 0 1   -1.570796  1.570796   5.445426 27
0 0.0315 0.15375        0   0 1 0    0         2.443461   5.445426 27
0 -0.0315 0.0955        0   0 0 1   -1.570796  1.570796  20.943946  7
0.0375 0 0.1205         0   1 0 0   -0.785398  0.785398  20.943946  7
-0.0375 0 0             0   0 1 0   -1.570796  1.570796  20.943946  7
"""
FR3_JOINTS = """
0 0 0.333          0           0 0 1  -2.7437  2.7437  2.62 87
0 0 0       -1.570796326794897 0 0 1  -1.7837  1.7837  2.62 87
0 -0.316 0   1.570796326794897 0 0 1  -2.9007  2.9007  2.62 87
0.0825 0 0   1.570796326794897 0 0 1  -3.0421 -0.1518  2.62 87
-0.0825 0.384 0 -1.570796326794897 0 0 1 -2.8065 2.8065 5.26 12
0 0 0        1.570796326794897 0 0 1   0.5445  4.5169  4.18 12
0.088 0 0    1.570796326794897 0 0 1  -3.0159  3.0159  5.26 12
"""


def rows(text: str) -> list[list[float]]:
    return [[float(word) for word in line.split()] for line in text.strip().splitlines()]


def inertial(values: list[float]) -> str:
    mass, x, y, z, *tensor = values
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    said = " ".join(f'{name}="{value!r}"' for name, value in zip(names, tensor, strict=True))
    return (
        f'<inertial><origin xyz="{x!r} {y!r} {z!r}"/><mass value="{mass!r}"/>'
        f"<inertia {said}/></inertial>"
    )


def link(name: str, values: list[float] | None = None) -> str:
    return f'<link name="{name}">{inertial(values) if values else ""}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def moving(name: str, parent: str, child: str, row: list[float]) -> str:
    x, y, z, roll, *axis, lower, upper, velocity, effort = row
    return joint(
        name, "revolute", parent, child,
        f'<origin xyz="{x!r} {y!r} {z!r}" rpy="{roll!r} 0 0"/>'
        f'<axis xyz="{" ".join(map(repr, axis))}"/>'
        f'<limit lower="{lower!r}" upper="{upper!r}" velocity="{velocity!r}" effort="{effort!r}"/>',
    )  # fmt: skip


def arm_of(joints: str, links: str) -> list[str]:
    """Links link0 to linkN and joints joint1 to jointN."""
    parts = [link("link0")]
    for i, (j, body) in enumerate(zip(rows(joints), rows(links), strict=False), start=1):
        parts += [link(f"link{i}", body), moving(f"joint{i}", f"link{i - 1}", f"link{i}", j)]
    return parts


def write(folder: Path, *parts: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text('<?xml version="1.0"?>\n<robot name="r">\n' + "\n".join(parts) + "\n</robot>")
    return path


def openarm(folder: Path) -> Path:
    """The right arm on the body, as in the robot with two arms; the hand without fingers."""
    return write(
        folder,
        link("body"),
        joint("mount", "fixed", "body", "link0",
              '<origin xyz="0 -0.031 0.698" rpy="1.5708 0 0"/>'),
        *arm_of(OPENARM_JOINTS, OPENARM_LINKS),
        link("hand", rows(OPENARM_LINKS)[7]),
        joint("wrist", "fixed", "link7", "hand", '<origin xyz="1e-6 -0.0045 0.1001"/>'),
        link("tcp"),
        joint("tool", "fixed", "hand", "tcp", '<origin xyz="0 0 0.08"/>'),
    )  # fmt: skip


def fr3(folder: Path) -> Path:
    return write(folder, *arm_of(FR3_JOINTS, FR3_LINKS))


def equivalent(a: np.ndarray, b: np.ndarray, digits: float) -> bool:
    return bool(np.allclose(a, b, rtol=0, atol=digits))
