"""Parts of a plan: slots of the signal vector, steps, wires, links, players and gates.

Those of which a plan has very many are structs (:mod:`cosim.base.convert`).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import TYPE_CHECKING, Any, Protocol

from cosim.base.component import Component, Kind
from cosim.base.convert import Struct, field

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cosim.links.table import TableSpec


class Slot(Struct, frozen=True, gc=False):
    """A stretch of the signal vector: a port, or a row of one. `name` is ``component.port``.

    `base`: the index of the first entry, along each axis; `units`: of each entry, where they are
    not all `unit`.
    """

    name: str
    component: str
    port: str
    start: int
    shape: tuple[int, ...]
    unit: str
    base: int = 0
    units: tuple[str, ...] = ()

    def unit_of(self, entry: int) -> str:
        """The unit of an entry, counted from 0 in the flattened slot."""
        return self.units[entry] if self.units else self.unit

    @property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)

    def scalars(self) -> tuple[str, ...]:
        """Names of the scalars: ``master.q[0]``, ``control.xi_in[0,1]``."""
        indices: list[tuple[int, ...]] = [()]
        for n in self.shape:
            indices = [(*i, j) for i in indices for j in range(self.base, self.base + n)]
        head = f"{self.name[:-1]}," if self.name.endswith("]") else f"{self.name}["
        return tuple(f"{head}{','.join(map(str, i))}]" if i else self.name for i in indices)


class Step(Struct, frozen=True):
    """A component in the plan: `period` in ticks, `values` flattened, its slots in port order."""

    name: str
    component: Component
    kind: Kind
    period: int
    values: Mapping[str, tuple[float, ...]]
    inputs: tuple[Slot, ...]
    outputs: tuple[Slot, ...]
    start: Mapping[str, tuple[float, ...]]  # inputs at the start, where nothing feeds them
    extrapolate: bool = False  # wires from continuous components, over a step
    discrete: frozenset[str] = frozenset()  # inputs that are held all the same
    sloped: frozenset[str] = frozenset()  # inputs that take the slope of what is extrapolated
    files: Mapping[str, str] = field(default_factory=dict)  # read for it: SHA-256 by path
    remarks: tuple[str, ...] = ()  # what these files say and the component does not do


class Wire(Struct, frozen=True, gc=False):
    """`target = gain * source + offset`, in the same tick."""

    source: Slot
    target: Slot
    gain: float = 1.0
    offset: float = 0.0


class Link(Struct, frozen=True, gc=False):
    """A wire through a table of sent samples; `initial` is the pre-history, None: the start.

    `age`: a scalar input that gets the age (s) of what the link holds.
    """

    name: str
    source: Slot
    target: Slot
    table: TableSpec
    gain: float = 1.0
    offset: float = 0.0
    initial: tuple[float, ...] | None = None
    age: Slot | None = None


class ValueStream(Protocol):
    """Values in order, in chunks whose sizes do not change them."""

    def rows(self, n: int) -> NDArray[np.float64]:
        """Return the next values (n,), in the unit of the signal."""


class ValueSource(Protocol):
    """The source of a player: one value a hit of its receiver."""

    def stream(self) -> ValueStream:
        """The values from the first on."""

    def facts(self) -> dict[str, Any]:
        """The facts that are written down with a run."""


class Player(Struct, frozen=True):
    """A table of values that feeds a scalar input: the weight of an edge over time."""

    target: Slot
    source: ValueSource


class Gate(Struct, frozen=True):
    """A place where signals of the plan leave, or others enter, at the hits of `component`.

    Out: once its outputs of t_k are there; in: before it reads its inputs. What happens there is a
    function given to the engine (``docs/design.md``, idea 6).
    """

    name: str
    component: str
    out: bool


class RunningBus(Protocol):
    """One execution of a bus that is simulated inside the ticks."""

    @property
    def gates(self) -> Mapping[str, tuple[int, int]]:
        """(address of the function, of its context) by the name of each gate."""

    def rows(self, link: str, n: int) -> NDArray[np.int32]:
        """Room for the next `n` rows of a link's table, (n,), which the run fills in."""


class SteppedBus(Protocol):
    """A bus that is simulated inside the ticks, since the bits of its frames are signals."""

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The places at which it takes part in a tick."""

    @property
    def history(self) -> Mapping[str, int]:
        """Its links by name, and how many samples each must keep."""

    def start(self) -> RunningBus:
        """Make the bus of one execution, at time 0."""
