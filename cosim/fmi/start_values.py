"""Start values of an FMU: set in the modes that the standard permits, then read back.

Parameters and start values are set after ``fmi2SetupExperiment`` and before Initialization Mode is
entered (FMI 2.0.5 §2.1.6, 3.0.2 §2.3.2), where both "exact" and "approx" ones may be set. Some
exporters set their parameters to the defaults in ``fmi2SetupExperiment``. Others may do so on
entering Initialization Mode, so exact values are set there once more: FMI 2.0 allows this, but not
to read a parameter there. What an FMU computes with in the end is read back, and compared to the
bit.
"""

from __future__ import annotations

import ctypes as c
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cosim.base.errors import FmuError
from cosim.fmi.library import Clocks, Instance
from cosim.fmi.ports import REAL, VariableGroup, together
from cosim.fmi.variables import TEXTS

Found = Sequence[float] | Sequence[str]


@dataclass(frozen=True, slots=True)
class StartValue:
    """A variable and what was set: numbers, or texts (Binary: hexadecimal); all scalars."""

    group: VariableGroup
    values: Found

    @property
    def exact(self) -> bool:
        """Whether the FMU has to start from this very value, and not from one near it."""
        return self.is_parameter or self.group.first.initial == "exact"

    @property
    def is_parameter(self) -> bool:
        """Whether it keeps its value after the start, too."""
        return self.group.first.causality in ("parameter", "structuralParameter")

    def set(self, x: Instance) -> None:
        """Set it. Raises FmuError."""
        first, references = self.group.first, self.group.references
        if first.type in TEXTS:
            x.set_texts(first.type, references, [str(v) for v in self.values])
        else:
            x.set(first.type, references, [float(v) for v in self.values])

    def differs(self, x: Instance) -> Found | None:
        """What the FMU has in its place; None: the same. Raises FmuError."""
        first, references = self.group.first, self.group.references
        found: Found
        if first.type in TEXTS:
            found = x.get_texts(first.type, references, self.group.size)
        else:
            found = x.get(first.type, references, self.group.size)
        same = _all_representable(first.type, self.values) == _all_representable(first.type, found)
        return None if same else found


def set_all(x: Instance, given: Sequence[StartValue]) -> None:
    """Set values, those of one type in one call. Raises FmuError."""
    for kind, some in _by_call(given):
        if kind in TEXTS:
            for one in some:
                one.set(x)
        else:
            x.set(kind, _references(some), [float(v) for one in some for v in one.values])


def unequal(x: Instance, given: Sequence[StartValue]) -> Iterator[tuple[StartValue, Found]]:
    """Those of which the FMU has others, with what it has; asked together, then one by one."""
    for kind, some in _by_call(given):
        if kind not in TEXTS:
            wanted = [float(v) for one in some for v in one.values]
            found = x.get(kind, _references(some), len(wanted))
            same = wanted == found
            if same or _all_representable(kind, wanted) == _all_representable(kind, found):
                continue
        for one in some:
            other = one.differs(x)
            if other is not None:
                yield one, other


def _all_representable(kind: str, values: Found) -> list[float | str]:
    return [_representable(kind, v) for v in values]


def _by_call(given: Sequence[StartValue]) -> Iterator[tuple[str, Sequence[StartValue]]]:
    firsts = [one.group.first for one in given]
    if given and not any(v.shape or v.type != firsts[0].type for v in firsts):
        yield firsts[0].type, given
        return
    by = {id(one.group): one for one in given}
    for kind, groups in together(one.group for one in given):
        yield kind, [by[id(group)] for group in groups]


def _references(given: Sequence[StartValue]) -> tuple[int, ...]:
    return tuple(r for one in given for r in one.group.references)


class InstanceStart:
    """The start of an instance: from what is `given` to its first step. Raises FmuError.

    `again`: exact values may be set again in Initialization Mode (FMI 1.0 has none).
    """

    def __init__(
        self, x: Instance, name: str, given: Sequence[StartValue], *, again: bool = True
    ) -> None:
        by = defaultdict(list)
        for one in given:
            by[one.group.first.causality].append(one)
        self._x, self._name, self._again = x, name, again
        self._structural, self._inputs = by.pop("structuralParameter", []), by.pop("input", [])
        self._given = [one for some in by.values() for one in some]

    def enter(self, begin: float) -> None:
        """Enter Initialization Mode at `begin` (s) with everything set; numeric inputs are left to
        others.
        """
        x = self._x
        if self._structural:
            x.enter_configuration()
            set_all(x, self._structural)
            x.exit_configuration()
        x.setup(begin)
        set_all(x, self._given)
        x.enter_initialization(begin)
        if self._again:
            set_all(x, [one for one in self._given if one.exact])
        for one in self._inputs:
            if one.group.first.type in TEXTS:
                one.set(x)

    def leave(self, clocks: Clocks) -> dict[str, list[float]]:
        """Leave Initialization Mode; returns values of clocked variables that ticked then, by name.

        Values are in the FMU's units. Start values are compared just before, since an event may
        change them afterwards; parameters after it. Raises FmuError that names all that the FMU did
        not take.
        """
        exact = [one for one in self._given if one.exact]
        self._check([one for one in exact if not one.is_parameter])
        found = self._x.exit_initialization(clocks)
        self._check([*self._structural, *(one for one in exact if one.is_parameter)])
        return found

    def _check(self, given: Sequence[StartValue]) -> None:
        lines = list(_differences(self._x, given))
        if lines:
            raise FmuError(
                f"{self._name}: the FMU did not accept these values: {'; '.join(lines)}; "
                "set a value that it accepts, or leave it out"
            )


def _differences(x: Instance, given: Sequence[StartValue]) -> Iterator[str]:
    for one, found in unequal(x, given):
        what = "parameter" if one.is_parameter else "start value"
        yield (
            f"{what} {one.group.name} was set to {_written(one.values)}, after initialization "
            f"it is {_written(found)}"
        )


def _representable(kind: str, value: float | str) -> float | str:
    """A value as the FMU can hold it: Float32 rounded, a Boolean 0 or 1, Binary in lower case."""
    if kind in REAL:
        return float(value)
    if isinstance(value, str):
        return "".join(value.lower().split()) if kind == "Binary" else value
    if kind == "Float32":
        return c.c_float(value).value
    return float(value != 0.0) if kind == "Boolean" else float(value)


def _written(values: Found) -> str:
    texts = [repr(v) if isinstance(v, str) else f"{v:.17g}" for v in values]
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"
