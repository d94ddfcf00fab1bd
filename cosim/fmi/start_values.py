"""Start values of one FMU as Python sets and compares them: see :mod:`cosim.fmi.start_calls`."""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator, Sequence

from cosim.base.convert import Struct
from cosim.base.errors import FmuError
from cosim.fmi.file.ports import REAL, VariableGroup, together
from cosim.fmi.file.variables import TEXTS
from cosim.fmi.library import Instance

Found = Sequence[float] | Sequence[str]


class StartValue(Struct, frozen=True):
    """A variable and what was set: numbers, or texts (Binary: hexadecimal); all scalars."""

    group: VariableGroup
    values: Found

    def set_text(self, x: Instance) -> None:
        """Set the texts of a String or Binary variable. Raises FmuError."""
        texts = [str(v) for v in self.values]
        x.set_texts(self.group.first.type, self.group.references, texts)

    def differs(self, x: Instance) -> Found | None:
        """The value that the FMU has in its place; None: the same. Raises FmuError."""
        first, references = self.group.first, self.group.references
        found: Found
        if first.type in TEXTS:
            found = x.get_texts(first.type, references, self.group.size)
        else:
            found = x.get(first.type, references, self.group.size)
        same = _all_representable(first.type, self.values) == _all_representable(first.type, found)
        return None if same else found


def is_parameter(group: VariableGroup) -> bool:
    """True if it keeps its value after the start, too."""
    return group.first.causality in ("parameter", "structuralParameter")


def is_exact(group: VariableGroup) -> bool:
    """True if an FMU has to start from the very value that is set, and not from one near it."""
    return is_parameter(group) or group.first.initial == "exact"


def set_all(x: Instance, given: Sequence[StartValue]) -> None:
    """Set values, those of one type in one call. Raises FmuError."""
    for kind, some in _by_call(given):
        if kind in TEXTS:
            for one in some:
                one.set_text(x)
        else:
            x.set(kind, _references(some), [float(v) for one in some for v in one.values])


def unequal(x: Instance, given: Sequence[StartValue]) -> Iterator[tuple[StartValue, Found]]:
    """The start values that the FMU changed, each with the FMU's; asked together, then singly."""
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
    by = {id(one.group): one for one in given}
    for kind, groups in together(one.group for one in given):
        yield kind, [by[id(group)] for group in groups]


def _references(given: Sequence[StartValue]) -> tuple[int, ...]:
    return tuple(r for one in given for r in one.group.references)


def check(name: str, x: Instance, given: Sequence[StartValue]) -> None:
    """Compare values with those that the FMU `name` has. Raises FmuError that names all others."""
    lines = list(_differences(x, given))
    if lines:
        raise FmuError(
            f"{name}: the FMU did not accept these values: {'; '.join(lines)}; "
            "set a value that it accepts, or leave it out"
        )


def _differences(x: Instance, given: Sequence[StartValue]) -> Iterator[str]:
    for one, found in unequal(x, given):
        what = "parameter" if is_parameter(one.group) else "start value"
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
