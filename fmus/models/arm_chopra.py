"""Adaptive synchronisation of r = dq + lambda q, for a serial arm of n joints.

The law of ``chopra`` with the regressor of any serial arm, for k neighbours::

    tau        = Y(q, dq, -lambda q, -lambda dq) theta_hat - J lambda dq + g(q) - K Σ_j (r - r_j)
    dtheta_hat = -Gamma Y' r

theta_hat (n, 10), gravity (`gravity`), rotors (`armature`) and the table are those of
``arm_teleoperation``; so are the options of a scenario. The condition is that of ``chopra``.

Source: that of ``chopra``.
"""

from __future__ import annotations

from fmus.arms.robot import of_robot
from fmus.arms.static_feedback import adaptive, serial_model
from fmus.build.reference import derive
from fmus.models import chopra

model = serial_model(chopra.declare, __doc__)
fmu, kernel, ArmChopra = derive(model, *adaptive("r", chopra.feedback, serial=True))
prepare = of_robot(model)
