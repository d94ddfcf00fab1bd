"""A model declared once: its variables, from which XML, C struct and Python ports are made.

Every variable, of whatever FMI type, is stored as float64 in one struct without padding. The
struct member is called like the variable; FMI 2.0 value references count its scalars, FMI 3.0
value references its variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from inspect import signature
from math import inf, isfinite, prod
from typing import Literal

from cosim.base.component import Kind, Parameter, Port
from cosim.base.copies import replace
from cosim.base.errors import FmuError

Causality = Literal["structuralParameter", "parameter", "input", "output", "local"]


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable; `start` is a scalar for all entries, or one value per entry (row-major).

    `settable`: the start value of an output or local may be set (FMI ``initial="exact"``);
    otherwise it is calculated at the start. `depends`: the inputs this output depends on
    directly, at the start and in a step; what is named here is tested by perturbation.
    `elementwise`: each entry depends on the entry of the same place only (equal shapes).
    `start_depends`: the parameters and start values that the calculated start of an output depends
    on besides. `optional`: an input that is often left unfed, on purpose. `symbol`: the C name
    where `name` is a keyword or clashes. `axis`: the place in `shape` whose extent a structural
    parameter gives, which is then the most; -1: none.
    """

    name: str
    causality: Causality
    shape: tuple[int, ...] = ()
    unit: str = "1"
    start: float | tuple[float, ...] = 0.0
    description: str = ""
    type: Literal["real", "integer", "boolean", "size"] = "real"
    settable: bool = False
    depends: tuple[str, ...] = ()
    elementwise: bool = False
    start_depends: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    symbol: str = ""
    optional: bool = False
    axis: int = -1

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)

    @property
    def starts(self) -> tuple[float, ...]:
        """The start value of every entry, in the unit of the variable, row-major."""
        if isinstance(self.start, tuple):
            return self.start
        return (float(self.start),) * self.size


@dataclass(frozen=True, slots=True)
class Terminal:
    """Variables that are wired together: a joint port, a network port (FMI 3.0 terminal)."""

    name: str
    members: tuple[str, ...]
    description: str = ""


@dataclass(frozen=True, slots=True)
class Model:
    """The name of a model, its variables and sources, and how it steps.

    `identifier` is the FMI modelIdentifier (a C name, the file stem of the FMU); `sources` are C
    files of ``fmus/c`` (or absolute paths) besides the generic FMI layer; the first holds
    ``model_initial`` and ``model_step``. `defines`: macros for them, in ``variables.h``.
    `documentation` is plain text with the equations, for the page inside the FMU.
    `clock`: the interval (s) of the clock that its FMU has, 0 for none.
    `lanes`: the step in the first source is written for several instances (``fmus/c/real.h``).
    `structural`: the variable that gives the extent of arrays (FMI 3.0 only); empty: none.
    `states`: (state, its derivative) by name, for an FMU for model exchange, whose further
    variables are `rates`: the first source has ``model_rates`` for it. `exchange`: this is one.
    """

    identifier: str
    description: str
    kind: Kind
    variables: tuple[Variable, ...]
    sources: tuple[str, ...]
    version: str = "1.0"
    step: float = 1e-3  # s, default communication step
    terminals: tuple[Terminal, ...] = field(default=())
    documentation: str = ""
    clock: float = 0.0
    lanes: bool = False
    structural: str = ""
    states: tuple[tuple[str, str], ...] = ()
    rates: tuple[Variable, ...] = ()
    exchange: bool = False
    defines: tuple[tuple[str, int], ...] = ()

    def inputs(self) -> tuple[Port, ...]:
        """Input ports, in order."""
        return tuple(_port(v) for v in self.variables if v.causality == "input")

    def outputs(self) -> tuple[Port, ...]:
        """Output ports, in order."""
        return tuple(_port(v) for v in self.variables if v.causality == "output")

    def parameters(self) -> tuple[Parameter, ...]:
        """Everything that may be set before the start: parameters and start values."""
        return tuple(
            Parameter(v.name, v.starts, v.shape, v.unit, v.description, v.type)
            for v in self.variables
            if v.type != "size" and (v.causality == "parameter" or v.settable)
        )


def _port(variable: Variable) -> Port:
    default = variable.starts if variable.causality == "input" else ()
    v = variable
    low = -inf if v.minimum is None else v.minimum
    high = inf if v.maximum is None else v.maximum
    return Port(v.name, v.shape, v.unit, v.description, default, v.optional, low, high)


def annotation(kind: Kind, inputs: Iterable[Port]) -> dict[str, str]:
    """Properties of our FMUs beyond FMI; :mod:`cosim.fmi.file.description` reads them."""
    optional = " ".join(p.name for p in inputs if p.optional)
    return {"kind": kind, "optional": optional} if optional else {"kind": kind}


def any_size(declare: Callable[..., Model], size: str = "joints", most: int = 16) -> Model:
    """The model of `declare` for every `size` from 1 to `most`: a structural parameter (FMI 3.0).

    Its arrays have room for `most`, and use the first entries; the default is that of `declare`.
    The C code of the model counts with ``COUNT`` (``fmus/c/model.h``).
    Raises FmuError where an array has the size behind another axis, or start values that a smaller
    one does not begin with: entries would not lie together.
    """
    whole, smaller, usual = declare(**{size: most}), declare(**{size: most - 1}), declare()
    variables = []
    for v, less, default in zip(whole.variables, smaller.variables, usual.variables, strict=True):
        place = f"{whole.identifier}.{v.name}"
        axes = [k for k, n in enumerate(v.shape) if n != less.shape[k]]
        if not axes:
            variables.append(v)
            continue
        if len(axes) > 1 or prod(v.shape[: axes[0]]) != 1:
            raise FmuError(f"{place}: shape {v.shape}; expected {size} as its first extent")
        if any(one.starts != v.starts[: one.size] for one in (less, default)):
            raise FmuError(f"{place}: its start values depend on {size}")
        variables.append(replace(v, axis=axes[0]))
    structural = Variable(
        *(size, "structuralParameter", (), "1"),
        start=float(signature(declare).parameters[size].default),
        description=f"Number of {size}",
        type="size",
        minimum=1.0,
        maximum=float(most),
    )
    return replace(
        usual,
        identifier=f"{whole.identifier}_any",
        variables=(*variables, structural),
        structural=size,
    )


def exchanged(model: Model) -> Model:
    """`model` for model exchange, integrated by the importer: NAME_exchange.

    Raises FmuError for a model that does not give its derivatives.
    """
    if not model.states:
        raise FmuError(
            f"{model.identifier} gives no derivatives of its states; expected a plant that does"
        )
    name = f"{model.identifier}_exchange"
    variables = (*model.variables, *model.rates)
    return replace(model, identifier=name, variables=variables, exchange=True, lanes=False)


def clocked(model: Model, interval: float) -> Model:
    """`model` as the partition of a clock that ticks every `interval` s, for FMI 3.0: NAME_clocked.

    Its inputs and outputs are clocked, its step is a tick (FMI 3.0.2 §2.2.8). Raises FmuError for a
    continuous model, or an interval that is not a positive number.
    """
    if model.kind != "sampled":
        raise FmuError(f"{model.identifier} is {model.kind}; expected a sampled model for a clock")
    if not (isfinite(interval) and interval > 0.0):
        raise FmuError(f"{model.identifier}: the clock's interval is {interval:g} s; expected > 0")
    if any(v.name == "clock" for v in model.variables):
        raise FmuError(f"{model.identifier}.clock: declared; a clocked model adds this variable")
    name = f"{model.identifier}_clocked"
    return replace(model, identifier=name, clock=interval, step=interval, lanes=False)
