"""The end of a wave line that takes torque and gives the velocity an arm is to follow.

With u the wave that arrives over the line (delayed), of each joint::

    tau    = F = K_p (q_d - q) + K_d (dq_d - dq)      spring and damper pull the arm to q_d
    b dq_d = u - F                                    what the wave and the torque leave
    v      = b dq_d - F                               sent: the wave that goes back

The first two are one linear equation, solved as dq_d = (u - K_p (q_d - q) + K_d dq) / (b + K_d).
At the start q_d is where the arm is. Waves, condition and sources: ``wave_impedance``, the other
end. K_d = b matches the line: a quick change is then not reflected.

Sampled: outputs as of t_k; q_d advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; v = u - 2 F then tells the line what was given, and the port stays passive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import DAMPING, DQ, STIFFNESS, TAU_MAX, TORQUE, Q, gain, torque
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

#: As those of ``wave_impedance``.
PRESETS: dict[str, dict[str, float]] = {
    "wave(b=10)": {"b": 10.0, "K_p": 50.0, "K_d": 10.0},
    "scattering(n=3)": {"b": 9.0, "K_p": 50.0, "K_d": 9.0},
}

#: What this end sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("control.v", "control.v"),)

_ALL = ("u", "q", "dq")


def model() -> Model:
    """Declare the end of the line; the defaults are ``wave(b=10)``."""
    return Model(
        identifier="wave_admittance",
        description="End of a wave line: torque in, velocity to follow out",
        kind=_KIND,
        variables=(
            Variable("u", "input", (2,), TORQUE, description="Received wave"),
            Q,
            DQ,
            torque(_ALL, ("b", "K_d", "tau_max")),
            Variable(
                "v",
                "output",
                (2,),
                TORQUE,
                description="Wave sent: b dq_d - F",
                depends=_ALL,
                elementwise=True,
                start_depends=("b", "K_d", "tau_max"),
            ),
            Variable(
                "q_d",
                "output",
                (2,),
                "rad",
                description="Position the arm is to be at",
                depends=("q",),
                elementwise=True,
            ),
            Variable("q_d_next", "local", (2,), "rad", description="q_d of the next step"),
            gain("b", DAMPING, 10.0, "Wave impedance of the line", minimum=1e-6),
            gain("K_p", STIFFNESS, 50.0, "Stiffness towards q_d"),
            gain("K_d", DAMPING, 10.0, "Damping towards dq_d"),
            TAU_MAX,
        ),
        sources=("wave_admittance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("u", "v"), "Waves"),
        ),
        documentation=__doc__ or "",
    )


def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    from fmus.build import find

    return find(model(), version)


def kernel() -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    from fmus.kernel import Kernel

    return Kernel(model())


@final
class WaveAdmittance:
    """The end of the line in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self.initialize({})

    def initialize(self, values: Values) -> None:
        """Take the parameters. Raises ScenarioError."""
        self._x = start_values(self._model, values)
        self._x["q_d"] = self._x["q_d_next"] = np.zeros(2)

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start, where q_d is q."""
        u_, q, dq = received(self.inputs, u)
        self._x["q_d_next"] = q
        outputs, _ = self._law(0.0, [u_, q, dq], q)
        return given(outputs)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; q_d advances to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        x, inputs = self._x, received(self.inputs, u, t)
        outputs, q_d_next = self._law(h, inputs, x["q_d_next"])
        given(outputs, t)
        x["q_d"], x["q_d_next"] = outputs["q_d"], q_d_next
        return outputs

    def _law(self, h: float, inputs: list[Array], q_d: Array) -> tuple[dict[str, Array], Array]:
        """Outputs for the state q_d (2,), and the state a time h (s) later."""
        u, q, dq = inputs  # each (2,)
        x, b, K_d = self._x, self._x["b"], self._x["K_d"]
        spring = x["K_p"] * (q_d - q)
        dq_d = (u - spring + K_d * dq) / (b + K_d)
        F = np.clip(spring + K_d * (dq_d - dq), -x["tau_max"], x["tau_max"])
        return {"tau": F, "v": u - 2 * F, "q_d": q_d}, q_d + h * (u - F) / b

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
