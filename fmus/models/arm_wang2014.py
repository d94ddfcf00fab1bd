"""Adaptive consensus with static feedback, for a serial arm of n joints.

The law of ``wang2014`` with the regressor of any serial arm, for k neighbours::

    tau        = Y(q, dq, z, dz) theta_hat + J dz + g(q) - K s
    dtheta_hat = -Gamma Y' s,   s = dq - z,   z = -lambda Σ_j (q - q_j)

theta_hat (n, 10), gravity (`gravity`), rotors (`armature`) and the table are those of
``arm_teleoperation``; so are the options of a scenario. The condition is that of ``wang2014``.

Source: that of ``wang2014``.
"""

from __future__ import annotations

from fmus.arms.robot import of_robot
from fmus.arms.static_feedback import adaptive, serial_model
from fmus.build.reference import derive
from fmus.models import wang2014

model = serial_model(wang2014.declare, __doc__)
fmu, kernel, ArmWang2014 = derive(model, *adaptive("s", wang2014.feedback, serial=True))
prepare = of_robot(model)
