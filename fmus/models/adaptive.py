"""Adaptive controller with dynamic feedback for one arm alone, eqs (29)-(32) of the paper.

The law of :mod:`fmus.models.teleoperation` without neighbours, Theorem 2::

    dz         = -alpha dq + lambda_M (dq - z)              (29)
    s          = dq - z                                     (30)
    tau        = -K s + Y(q, dq, z, dz) theta_hat           (31)
    dtheta_hat = -Gamma Yᵀ(q, dq, z, dz) s                  (32)

with the same options and parameters, and xi = dq + alpha q for whoever listens. alpha = 0 makes the
velocity the output (Sec. IV-C): ddq = lambda_M s + ds.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from fmus.model import Model
from fmus.models import teleoperation

if TYPE_CHECKING:
    from pathlib import Path

    from fmus.build import Version
    from fmus.kernel import Kernel

#: The controller in NumPy, ``Adaptive(gravity=False)``: the readable reference of the C kernel.
Adaptive = partial(teleoperation.Teleoperation, 0)


def model(gravity: bool = False) -> Model:
    """Declare the controller; `gravity`: with two parameters of gravity in theta_hat."""
    return teleoperation.model(0, gravity)


def fmu(version: Version = "2.0", gravity: bool = False) -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    return teleoperation.fmu(version, 0, gravity)


def kernel(gravity: bool = False) -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    return teleoperation.kernel(0, gravity)
