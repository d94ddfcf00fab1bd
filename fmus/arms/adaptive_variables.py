"""Variables of the adaptive controller, by its sizes: neighbours n, gravity or not.

:mod:`fmus.models.teleoperation` explains their meaning.
"""

from __future__ import annotations

from fmus.model import Variable

_TORQUE, _RATE, _FEEDBACK = "N.m", "rad/s", "N.m.s/rad"
#: A bound of theta_hat, a limit of the torque or an age that is none.
UNLIMITED = 1e9
#: Values of the parameter `gravity`.
NONE, COMPENSATED, ADAPTED = 0, 1, 2


def variables(neighbours: int, gravity: bool) -> tuple[Variable, ...]:
    """All variables for `neighbours` >= 0 received signals; `gravity`: two more in theta_hat."""
    return (
        *_inputs(neighbours),
        *_outputs(neighbours, gravity),
        *_next(gravity),
        *_gains(gravity),
        *(coupling_gains() if neighbours else ()),
        *_bounds(gravity),
        *(_gravity_parameters() if gravity else ()),
    )


def _inputs(n: int) -> tuple[Variable, ...]:
    return (
        Variable("q", "input", (2,), "rad", description="Joint position"),
        Variable("dq", "input", (2,), _RATE, description="Joint velocity"),
        *network_inputs(2, n),
    )


def network_inputs(joints: int, n: int, unit: str = _RATE) -> tuple[Variable, ...]:
    """The inputs of an arm of `joints` from `n` neighbours: xi_in (n, joints), w (n,), age (n,).

    `unit` is that of xi_in.
    """
    if n == 0:
        return ()
    return (
        Variable(
            *("xi_in", "input", (n, joints), unit), description="Received xi, a row a neighbour"
        ),
        Variable(
            *("w", "input", (n,), "1", 1.0, "Weight of each neighbour's edge, 0 = inactive"),
            optional=True,
        ),
        Variable(
            *("age", "input", (n,), "s", 0.0, "Age of what each neighbour sent"), optional=True
        ),
    )


def _outputs(n: int, gravity: bool) -> tuple[Variable, ...]:
    network = ("xi_in", "w", "age") if n else ()
    gains = (
        *("K", "K_off", "alpha", "lambda_M", "lambda_c", "tau_max"),
        *(("lambda", "age_max", "age_fade") if n else ()),
        *(("theta_g", "gravity") if gravity else ()),
    )
    return (
        Variable(
            "tau",
            "output",
            (2,),
            _TORQUE,
            description="Control torque",
            depends=("q", "dq", *network),
            start_depends=("z", "theta_hat", *gains),
        ),
        Variable(
            "xi",
            "output",
            (2,),
            _RATE,
            description="Signal sent: dq + alpha q",
            depends=("q", "dq"),
            elementwise=True,
            start_depends=("alpha",),
        ),
        Variable(
            "s",
            "output",
            (2,),
            _RATE,
            description="Sliding vector: dq - z",
            depends=("dq",),
            elementwise=True,
            start_depends=("z",),
        ),
        Variable(
            "z", "output", (2,), _RATE, description="State of the dynamic feedback", settable=True
        ),
        Variable(
            "theta_hat",
            "output",
            (_size(gravity),),
            _unit(gravity),
            description=_described(gravity),
            settable=True,
        ),
    )


def _next(gravity: bool) -> tuple[Variable, ...]:
    p, unit = _size(gravity), _unit(gravity)
    return (
        Variable("z_next", "local", (2,), _RATE, description="z of the next step"),
        Variable("theta_hat_next", "local", (p,), unit, description="theta_hat of the next"),
    )


def _gains(gravity: bool) -> tuple[Variable, ...]:
    p, adaptation = _size(gravity), "1" if gravity else "kg.m2.s2/rad2"
    return (
        Variable("K", "parameter", (2,), _FEEDBACK, 16.0, "Feedback gain of s", minimum=0.0),
        Variable("K_off", "parameter", (), _FEEDBACK, 0.0, "K beside its diagonal, [0, 1]"),
        Variable("Gamma", "parameter", (p,), adaptation, 1.0, "Adaptation gain", minimum=0.0),
        Variable(
            "Gamma_off",
            "parameter",
            (p * (p - 1) // 2,),
            adaptation,
            0.0,
            "Gamma right of its diagonal, row by row",
        ),
        Variable("alpha", "parameter", (), "1/s", 0.5, "Gain of q in xi", minimum=0.0),
        Variable("lambda_M", "parameter", (), "1/s", 10.0, "Manipulability gain", minimum=0.0),
        Variable(
            "lambda_c",
            "parameter",
            unit="1/s",
            description="Feedback lambda_c M_hat s in place of K s (Remark 3), 0 = off",
            minimum=0.0,
        ),
    )


def _bounds(gravity: bool) -> tuple[Variable, ...]:
    p, unit = (_size(gravity),), _unit(gravity)
    return (
        Variable("theta_min", "parameter", p, unit, -UNLIMITED, "Lower bound of theta_hat"),
        Variable("theta_max", "parameter", p, unit, UNLIMITED, "Upper bound of theta_hat"),
        Variable(
            "tau_max", "parameter", (2,), _TORQUE, UNLIMITED, "Limit of the torque", minimum=0.0
        ),
    )


def coupling_gains() -> tuple[Variable, ...]:
    """Parameters of the coupling with neighbours: lambda, 1/s; age_max and age_fade, s."""
    return (
        Variable("lambda", "parameter", (), "1/s", 2.0, "Coupling gain", minimum=0.0),
        Variable("age_max", "parameter", (), "s", UNLIMITED, "Age beyond which xi_in is stale"),
        Variable(
            "age_fade",
            "parameter",
            unit="s",
            description="Time in which the weight of a stale edge falls to 0",
            minimum=0.0,
        ),
    )


def _gravity_parameters() -> tuple[Variable, ...]:
    return (
        Variable("theta_g", "parameter", (2,), _TORQUE, 0.0, "Known gravity parameters"),
        Variable(
            "gravity",
            "parameter",
            start=1.0,
            description="Gravity: 0 none, 1 compensated from theta_g, 2 adapted in theta_hat",
            type="integer",
            minimum=0.0,
            maximum=2.0,
        ),
    )


def _size(gravity: bool) -> int:
    return 5 if gravity else 3


def _unit(gravity: bool) -> str:
    """The unit of theta_hat; inertia and gravity have no unit in common."""
    return "1" if gravity else "kg.m2"


def _described(gravity: bool) -> str:
    if gravity:
        return "Estimate: three inertia parameters in kg.m2, two of gravity in N.m"
    return "Estimate of the lumped inertia parameters"
