"""A component from a plain function: the decorator ``cosim.component``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

from cosim.api.arguments import expect
from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import parse

#: Kinds of arguments (cosim/api/arguments.py).
_KINDS = {"inputs": "ports", "outputs": "ports", "parameters": "parameters?", "kind": "kind"}
#: Of a port: its unit, or (number of entries, unit) for a vector, (shape, unit) for an array.
PortText = str | tuple[int | tuple[int, ...], str]


def component(
    *,
    inputs: Mapping[str, PortText],
    outputs: Mapping[str, PortText],
    parameters: Mapping[str, tuple[float, str]] | None = None,
    kind: Kind = "sampled",
) -> Callable[[Callable[..., Outputs]], Callable[[], FunctionComponent]]:
    """Make a component of a function without memory, which may be a scenario's ``model``.

    ``inputs`` and ``outputs``: name -> unit of a scalar, or (entries, unit) of a vector. The
    function is called with its inputs as NumPy arrays and its parameters as floats, all by name,
    and returns a dict with every output. ``parameters``: name -> (default, unit). A component with
    memory is a class (docs/own-component.md). Raises ScenarioError for a port that is not one of
    these::

        @cosim.component(
            inputs={"q": (2, "rad"), "dq": (2, "rad/s")},
            outputs={"tau": (2, "N.m")},
            parameters={"k": (10.0, "N.m/rad"), "d": (4.0, "N.m.s/rad")},
        )
        def spring(q, dq, k, d):
            return {"tau": -k * q - d * dq}
    """
    expect("component", _KINDS, locals())
    found = {name: (float(value), unit) for name, (value, unit) in (parameters or {}).items()}
    ports = tuple(_port(name, text) for name, text in inputs.items())
    gives = tuple(_port(name, text) for name, text in outputs.items())

    def wrap(function: Callable[..., Outputs]) -> Callable[[], FunctionComponent]:
        def make() -> FunctionComponent:
            return FunctionComponent(function, kind, ports, gives, found)

        make.__name__ = getattr(function, "__name__", "component")
        make.__doc__ = function.__doc__
        return make

    return wrap


def _port(name: str, text: PortText) -> Port:
    if isinstance(text, str):
        return Port(name, (), _unit(name, text))
    if isinstance(text, tuple) and len(text) == 2 and isinstance(text[1], str):
        size, unit = text[0], _unit(name, text[1])
        return Port(name, size if isinstance(size, tuple) else (size,), unit)
    raise ScenarioError(f"port {name!r} is {text!r}; expected a unit, or (number of entries, unit)")


def _unit(name: str, text: str) -> str:
    """The unit of a port. Raises ScenarioError for one that is not known."""
    try:
        parse(text)
    except UnitError as error:
        raise ScenarioError(str(error), f"port {name!r}") from None
    return text


@final
class FunctionComponent:
    """A function as a component: its outputs depend on the inputs and parameters only."""

    def __init__(
        self,
        function: Callable[..., Outputs],
        kind: Kind,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        parameters: Mapping[str, tuple[float, str]],
    ) -> None:
        self.kind: Kind = kind
        self.inputs, self.outputs = inputs, outputs
        self.parameters = tuple(
            Parameter(name, (value,), (), unit) for name, (value, unit) in parameters.items()
        )
        self._function = function
        self._values = {name: value for name, (value, _) in parameters.items()}

    def initialize(self, values: Values) -> None:
        """Take the values of parameters."""
        self._values |= {name: float(value) for name, value in values.items()}

    def initial(self, u: Values) -> Outputs:
        """The outputs at the start."""
        return self._function(**u, **self._values)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """The outputs for the inputs `u`; time `t` and step `h`, s, are not used."""
        return self._function(**u, **self._values)

    def get_state(self) -> Any:
        """It has no state."""
        return None

    def set_state(self, state: Any) -> None:
        """It has no state."""
