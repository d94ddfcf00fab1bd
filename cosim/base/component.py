"""Component: everything that steps. Port and Parameter: how it is wired and set.

Two kinds, and nothing else is known about a component:

* A **sampled** component (controller, operator, estimator) reads its inputs as they are at
  ``t`` and computes outputs that hold over ``[t, t+h)``: sample, compute, hold.
* A **continuous** component (plant) takes inputs held over ``[t, t+h)`` and gives its outputs
  at the end, at ``t+h``.

Life cycle::

    initialize(values) -> initial(u) [-> initial(u) ...] -> step(t, h, u) -> step ...

A component reads no clock and keeps no role: time and inputs are arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, prod
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike

Kind = Literal["sampled", "continuous"]
Values: TypeAlias = "Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]"
Outputs: TypeAlias = "Mapping[str, ArrayLike]"


@dataclass(frozen=True, slots=True)
class Port:
    """A named signal of float64 values: `shape` () is a scalar, (m,) a vector, row-major.

    `default` (flattened, () = zeros) is what an input holds when nothing is wired to it. With
    `optional` that is normal; else ``cosim check`` takes it for a forgotten wire, unless the
    scenario sets a start value. `low` and `high`: the least and the greatest value each entry may
    have, in `unit`. `base`: the index of the first entry, along each axis: 1 in FMUs of Modelica
    tools, whose names of entries hold.
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str = "1"
    description: str = ""
    default: tuple[float, ...] = ()
    optional: bool = False
    low: float = -inf
    high: float = inf
    base: int = 0

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value fixed before the first step: a parameter, or the start value of a state.

    `default` holds the flattened values (row-major); `type` is the FMI type it is carried as;
    `base`: as of a :class:`Port`.
    """

    name: str
    default: tuple[float, ...]
    shape: tuple[int, ...] = ()
    unit: str = "1"
    description: str = ""
    type: Literal["real", "integer", "boolean"] = "real"
    base: int = 0

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)


@dataclass(frozen=True, slots=True)
class Preparation:
    """Sizes, and parameters by name, that a model makes of the options of a component.

    A module offers it as ``prepare(options, folder)``; paths among the options are relative to
    `folder`. `values` are numbers or nested lists in the unit of the parameter; a preset and the
    parameters of the scenario come after them. `files` has the SHA-256 of each file read, by path;
    `remarks` are sentences for ``cosim check``: what the files say and the model does not do.
    `units`: by port, the unit of each of its entries, where they are not all that of the port.
    """

    sizes: Mapping[str, int]
    values: Mapping[str, Any]
    files: Mapping[str, str]
    remarks: tuple[str, ...] = ()
    units: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Drawing:
    """The drawing of a serial robot; a module of a model offers ``drawing(options, folder)``.

    Of each joint: whether it is `prismatic`, and at zero the axes (9 numbers, row by row, columns
    are the axes) and the origin (3), m, of its frame in its parent's; it moves about or along its z
    axis. `tip`: the end in the last frame (3), m. `position` and `torque`: outputs of the
    component. `planar`: it moves in the plane x, y of its base. `names` of the joints; empty:
    joint1 and so on.
    """

    prismatic: tuple[bool, ...]
    rotations: tuple[tuple[float, ...], ...]
    origins: tuple[tuple[float, ...], ...]
    tip: tuple[float, ...]
    position: str = "q"
    torque: str = ""
    planar: bool = False
    names: tuple[str, ...] = ()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.prismatic)

    def data(self) -> dict[str, Any]:
        """The data that a page reads, with the `reach` (m) of the stretched arm."""
        lengths = [sum(x * x for x in p) ** 0.5 for p in (*self.origins, self.tip)]
        parts = zip(self.prismatic, self.rotations, self.origins, strict=True)
        return {
            "joints": [{"prismatic": p, "rotation": r, "origin": o} for p, r, o in parts],
            "tip": self.tip,
            "planar": self.planar,
            "reach": sum(lengths) or 1.0,
        }


@dataclass(frozen=True, slots=True)
class SharedBase:
    """The base of a robot in coordinates that several robots share.

    A point p (m) of the base is at `scale` `rotation` (p - `origin`); `rotation`: 9 numbers, row by
    row. `tip`: the end of the robot in its last frame (3), m, or () for that of its drawing. The
    module of a model of a controller offers ``shared_base(options, parameters, folder)``.
    """

    rotation: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    tip: tuple[float, ...] = ()

    def data(self) -> dict[str, Any]:
        """The data that a page reads."""
        return {"rotation": self.rotation, "origin": self.origin, "scale": self.scale}


class Component(Protocol):
    """A component that the engine steps: a Python class with these members, or an FMU."""

    kind: Kind
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: tuple[Parameter, ...]

    def initialize(self, values: Values) -> None:
        """Go to the start. `values`: parameters and start values by name, each of its shape.

        Names left out keep their default. Raises CosimError for a value it cannot take.
        """

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start, given the inputs `u` there; may be called repeatedly."""

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """One step from `t` (s) of length `h` (s) with inputs `u`; returns all outputs."""

    def get_state(self) -> object:
        """Everything a later :meth:`set_state` needs to continue from here exactly."""

    def set_state(self, state: object) -> None:
        """Continue from a state taken earlier."""


@runtime_checkable
class NativeComponent(Component, Protocol):
    """A component from a foreign simulator, whose step is a C function that the engine calls.

    It has a time step of its own, and what a run must record about it.
    """

    @property
    def model_name(self) -> str:
        """The model as text, for ``cosim show``."""

    def facts(self) -> Mapping[str, str]:
        """Metadata for ``run.json``: file, sum and version of the simulator."""

    def remarks(self, values: Mapping[str, tuple[float, ...]]) -> tuple[str, ...]:
        """Sentences for ``cosim check``: what the file says and the simulator does not do.

        `values`: start values of the scenario, flattened, in the unit of the parameter.
        """

    def check_period(self, period: float, place: str) -> None:
        """Raise ScenarioError at `place` if `period` (s) is not a multiple of its own step."""

    def native_step(self, period: float) -> tuple[int, int]:
        """Addresses of the function (``native_t`` of ``engine.h``) and of its instance.

        `period`: length (s) of every step. The component has been initialised before.
        """

    def failure(self) -> str:
        """The reason why the last native step failed."""
