"""The end of a line that takes torque and gives motion to follow, kept passive in the time domain.

With v_j the other end's velocity, E_j the energy it put into the line and q_j its position, all as
received (delayed), of each joint::

    w     = v_j + k_c (q_j - q_d)                         what the line wants
    tau   = f = K_p (q_d - q) + K_d (dq_d - dq)           spring and damper pull the arm to q_d
    dq_d  = w - B f                                       what the passivity controller lets through

    E     = sum of the work f w h where that is negative  into the line; sent with f
    E_out = sum of it where it is positive                out of the line
    E_pc  = sum of B f^2 h                                taken by the passivity controller
    W     = E_0 + max E_j - E_out + E_pc                  what the line may still give

B is the least B >= 0 with h f dq_d <= W in the step ahead, or that with the least f dq_d where none
is enough. f depends on dq_d: with a = K_p (q_d - q) - K_d dq the work is f dq_d = f (f - a) / K_d,
and f is found between 0 and what w alone would give. The line gives no more than it was given, and
E_0, whatever delays and losses are; ``tdpa_impedance``, the other end, says more, and has the
sources. E_0 is what the line holds at the start: without any, no torque is given that the other end
could put energy in against, and nothing ever moves.

What the passivity controller takes from dq_d is lost as position (drift). With k_c > 0 the line
wants the position back too, as fast as the energy in it allows: the compensation of J. Artigas,
J.-H. Ryu, C. Preusche, "Position drift compensation in time domain passivity based teleoperation",
IROS 2010, put inside of the observed port. k_c = 0 is the plain scheme, and q_j is not used.

Sampled: outputs as of t_k; q_d, which is q at the start, and the energies advance to t_k + h. Each
joint's torque is limited to ±tau_max, by means of dq_d: q_d does not run away from an arm that
cannot follow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import (
    DAMPING,
    DQ,
    Q_J,
    RATE,
    STIFFNESS,
    TAU_MAX,
    TORQUE,
    Q,
    gain,
    rate,
    torque,
)
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

#: As those of ``tdpa_impedance``; ``TDPA drift`` with compensation.
PRESETS: dict[str, dict[str, float]] = {
    "TDPA": {"K_p": 50.0, "K_d": 10.0, "E_0": 5.0, "k_c": 0.0},
    "TDPA drift": {"K_p": 50.0, "K_d": 10.0, "E_0": 5.0, "k_c": 1.0},
}

#: What this end sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("control.f", "control.f_j"), ("control.E", "control.E_j"))

_ALL = ("q", "dq", "v_j", "E_j", "q_j")


def _inputs() -> tuple[Variable, ...]:
    return (
        Q,
        DQ,
        Variable("v_j", "input", (2,), RATE, description="Received velocity"),
        Variable("E_j", "input", (2,), "J", description="Received energy into the line"),
        Q_J,
    )


def _outputs() -> tuple[Variable, ...]:
    return (
        torque(_ALL, ()),
        Variable(
            "f",
            "output",
            (2,),
            TORQUE,
            description="Torque sent: tau",
            depends=_ALL,
            elementwise=True,
        ),
        Variable("E", "output", (2,), "J", description="Energy into the line"),
        Variable(
            "W",
            "output",
            (2,),
            "J",
            description="Energy the line may still give",
            depends=("E_j",),
            elementwise=True,
            start_depends=("E_0",),
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
        Variable("E_next", "local", (2,), "J", description="E of the next step"),
        Variable("E_seen", "local", (2,), "J", description="Most of E_j received so far"),
        Variable("E_out", "local", (2,), "J", description="Energy out of the line"),
        Variable("E_pc", "local", (2,), "J", description="Energy taken by the controller"),
    )


def model() -> Model:
    """Declare the end of the line; the defaults are ``TDPA``."""
    return Model(
        identifier="tdpa_admittance",
        description="End of a line kept passive in the time domain: torque in, motion out",
        kind=_KIND,
        variables=(
            *_inputs(),
            *_outputs(),
            gain("K_p", STIFFNESS, 50.0, "Stiffness towards q_d"),
            gain("K_d", DAMPING, 10.0, "Damping towards dq_d", minimum=1e-6),
            gain("E_0", "J", 5.0, "Energy in the line at the start"),
            rate("k_c", 0.0, "Gain of the drift compensation"),
            TAU_MAX,
        ),
        sources=("tdpa_admittance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("f", "E", "v_j", "E_j", "q_j"), "Torque and energy out, flow in"),
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
class TdpaAdmittance:
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
        """Outputs at the start, where q_d is q; the count of energies begins here."""
        q, _, _, E_j, _ = received(self.inputs, u)
        none = np.zeros(2)
        self._x |= {"q_d": q, "E": none, "E_seen": E_j, "E_out": none, "E_pc": none}
        return {"tau": none, "f": none, "E": none, "W": self._x["E_0"] + E_j, "q_d": q}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; q_d and the energies advance to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        x = self._x  # of the state: as of t, until the last line
        q, dq, v_j, E_j, q_j = received(self.inputs, u, t)  # each (2,)
        w = v_j + x["k_c"] * (q_j - x["q_d"])
        a = x["K_p"] * (x["q_d"] - q) - x["K_d"] * dq
        E_seen = np.maximum(x["E_seen"], E_j)
        W = x["E_0"] + E_seen - x["E_out"] + x["E_pc"]
        f = self._affordable(a + x["K_d"] * w, a, x["K_d"] * W / h)
        dq_d = (f - a) / x["K_d"]
        out = h * f * w
        y = given({"tau": f, "f": f, "E": x["E"], "W": W, "q_d": x["q_d"]}, t)
        x |= {
            "q_d": x["q_d"] + h * dq_d,
            "E": x["E"] + np.maximum(-out, 0.0),
            "E_seen": E_seen,
            "E_out": x["E_out"] + np.maximum(out, 0.0),
            "E_pc": x["E_pc"] + h * f * (w - dq_d),
        }
        return y

    def _affordable(self, wanted: Array, a: Array, room: Array) -> Array:
        """F from 0 to `wanted`, limited, with f (f - a) <= `room`, or the least f (f - a); (2,)."""
        sign = np.where(wanted < 0, -1.0, 1.0)
        most, a = np.minimum(sign * wanted, self._x["tau_max"]), sign * a
        f = a / 2 + np.sqrt(np.maximum(a * a / 4 + room, 0.0))
        return sign * np.where(most * (most - a) <= room, most, np.clip(f, 0.0, most))

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
