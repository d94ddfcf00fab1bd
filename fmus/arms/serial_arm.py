"""The common part of adaptive laws of a serial arm: variables of the estimate, and the torque.

theta_hat has the ten inertial parameters of each link, in the order of ``chain``. A law asks for
the torque of a motion with the reference velocity z and its derivative dz::

    Y(q, dq, z, dz) theta_hat + J dz + g(q)

Y is the regressor of ``chain_law`` and J the inertia of the rotors (`armature`), which is known.
The parameter `gravity` says whether there is none (0), g(q) is known by the inertia of the table
(1), or Y contains gravity, so that theta_hat adapts it (2).
"""

from __future__ import annotations

from fmus.arms import chain
from fmus.arms.adaptive_variables import ADAPTED, COMPENSATED
from fmus.arms.chain_law import regressor
from fmus.arms.joints import Joints
from fmus.build.reference import Values
from fmus.model import Variable
from fmus.model.numeric import Array, np

#: The C files of an arm with a table, besides those of a law.
SOURCES: tuple[str, ...] = ("chain.h", "chain_check.h", "chain_law.h", "limit.h", "trig.c")
#: Gains of adaptation by default: for m, m c and I of a link.
_GAMMA = (1.0, *(0.1,) * 3, *(0.01,) * 6)


def estimate(arm: Joints) -> tuple[Variable, Variable]:
    """theta_hat and the one of the next step, (n, 10)."""
    size = (arm.count, 10)
    return (
        Variable(
            *("theta_hat", "output", size, "1"),
            description="Estimate of the parameters of each link",
            settable=True,
        ),
        Variable("theta_hat_next", "local", size, "1", description="theta_hat of the next step"),
    )


def adaptation(arm: Joints) -> Variable:
    """Gamma (n, 10)."""
    size, start = (arm.count, 10), _GAMMA * arm.count
    return Variable("Gamma", "parameter", size, "1", start, "Adaptation gain", minimum=0.0)


def gravity() -> Variable:
    """The parameter `gravity`: 0, 1 or 2."""
    return Variable(
        "gravity",
        "parameter",
        start=float(COMPENSATED),
        description="Gravity: 0 none, 1 compensated by the table, 2 adapted in theta_hat",
        type="integer",
        minimum=0.0,
        maximum=2.0,
    )


def linear(x: Values, q: Array, dq: Array, z: Array, dz: Array) -> tuple[Array, Array]:
    """Y (n, 10 n), and the part of the torque (n,), N.m, that does not depend on theta_hat.

    `q`, `dq`, `z`, `dz` (n,) rad, rad/s, rad/s, rad/s2.
    """
    table = chain.of_values(x)
    g = table.g if x["gravity"] == ADAPTED else np.zeros(3)
    Y = regressor(table, q, dq, z, dz, g).reshape(len(q), -1)
    known = table.armature * dz
    if x["gravity"] == COMPENSATED:
        still = np.zeros_like(q)
        known = known + chain.inverse(table, q, still, still)
    return Y, known
