"""Structs of a variants file; their fields are the permitted keys."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeVar, cast

import msgspec

from cosim.base.convert import Number, Quantity, in_units
from cosim.measure.metrics import Distance

PortKind = Literal["transparency", "z_width", "free_impedance", "passivity"]
Environment = Literal["free", "spring", "rigid"]
Names = tuple[str, ...]
Table = dict[str, Any]
Wires = dict[str, str]
Named = Annotated[dict[str, Table], msgspec.Meta(min_length=1)]


S = TypeVar("S", bound=msgspec.Struct)


def with_roles(spec: type[S], kind: type, roles: Iterable[str]) -> type[S]:
    """The same struct with a further key for each role: a table of this kind, or None."""
    made = msgspec.defstruct(
        spec.__name__, [(role, kind | None, None) for role in roles], bases=(spec,),
        frozen=True, forbid_unknown_fields=True, kw_only=True,
    )  # fmt: skip
    return cast(type[S], made)


class RoleSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Components of the scenario that are one arm and its controller, and whom it hears."""

    arm: str
    controller: str
    hears: str | Names | None = None


class WiringSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wires of every controller that has none of its own."""

    inputs: Wires | None = None
    drives: Wires | None = None


class VariantComponentSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of a component; the scenario that they become part of checks their values."""

    model: str | None = None
    fmi: Any = None
    sizes: Table | None = None
    options: Table | None = None
    preset: Any = None
    period: Any = None
    parameters: Table | None = None
    start: Table | None = None

    def keys(self) -> Table:
        """The keys that are given."""
        values = {key: getattr(self, key) for key in VariantComponentSpec.__struct_fields__}
        return {key: value for key, value in values.items() if value is not None}


class PartSpec(VariantComponentSpec, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A further component of a side."""

    inputs: Wires = {}


class SideSpec(VariantComponentSpec, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A controller, or what is different on the side of one role."""

    inputs: Wires | None = None
    drives: Wires | None = None
    receives: Wires | None = None


class ControllerSpec(SideSpec, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A controller of both sides; each role may have a table of its own."""

    title: str = ""
    condition: str = ""
    constant_delay: bool = False
    components: dict[str, Table] = {}


class OperatorSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An operator; each role may have a table with values of its arm."""

    title: str = ""
    without: Names = ()
    components: dict[str, Table] = {}
    feeds: dict[str, Wires] = {}
    control: Table = {}


class WaySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of a link; the scenario that they become part of checks their values."""

    delay: Any = None
    semantics: Any = None
    playout: Any = None
    depth: Any = None
    drop: Any = None
    take: Any = None
    loss: Any = None

    def keys(self) -> Table:
        """The keys that are given."""
        values = {key: getattr(self, key) for key in WaySpec.__struct_fields__}
        return {key: value for key, value in values.items() if value is not None}


class VariantLinkSpec(WaySpec, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A link law; each role may have a table for the way on which it receives."""

    title: str = ""
    hears: dict[str, str | Names] = {}


class ColumnSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A column of a metric, see :mod:`cosim.measure.metrics`."""

    kind: str
    of: Names
    target: str | tuple[float, ...] | None = None
    within: Number | None = None
    window: Number | None = None
    contact: Names = ()
    norm: Distance = "max"
    label: str = ""
    part: str = ""
    only: Names = ()


class AlignedSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A column of :mod:`cosim.comparison.aligned`."""

    kind: str
    of: Annotated[Names, msgspec.Meta(min_length=1, max_length=1)]
    target: str
    label: str = ""
    part: str = ""


class PortMeasure(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A column of :mod:`cosim.comparison.port_columns`: a number of the operator's port.

    `environment`: at the other side; free by default.
    """

    kind: PortKind
    environment: Environment | None = None
    label: str = ""

    @property
    def signals(self) -> tuple[str, ...]:
        """It reads no recorded signals."""
        return ()


class SpringSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spring (N.m/rad) with a damper (N.m.s/rad)."""

    stiffness: Quantity
    damping: Quantity

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, stiffness="N.m/rad", damping="N.m.s/rad")


class PortBench(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[port]``, see :mod:`cosim.comparison.port_columns`: the test bench of ports.

    `operator`, `environment`: roles, of whose arms one is pushed and one meets the environment; `q`
    (m,) rad; `band` (lowest, highest) rad/s.
    """

    operator: str
    environment: str
    q: tuple[float, ...]
    band: tuple[float, float]
    spring: SpringSpec
    rigid: SpringSpec


class Stability(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[stable]``: the criteria of :func:`cosim.comparison.verdict.judge`, SI."""

    position: Names
    velocity: Names
    position_limit: Quantity
    velocity_limit: Quantity
    rest: Quantity
    window: Quantity

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, position_limit="rad", velocity_limit="rad/s", rest="rad/s", window="s")


class Picture(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[figure]``: signals `y` of each run, and where they should be; `until`: s."""

    y: Names
    reference: tuple[float, ...] = ()
    until: Quantity = float("inf")

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, until="s")


class DefaultSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The names that are compared if the file gives none."""

    controllers: Names = ()
    operators: Names = ()
    links: Names = ()
    columns: Names = ()


class VariantsSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file."""

    title: str = ""
    set: Names = ()
    roles: dict[str, RoleSpec]
    wiring: WiringSpec = WiringSpec()
    controllers: Named
    operators: Named
    links: Named
    columns: Named
    stable: Stability
    figure: Picture
    port: PortBench | None = None
    default: DefaultSpec = DefaultSpec()
