"""Adaptive controller with dynamic feedback for one arm alone, eqs (29)-(32) of the paper.

The law of :mod:`fmus.models.teleoperation` without neighbours, Theorem 2::

    dz         = -alpha dq + lambda_M (dq - z)              (29)
    s          = dq - z                                     (30)
    tau        = -K s + Y(q, dq, z, dz) theta_hat           (31)
    dtheta_hat = -Gamma Yᵀ(q, dq, z, dz) s                  (32)

with the same options and parameters. Other components can use the output xi = dq + alpha q. With
alpha = 0 the velocity is the output (Sec. IV-C): ddq = lambda_M s + ds.

Source: the paper, eqs (29)-(32), Theorem 2, Sec. IV-C.
"""

from __future__ import annotations

from fmus.build.reference import derive
from fmus.model import Model
from fmus.models import teleoperation
from fmus.models.teleoperation import law, start


def model(gravity: bool = False) -> Model:
    """Declare the controller; `gravity`: with two parameters of gravity in theta_hat."""
    return teleoperation.model(0, gravity)


fmu, kernel, Adaptive = derive(model, law, start)
