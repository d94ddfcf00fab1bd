"""Adaptive synchronisation of positions, for a serial arm of n joints.

The law of ``nuno_adaptive`` with the regressor of any serial arm, for k neighbours::

    tau        = Y(q, dq, -lambda e, -lambda de) theta_hat - J lambda de + g(q) - K epsilon - B de
    dtheta_hat = -Gamma Y' epsilon,   epsilon = dq + lambda e,   e = (1/k) Σ_j (q - q_j)

theta_hat (n, 10), gravity (`gravity`), rotors (`armature`) and the table are those of
``arm_teleoperation``; so are the options of a scenario. The condition is that of ``nuno_adaptive``.

Source: that of ``nuno_adaptive``.
"""

from __future__ import annotations

from fmus.arms.robot import of_robot
from fmus.arms.static_feedback import adaptive, serial_model
from fmus.build.reference import derive
from fmus.models import nuno_adaptive

model = serial_model(nuno_adaptive.declare, __doc__)
fmu, kernel, ArmNunoAdaptive = derive(
    model, *adaptive("epsilon", nuno_adaptive.feedback, serial=True)
)
prepare = of_robot(model)
