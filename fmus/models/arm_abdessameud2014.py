"""Adaptive consensus with a filter of second order as reference, for a serial arm of n joints.

The law of ``abdessameud2014`` with the regressor of any serial arm, for k neighbours::

    tau        = Y(q, dq, z, dz) theta_hat + J dz + g(q) - K s
    dtheta_hat = -Gamma Y' s,   s = dq - z,   dz = -k_d z - (k_p/k) Σ_j (q - q_j)

theta_hat (n, 10), gravity (`gravity`), rotors (`armature`) and the table are those of
``arm_teleoperation``; so are the options of a scenario. The condition is that of
``abdessameud2014``.

Source: that of ``abdessameud2014``.
"""

from __future__ import annotations

from fmus.arms.robot import of_robot
from fmus.arms.static_feedback import adaptive, serial_model
from fmus.build.reference import derive
from fmus.models import abdessameud2014

model = serial_model(abdessameud2014.declare, __doc__)
fmu, kernel, ArmAbdessameud2014 = derive(
    model, *adaptive("s", abdessameud2014.feedback, dynamic=True, serial=True)
)
prepare = of_robot(model)
