"""Shared declarations of controllers and operators of an arm: ports, gains, and a model of them.

A model whose law treats every joint alike takes the number of joints as a size, as in
``model(joints=7)``. The laws that contain the dynamics of the planar arm have two joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.copies import replace
from cosim.base.errors import FmuError
from fmus.model import Causality, Model, Terminal, Variable

TORQUE, RATE = "N.m", "rad/s"
STIFFNESS, DAMPING = "N.m/rad", "N.m.s/rad"


@final
@dataclass(frozen=True, slots=True)
class Joints:
    """Variables of an arm of `count` joints; each has one entry a joint, shape (count,).

    Raises FmuError for a count that is not a whole number of at least 1.
    """

    count: int = 2

    def __post_init__(self) -> None:
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 1:
            raise FmuError(f"joints is {self.count!r}; expected a whole number of at least 1")

    def vector(
        self,
        name: str,
        causality: Causality,
        unit: str,
        description: str,
        start: float | tuple[float, ...] = 0.0,
        minimum: float | None = None,
        *,
        settable: bool = False,
        start_depends: tuple[str, ...] = (),
    ) -> Variable:
        """A variable of any causality in `unit`; the arguments are the fields of :class:`Variable`.

        If `start` has one value for each joint of another arm, the default is 0.
        """
        fits = not isinstance(start, tuple) or len(start) == self.count
        return Variable(
            name,
            causality,
            (self.count,),
            unit,
            start if fits else 0.0,
            description,
            settable=settable,
            minimum=minimum,
            start_depends=start_depends,
        )

    def input(self, name: str, unit: str, description: str) -> Variable:
        """An input of each joint, in `unit`."""
        return self.vector(name, "input", unit, description)

    def local(self, name: str, unit: str, description: str) -> Variable:
        """A value of each joint that the law keeps from one step to the next, in `unit`."""
        return self.vector(name, "local", unit, description)

    def gain(
        self, name: str, unit: str, start: float, description: str, minimum: float = 0.0
    ) -> Variable:
        """A gain of each joint, in `unit`."""
        return self.vector(name, "parameter", unit, description, start, minimum)

    def signal(
        self,
        name: str,
        unit: str,
        description: str,
        depends: tuple[str, ...] = (),
        start_depends: tuple[str, ...] = (),
    ) -> Variable:
        """An output with one entry per joint, which depends on the same entry of `depends`."""
        output = self.vector(name, "output", unit, description, start_depends=start_depends)
        return replace(output, depends=depends, elementwise=True)

    def torque(
        self, depends: tuple[str, ...], start_depends: tuple[str, ...], *, elementwise: bool = True
    ) -> Variable:
        """The control torque `tau`; `depends` and `start_depends` as in :class:`Variable`."""
        tau = self.signal("tau", TORQUE, "Control torque", depends, start_depends)
        return replace(tau, elementwise=elementwise)

    @property
    def q(self) -> Variable:
        """The joint position, an input."""
        return self.input("q", "rad", "Joint position")

    @property
    def dq(self) -> Variable:
        """The joint velocity, an input."""
        return self.input("dq", RATE, "Joint velocity")

    @property
    def q_j(self) -> Variable:
        """The joint position of another arm as received, an input."""
        return self.input("q_j", "rad", "Received joint position")

    @property
    def dq_j(self) -> Variable:
        """The joint velocity of another arm as received, an input."""
        return self.input("dq_j", RATE, "Received joint velocity")

    @property
    def tau_max(self) -> Variable:
        """The limit of the torque, a parameter; without limit by default."""
        return self.gain("tau_max", TORQUE, 1e9, "Limit of the torque")


#: The planar arm, and names of its variables for the laws that contain its dynamics.
PLANAR = Joints(2)
Q, DQ, Q_J, DQ_J, TAU_MAX = PLANAR.q, PLANAR.dq, PLANAR.q_j, PLANAR.dq_j, PLANAR.tau_max
gain, signal, torque = PLANAR.gain, PLANAR.signal, PLANAR.torque

THETA_HAT = Variable(
    "theta_hat",
    "output",
    (3,),
    "kg.m2",
    description="Estimate of the lumped inertia parameters",
    settable=True,
)
THETA_HAT_NEXT = Variable(
    "theta_hat_next", "local", (3,), "kg.m2", description="theta_hat of the next step"
)
GAMMA = Variable("Gamma", "parameter", (3,), "kg.m2.s2/rad2", 1.0, "Adaptation gain", minimum=0.0)


def rate(name: str, start: float, description: str) -> Variable:
    """A gain in 1/s, one for all joints."""
    return Variable(name, "parameter", (), "1/s", start, description, minimum=0.0)


NETWORK = Terminal("network", ("q_j", "dq_j"), "Motion of the other arm")


def controller(
    identifier: str,
    description: str,
    variables: tuple[Variable, ...],
    sources: tuple[str, ...],
    documentation: str | None,
    network: Terminal = NETWORK,
    joints: Joints = PLANAR,
) -> Model:
    """A sampled controller of an arm that is coupled with another arm over a `network`.

    Its inputs begin with q and dq; `sources` follow the C file with its own name.
    """
    return Model(
        identifier=identifier,
        description=description,
        kind="sampled",
        variables=(joints.q, joints.dq, *variables),
        sources=(f"{identifier}.c", *sources),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"), network),
        documentation=documentation or "",
    )
