"""NumPy for the laws of models, imported when the first law is evaluated; values that it checks.

Declarations are read without it, because an installation builds the FMUs without NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import nan
from typing import TYPE_CHECKING, Any

from cosim.base.component import Port
from cosim.base.errors import RunError, ScenarioError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from fmus.model.declaration import Model, Variable

    Array = NDArray[np.float64]
else:
    Array = Any

    class _NumPy:
        """Gives what NumPy has, and keeps it."""

        def __getattr__(self, name: str) -> object:
            import numpy

            found = getattr(numpy, name)
            setattr(self, name, found)
            return found

    np = _NumPy()

__all__ = [
    "Array",
    "checked_outputs",
    "copy_state",
    "initial_input",
    "np",
    "received",
    "start_values",
]


def start_values(model: Model, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Every parameter and start value of `model`, by name, of its shape; defaults filled in.

    Raises ScenarioError for an unknown name, a wrong shape, a value that is not finite, outside
    the declared range, or fractional where the type is integer.
    """
    declared = {v.name: v for v in model.variables if v.causality == "parameter" or v.settable}
    for name in values:
        if name not in declared:
            raise ScenarioError(
                f"unknown parameter {name!r}; expected one of {', '.join(declared)}",
                model.identifier,
            )
    return {
        name: _checked(variable, values.get(name, variable.starts), f"{model.identifier}.{name}")
        for name, variable in declared.items()
    }


def _checked(variable: Variable, given: ArrayLike, place: str) -> Array:
    value = np.array(given, dtype=np.float64)
    if value.shape != variable.shape:
        if value.size != variable.size or value.ndim > 1:
            raise ScenarioError(f"shape is {value.shape}, expected {variable.shape}", place)
        value = value.reshape(variable.shape)
    if not np.isfinite(value).all():
        raise ScenarioError(f"{value.tolist()} is not finite", place)
    if variable.minimum is not None and (value < variable.minimum).any():
        raise ScenarioError(f"{value.tolist()} is below the minimum {variable.minimum:g}", place)
    if variable.maximum is not None and (value > variable.maximum).any():
        raise ScenarioError(f"{value.tolist()} is above the maximum {variable.maximum:g}", place)
    if variable.type != "real" and (value != np.round(value)).any():
        raise ScenarioError(f"{value.tolist()} is no {variable.type}", place)
    return value


def received(inputs: tuple[Port, ...], u: Mapping[str, ArrayLike], t: float = nan) -> list[Array]:
    """The inputs in the order of `inputs`, each of its shape; those left out hold their default.

    `t` (s) is for the message. Raises RunError where a value is not finite.
    """
    values = [
        np.array(u.get(port.name, initial_input(port)), dtype=np.float64).reshape(port.shape)
        for port in inputs
    ]
    for port, value in zip(inputs, values, strict=True):
        if not np.isfinite(value).all():
            raise RunError(f"input {port.name} is {value.tolist()}, not finite", time=t)
    return values


def initial_input(port: Port) -> Array:
    """The value of an input to which nothing is wired, of its shape."""
    return np.reshape(port.default or (0.0,) * port.size, port.shape).astype(np.float64)


def checked_outputs(outputs: dict[str, Array], t: float = nan) -> dict[str, Array]:
    """The outputs unchanged, each with its shape. Raises RunError if one is not finite.

    `t`: the time for the message, s.
    """
    for name, value in outputs.items():
        if not np.isfinite(value).all():
            raise RunError(f"output {name} is {value.tolist()}: it diverged", time=t)
    return outputs


def copy_state(state: object) -> dict[str, Array]:
    """A copy of the values that a reference model keeps by name; shapes are kept.

    Raises RunError for anything else.
    """
    if not isinstance(state, dict):
        raise RunError(f"state is a {type(state).__name__}, expected a state from get_state")
    return {name: value.copy() for name, value in state.items()}
