"""Fourteen signals through, with a gain: what a 7-joint arm exchanges (torques and xi).

::

    y(t + h) = gain u(t),  y, u in R^14
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, final

from cosim.base.component import Kind, Parameter, Port
from fmus.build.archive import Version, find
from fmus.build.kernel import Kernel
from fmus.model import Model, Variable
from fmus.model.numeric import checked_outputs, copy_state, received, start_values

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values

N = 14


def model() -> Model:
    """Declare the signals."""
    return Model(
        identifier="bench_wide",
        description="Fourteen signals through, with a gain",
        kind="continuous",
        variables=(
            Variable("u", "input", (N,), "1", description="In"),
            Variable("y", "output", (N,), "1", 1.0, "Out, one step later", settable=True),
            Variable("gain", "parameter", (), "1", 1.0, "Gain"),
        ),
        sources=(str(Path(__file__).with_name("wide.c")),),
        step=1e-2,
        documentation=__doc__ or "",
    )


@lru_cache(maxsize=2)
def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built into the cache if it is not there."""
    return find(model(), version)


def kernel() -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between."""
    return Kernel(model())


@final
class Wide:
    """The signals in NumPy."""

    kind: Kind = "continuous"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self._x = start_values(self._model, {})

    def initialize(self, values: Values) -> None:
        """Take parameters and start values. Raises ScenarioError."""
        self._x = start_values(self._model, values)

    def initial(self, u: Values) -> Outputs:
        """The outputs at the start, whatever comes in."""
        del u
        return {"y": self._x["y"].copy()}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """What came in, times the gain."""
        (signals,) = received(self.inputs, u, t)
        self._x["y"] = self._x["gain"] * signals  # (14,)
        return checked_outputs({"y": self._x["y"]}, t)

    def get_state(self) -> object:
        """All values, copied."""
        return copy_state(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copy_state(state)
