"""The content of a robot's file as text: the tree of its links, or the joints of an arm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fmus.arms import chain
from fmus.arms.serial import Robot
from fmus.arms.urdf import Urdf
from fmus.model.numeric import Array
from fmus.models.serial_facts import doubts

#: Positions at which torques and inertias are computed.
POSITIONS = 300


def tree(urdf: Urdf) -> Iterator[str]:
    """The links, each below the one that carries it, with joint, limits and mass (kg)."""
    root = next(name for name in urdf.links if urdf.joint_above(name) is None)
    left = [(root, 0)]
    while left:
        name, depth = left.pop()
        body, joint = urdf.links[name], urdf.joint_above(name)
        words = [f"{'  ' * depth}{name}"]
        if joint is not None:
            words.append(f"{joint.type} joint {joint.name}")
            if joint.mimics:
                words.append(f"mimics {joint.mimics}")
        if body is not None:
            words.append(f"{body.mass:.4g} kg")
        yield ", ".join(words)
        left += [(each.child, depth + 1) for each in reversed(list(urdf.joints_on(name)))]
    yield from urdf.unread


def joints(robot: Robot) -> Iterator[str]:
    """The joints from base to tip with limits, gravity torque and inertia, in rad, m, N.m and N.

    Gravity torque (the greatest) and inertia (the least of M_ii) are those of random positions
    within the limits, without rotors.
    """
    positions = sampled_positions(robot)
    still = np.zeros(robot.table.joints)
    gravity = [np.abs(chain.inverse(robot.table, q, still, still)) for q in positions]
    inertia = [np.diag(chain.mass_matrix(robot.table, q)) for q in positions]
    yield f"{robot.table.joints} joints, {robot.mass:.4g} kg beyond the base"
    columns = ("joint", "type", "lower", "upper", "effort", "velocity", "gravity", "inertia")
    rows: list[tuple[str, ...]] = [columns]
    for i, name in enumerate(robot.names):
        numbers = (
            robot.lower[i], robot.upper[i], robot.effort[i], robot.velocity[i],
            np.max(gravity, axis=0)[i], np.min(inertia, axis=0)[i],
        )  # fmt: skip
        kind = "prismatic" if robot.table.joint_type[i] else "revolute"
        rows.append((name, kind, *(f"{x:.4g}" for x in numbers)))
    widths = [max(len(row[k]) for row in rows) for k in range(len(columns))]
    for row in rows:
        yield "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
    yield from doubts(robot.table)
    yield from robot.unread


def sampled_positions(robot: Robot) -> Array:
    """Random positions (POSITIONS, n) within the limits, a turn where a joint has none."""
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    share = np.random.default_rng(0).random((POSITIONS, robot.table.joints))
    return np.asarray(low + share * (high - low))
