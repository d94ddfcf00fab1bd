"""The signal on the link, computed next to the robot.

Equation (47) of the paper, of each joint::

    xi = dq + alpha q

Sampled: read at t_k, held to the next step. ``teleoperation`` gives the same signal; taken from here
instead, two controllers may exchange it without delay and without a loop between them, since
this component depends on the robot only. `alpha` must be the controller's.
"""

from __future__ import annotations

from cosim.component import Kind
from fmus.model import Model, Terminal, Variable

_KIND: Kind = "sampled"


def model() -> Model:
    """Declare the signal; the default of alpha is Sec. VII-C's."""
    return Model(
        identifier="xi",
        description="Signal xi = dq + alpha q exchanged by the controllers",
        kind=_KIND,
        variables=(
            Variable("q", "input", (2,), "rad", description="Joint position"),
            Variable("dq", "input", (2,), "rad/s", description="Joint velocity"),
            Variable(
                "xi",
                "output",
                (2,),
                "rad/s",
                description="Signal sent: dq + alpha q",
                depends=("q", "dq"),
                elementwise=True,
            ),
            Variable("alpha", "parameter", (), "1/s", 0.5, "Gain of q", minimum=0.0),
        ),
        sources=("xi.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "xi"), "Motion in, signal out"),),
        documentation=__doc__ or "",
    )
