"""Rigid bodies: ten inertial parameters that can be turned, moved and added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.errors import ScenarioError
from fmus.arms.chain import ROUNDING, unphysical
from fmus.model.numeric import Array


def from_rpy(angles: Array) -> Array:
    """The rotation, (3, 3), about the fixed axes x, y, z in this order; `angles` (3,) rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def symmetric(entries: Sequence[float]) -> Array:
    """A symmetric matrix (3, 3) of xx, xy, xz, yy, yz, zz, in their unit."""
    xx, xy, xz, yy, yz, zz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@final
@dataclass(frozen=True, slots=True)
class Placement:
    """p_outer = R p + r; R (3, 3), r (3,) m."""

    R: Array
    r: Array

    def __matmul__(self, inner: Placement) -> Placement:
        return Placement(self.R @ inner.R, self.R @ inner.r + self.r)


@final
@dataclass(frozen=True, slots=True)
class RigidBody:
    """Mass (kg), mass times centre (3,) kg.m, and tensor (3, 3) kg.m2 about the frame's origin."""

    mass: float
    moment: Array
    tensor: Array

    @classmethod
    def nothing(cls) -> RigidBody:
        """A body without mass."""
        return cls(0.0, np.zeros(3), np.zeros((3, 3)))

    @classmethod
    def about_centre(cls, mass: float, tensor: Array, frame: Placement) -> RigidBody:
        """A body whose `tensor`, (3, 3) kg.m2, is given in a frame at its centre; `mass` kg."""
        return cls(mass, np.zeros(3), tensor).moved(frame)

    def moved(self, frame: Placement) -> RigidBody:
        """The same body in the frame outside of `frame`, in which it is given now."""
        R, r, m = frame.R, frame.r, self.mass
        moment = R @ self.moment
        both = np.outer(r, moment)
        arms = m * np.outer(r, r) + both + both.T
        shift = np.trace(arms) * np.eye(3) - arms  # Steiner's theorem, also off the centre
        return RigidBody(m, moment + m * r, R @ self.tensor @ R.T + shift)

    def __add__(self, other: RigidBody) -> RigidBody:
        return RigidBody(
            self.mass + other.mass, self.moment + other.moment, self.tensor + other.tensor
        )

    def parameters(self) -> Array:
        """m, m c (x y z) and I (xx xy yy xz yz zz), (10,) in kg, kg.m and kg.m2."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.tensor
        return np.array([self.mass, *self.moment, xx, xy, yy, xz, yz, zz])

    def check(self, place: str) -> None:
        """Raise ScenarioError at `place` unless mass and inertia are positive, or all of them 0."""
        if not self.parameters().any():
            return
        if not self.mass > 0.0:
            raise ScenarioError(f"the mass is {self.mass:g} kg, expected more than 0", place)
        if (why := unphysical(self.parameters())) is not None:
            raise ScenarioError(why, place)
        c = self.moment / self.mass
        about_centre = self.tensor - self.mass * (c @ c * np.eye(3) - np.outer(c, c))
        smallest = np.linalg.eigvalsh(about_centre)[0]
        if smallest <= ROUNDING * np.trace(self.tensor):
            raise ScenarioError(
                f"the smallest principal moment about the centre of mass is {smallest:.4g} kg.m2,"
                " expected more than 0",
                place,
            )
