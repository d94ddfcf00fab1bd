"""Shared declarations of the controllers of a planar arm: ports, gains, and a model of them."""

from __future__ import annotations

from dataclasses import replace

from fmus.model import Model, Terminal, Variable

TORQUE, RATE = "N.m", "rad/s"
STIFFNESS, DAMPING = "N.m/rad", "N.m.s/rad"

Q = Variable("q", "input", (2,), "rad", description="Joint position")
DQ = Variable("dq", "input", (2,), RATE, description="Joint velocity")
Q_J = Variable("q_j", "input", (2,), "rad", description="Received joint position")
DQ_J = Variable("dq_j", "input", (2,), RATE, description="Received joint velocity")
TAU_MAX = Variable("tau_max", "parameter", (2,), TORQUE, 1e9, "Limit of the torque", minimum=0.0)

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


def gain(name: str, unit: str, start: float, description: str, minimum: float = 0.0) -> Variable:
    """A gain of each joint, (2,), in `unit`."""
    return Variable(name, "parameter", (2,), unit, start, description, minimum=minimum)


def rate(name: str, start: float, description: str) -> Variable:
    """A gain in 1/s, one for all joints."""
    return Variable(name, "parameter", (), "1/s", start, description, minimum=0.0)


def torque(
    depends: tuple[str, ...],
    start_depends: tuple[str, ...],
    *,
    elementwise: bool = True,
) -> Variable:
    """The control torque `tau`, (2,); `depends` and `start_depends` as in :class:`Variable`."""
    tau = signal("tau", TORQUE, "Control torque", depends, start_depends)
    return replace(tau, elementwise=elementwise)


def signal(
    name: str,
    unit: str,
    description: str,
    depends: tuple[str, ...] = (),
    start_depends: tuple[str, ...] = (),
) -> Variable:
    """An output of each joint, (2,); of what it `depends` on, an entry on that of its joint."""
    return Variable(
        name,
        "output",
        (2,),
        unit,
        description=description,
        depends=depends,
        elementwise=True,
        start_depends=start_depends,
    )


#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("plant.q", "control.q_j"), ("plant.dq", "control.dq_j"))
NETWORK = Terminal("network", ("q_j", "dq_j"), "Motion of the other arm")


def controller(
    identifier: str,
    description: str,
    variables: tuple[Variable, ...],
    sources: tuple[str, ...],
    documentation: str | None,
    network: Terminal = NETWORK,
) -> Model:
    """A sampled controller of a planar arm that is coupled with another arm over a `network`.

    Its inputs begin with q and dq; `sources` come after the C file of its own name.
    """
    return Model(
        identifier=identifier,
        description=description,
        kind="sampled",
        variables=(Q, DQ, *variables),
        sources=(f"{identifier}.c", *sources),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"), network),
        documentation=documentation or "",
    )
