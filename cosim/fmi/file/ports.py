"""Variables of an FMU as ports: arrays of FMI 3.0 as they are, scalars `q[0]` or `q[1]` of 2.0
grouped, with the FMU's own numbers of the entries.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import product
from math import prod

from cosim.base.convert import Struct
from cosim.fmi.file.variables import TEXTS, FmuVariable

_INDEXED = re.compile(r"(.+)\[(\d+(?:,\d+)*)\]$")
REAL = ("Real", "Float64")


class VariableGroup(Struct, frozen=True, dict=True):
    """Variables that make up one signal, row-major: one array, or scalars of one array.

    `base`: the index of the first scalar along each axis, by the FMU's own names.
    """

    name: str
    shape: tuple[int, ...]
    variables: tuple[FmuVariable, ...]
    base: int = 0

    @cached_property
    def size(self) -> int:
        """Number of scalars."""
        return prod(self.shape)

    @cached_property
    def references(self) -> tuple[int, ...]:
        """Value references, in order."""
        return tuple(v.reference for v in self.variables)

    @property
    def first(self) -> FmuVariable:
        """The first variable, which represents all: they have the same type, unit and causality."""
        return self.variables[0]

    @property
    def start(self) -> tuple[str, ...]:
        """The start value of every scalar as written, or () where any is missing."""
        texts = tuple(t for v in self.variables for t in v.start)
        if len(self.variables) == 1 and len(texts) == 1:
            return texts * self.size
        return texts if len(texts) == self.size else ()


def together(groups: Iterable[VariableGroup]) -> list[tuple[str, list[VariableGroup]]]:
    """Groups that one call sets or gets, by type: all scalars, but arrays one by one, so that an
    FMU says which one has another size in its binary.
    """
    by_type = defaultdict[tuple[str, str], list[VariableGroup]](list)
    for g in groups:
        by_type[g.first.type, g.name if g.first.shape else ""].append(g)
    return [(kind, some) for (kind, _), some in by_type.items()]


def groups(variables: Iterable[FmuVariable]) -> tuple[VariableGroup, ...]:
    """Group variables into signals, in the order of their first appearance.

    FMI 2.0 scalars ``a[i]``/``a[i,j]`` become one array when they fill a whole grid from 0 or 1
    and share type, unit, causality and clocks; what does not stays scalar under its own name, and
    so do texts.
    """
    families: dict[str, list[tuple[tuple[int, ...], FmuVariable]]] = {}
    order: list[str] = []
    for variable in variables:
        match = _INDEXED.match(variable.name) if not variable.shape else None
        name = match[1] if match else variable.name
        index = tuple(int(i) for i in match[2].split(",")) if match else ()
        if name not in families:
            order.append(name)
        families.setdefault(name, []).append((index, variable))
    return tuple(group for name in order for group in _family(name, families[name]))


def _family(
    name: str, members: Sequence[tuple[tuple[int, ...], FmuVariable]]
) -> Iterable[VariableGroup]:
    alone = [VariableGroup(v.name, v.shape, (v,)) for _, v in members]
    indices = [index for index, _ in members]
    first = members[0][1]
    alike = first.type not in TEXTS and all(_kind(v) == _kind(first) for _, v in members)
    if not alike or any(not i or len(i) != len(indices[0]) for i in indices):
        return alone
    base = min(min(i) for i in indices)
    shape = tuple(max(axis) - base + 1 for axis in zip(*indices, strict=True))
    if prod(shape) != len(members):  # first: indices are numbers of any size
        return alone
    grid = [tuple(i + base for i in entry) for entry in product(*(range(n) for n in shape))]
    table = dict(members)
    if base > 1 or any(i not in table for i in grid):
        return alone
    return [VariableGroup(name, shape, tuple(table[i] for i in grid), base)]


def _kind(v: FmuVariable) -> tuple[object, ...]:
    """The common properties of the members of one array."""
    ticks = v.attributes.get("intervalVariability")
    return v.type, v.unit, v.causality, v.initial, v.clocks, ticks
