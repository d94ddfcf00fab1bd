"""The end of a line that takes velocity and gives back torque, kept passive in the time domain.

A passivity observer counts what the line was given and what it gave, and a passivity controller
takes back by damping what it gave too much. With f_j the other end's torque and E_j the energy it
put into the line, both as received (delayed), of each joint::

    E     = sum of the work f_j dq h where that is positive     into the line; sent with dq
    E_out = sum of it where it is negative                      out of the line
    W     = max E_j - E_out + E_pc                              what it may still give
    f     = f_j + a dq,   a = min(-W / (h dq^2), a_max) if W < 0, else 0
    tau   = -f,           E_pc = sum of the work (f - f_j) dq h

max E_j is the most that has been received: energies only grow, and a packet that comes late takes
nothing back. W falls below zero only by what a_max leaves to later steps, so the line gives no more
than it was given, whatever delays and losses are: no condition on the gains of the line. E_j must
travel in the packets that f_j travels in (links of one ``channel``). The work is counted exactly:
torques are held, and dq h is the angle that was passed. v = dq is what the other end is to follow.
The other end is ``tdpa_admittance``.

Source: B. Hannaford, J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
Robotics and Automation 18(1), 2002; J.-H. Ryu, J. Artigas, C. Preusche, "A passive bilateral
control scheme for a teleoperator with time-varying communication delay", Mechatronics 20(7), 2010.

Sampled: outputs as of t_k. a_max keeps the damper within what the step allows: h a_max must be well
below the arm's inertia. Each joint's torque is limited to ±tau_max; what that changes of the work
is in E_pc.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import DAMPING, DQ, RATE, TAU_MAX, TORQUE, Q, gain, torque
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

PRESETS: dict[str, dict[str, float]] = {"TDPA": {"a_max": 20.0}, "TDPA drift": {"a_max": 20.0}}

#: What this end sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (
    ("control.v", "control.v_j"),
    ("control.E", "control.E_j"),
    ("plant.q", "control.q_j"),
)


def _inputs() -> tuple[Variable, ...]:
    return (
        Q,
        DQ,
        Variable("f_j", "input", (2,), TORQUE, description="Received torque"),
        Variable("E_j", "input", (2,), "J", description="Received energy into the line"),
    )


def _outputs() -> tuple[Variable, ...]:
    return (
        torque(("q", "dq", "f_j", "E_j"), ("tau_max",)),
        Variable(
            "v",
            "output",
            (2,),
            RATE,
            description="Velocity sent: dq",
            depends=("dq",),
            elementwise=True,
        ),
        Variable(
            "E",
            "output",
            (2,),
            "J",
            description="Energy into the line",
            depends=("q",),
            elementwise=True,
        ),
        Variable(
            "W",
            "output",
            (2,),
            "J",
            description="Energy the line may still give",
            depends=("q", "E_j"),
            elementwise=True,
        ),
        Variable("E_seen", "local", (2,), "J", description="Most of E_j received so far"),
        Variable("E_out", "local", (2,), "J", description="Energy out of the line"),
        Variable("E_pc", "local", (2,), "J", description="Energy taken by the controller"),
        Variable("q_last", "local", (2,), "rad", description="q of the step before"),
        Variable("f_last", "local", (2,), TORQUE, description="f_j of the step before"),
    )


def model() -> Model:
    """Declare the end of the line; the defaults are ``TDPA``."""
    return Model(
        identifier="tdpa_impedance",
        description="End of a line kept passive in the time domain: velocity in, torque out",
        kind=_KIND,
        variables=(
            *_inputs(),
            *_outputs(),
            gain("a_max", DAMPING, 20.0, "Most damping of the passivity controller"),
            TAU_MAX,
        ),
        sources=("tdpa_impedance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("v", "E", "f_j", "E_j"), "Flow and energy out, torque in"),
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
class TdpaImpedance:
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

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start; the count of energies begins here."""
        q, dq, f_j, E_j = received(self.inputs, u)
        limit, none = self._x["tau_max"], np.zeros(2)
        tau = np.clip(-f_j, -limit, limit)
        self._x |= {"E": none, "E_seen": E_j, "E_out": none, "E_pc": none}
        self._x |= {"tau": tau, "q_last": q, "f_last": f_j}
        return given({"tau": tau, "v": dq, "E": none, "W": E_j})

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        q, dq, f_j, E_j = received(self.inputs, u, t)  # each (2,)
        x = self._x
        passed = q - x["q_last"]
        work = x["f_last"] * passed
        E, E_out = x["E"] + np.maximum(work, 0.0), x["E_out"] - np.minimum(work, 0.0)
        E_pc = x["E_pc"] - (x["tau"] + x["f_last"]) * passed
        E_seen = np.maximum(x["E_seen"], E_j)
        W = E_seen - E_out + E_pc
        tau = np.clip(-(f_j + self._damping(W, dq, h) * dq), -x["tau_max"], x["tau_max"])
        y = given({"tau": tau, "v": dq, "E": E, "W": W}, t)
        x |= {"E": E, "E_seen": E_seen, "E_out": E_out, "E_pc": E_pc}
        x |= {"tau": tau, "q_last": q, "f_last": f_j}
        return y

    def _damping(self, W: Array, dq: Array, h: float) -> Array:
        """The passivity controller's damping, N.m.s/rad, (2,), for W (2,) J and dq (2,) rad/s."""
        owed, room, a_max = -W, h * dq * dq, self._x["a_max"]
        enough = owed < a_max * room
        a = np.where(enough, owed / np.where(enough, room, 1.0), a_max)
        return np.where(owed > 0.0, a, 0.0)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
