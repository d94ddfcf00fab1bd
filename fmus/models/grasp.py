"""When a hand holds the arm and when not: a signal of 0 and 1 that changes at up to eight times::

    grip = 1 (or 0 if `released`) before all times; at each time it changes

For events of release and grasp: wired to a grip it takes the hand from the arm and puts it back.
Times that come to the same instant undo each other in pairs; those far off never come.

Sampled: the signal of t_k holds to the next step; a step that begins less than a millionth of its
length before a time counts as beginning then. The output at the start is that of t = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.start import copied, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

_NEVER = 1e9  # s


def model() -> Model:
    """Declare the signal; by default the hand holds on for ever."""
    return Model(
        identifier="grasp",
        description="Times at which a hand releases and grasps the arm",
        kind=_KIND,
        variables=(
            Variable(
                "grip",
                "output",
                description="1 while the hand holds the arm, 0 otherwise",
                start_depends=("released",),
            ),
            Variable(
                "released",
                "parameter",
                start=0.0,
                description="1: the hand is off the arm at the start",
                type="integer",
                minimum=0.0,
                maximum=1.0,
            ),
            Variable("times", "parameter", (8,), "s", _NEVER, "Times of change", minimum=1e-9),
        ),
        sources=("grasp.c", "schedule.h"),
        step=5e-3,
        terminals=(Terminal("hand", ("grip",), "Whether the hand holds the arm"),),
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
class Grasp:
    """The signal in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self._x = start_values(self._model, {})

    def initialize(self, values: Values) -> None:
        """Take the parameters. Raises ScenarioError."""
        self._x = start_values(self._model, values)

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start: those of t = 0."""
        return self._at(0.0, 0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h."""
        return self._at(t, h)

    def _at(self, t: float, h: float) -> Outputs:
        changes = np.count_nonzero(t + 1e-6 * h >= self._x["times"])
        return {"grip": np.array(1.0 - (self._x["released"] + changes) % 2)}

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
