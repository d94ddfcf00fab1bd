"""URDF files for tests: those of configs/robots, and small arms with mistakes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

# Mass, centre, tensor there (xx xy xz yy yz zz) of a body: link 1 of OpenArm.
BODY = (
    1.1416684646, 0.0011467658, 0.0000331999, 0.0539528438, 1.567e-3, -1e-6, -2.9e-5, 1.273e-3,
    1e-6, 1.016e-3,
)  # fmt: skip
ROBOTS = Path(__file__).parents[3] / "configs" / "robots"


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


def write(folder: Path, *parts: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text('<?xml version="1.0"?>\n<robot name="r">\n' + "\n".join(parts) + "\n</robot>")
    return path


def shipped(name: str, folder: Path) -> Path:
    """A file of configs/robots, as robot.urdf in `folder`."""
    return Path(shutil.copy(ROBOTS / name, folder / "robot.urdf"))


def openarm(folder: Path) -> Path:
    """The right arm on the body, as in the robot with two arms; the hand without fingers."""
    return shipped("openarm_right.urdf", folder)


def fr3(folder: Path) -> Path:
    return shipped("fr3.urdf", folder)


def equivalent(a: np.ndarray, b: np.ndarray, digits: float) -> bool:
    return bool(np.allclose(a, b, rtol=0, atol=digits))
