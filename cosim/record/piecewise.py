"""Numbers of recorded signals that are read in pieces, the same to the bit as of whole columns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import inf
from typing import Generic, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError, ScenarioError
from cosim.base.units import parse
from cosim.record.run import Run
from cosim.record.signals import Array, Signals, Stack, stack

#: Numbers that are added up by one call of NumPy.
LEAF = 1 << 13


def pieces(signals: Signals, names: Sequence[str], since: float = -inf) -> Iterator[Signals]:
    """The rows of signals in order; those of a long run in pieces: :meth:`Run.pieces`.

    Rows before the time `since`, s, may be left out.
    """
    if isinstance(signals, Run):
        yield from signals.pieces(names, since)
    else:
        yield signals


T = TypeVar("T")


@final
class Repeated(Generic[T]):
    """Pieces that can be iterated over more than once: `read` begins anew each time."""

    def __init__(self, read: Callable[[], Iterable[T]]) -> None:
        self._read = read

    def __iter__(self) -> Iterator[T]:
        """The pieces."""
        return iter(self._read())


@final
class PairwiseSum:
    """The sum of `count` numbers that come in pieces, as NumPy adds them in one array.

    NumPy adds the two halves of an array, of which the first is a multiple of 8 long, and so on
    down to 128 numbers (``DOUBLE_pairwise_sum``). So the rounding error grows with log n, and the
    result does not depend on the pieces.

    Source: N. J. Higham, The accuracy of floating point summation, SIAM J. Sci. Comput. 14(4),
    1993.
    """

    def __init__(self, count: int) -> None:
        self._parts = _halves(count)
        self._sums: list[float] = []
        self._part: list[Array] = []
        self._left = 0
        self._next()

    def _next(self) -> None:
        """Join finished halves, and take the length of the next part."""
        self._left = 0
        for size in self._parts:
            if size >= 0:
                self._left = size
                break
            last = self._sums.pop()
            self._sums[-1] += last

    def add(self, x: Array) -> None:
        """Take the next numbers, (n,), in one unit."""
        while len(x):
            self._part.append(x[: self._left])
            self._left -= len(self._part[-1])
            x = x[len(self._part[-1]) :]
            if not self._left:
                whole = self._part[0] if len(self._part) == 1 else np.concatenate(self._part)
                self._sums.append(float(np.add.reduce(np.ascontiguousarray(whole))))
                self._part = []
                self._next()
        if self._part:
            self._part[-1] = self._part[-1].copy()  # its memory is that of a whole piece

    @property
    def value(self) -> float:
        """The sum, when all numbers were added, in their unit."""
        return self._sums[0] if self._sums else 0.0


def _halves(count: int) -> Iterator[int]:
    """Lengths of the parts of a sum, in order, and -1 where the last two sums are added."""
    if count <= LEAF:
        yield count
        return
    half = count // 2
    half -= half % 8
    yield from _halves(half)
    yield from _halves(count - half)
    yield -1


@final
class Trapezoids:
    """∫ y dt over `rows` recorded rows, by trapezoids; `y`, `t` (n,), s, come in pieces."""

    def __init__(self, rows: int) -> None:
        self._sum = PairwiseSum(max(0, rows - 1))
        self._y = self._t = np.empty(0)

    def add(self, y: Array, t: Array) -> None:
        """Take the next rows."""
        if len(self._y):
            y, t = np.concatenate((self._y, y)), np.concatenate((self._t, t))
        self._sum.add((t[1:] - t[:-1]) * (y[1:] + y[:-1]))
        self._y, self._t = y[-1:], t[-1:]

    @property
    def value(self) -> float:
        """The integral, in the unit of `y` times s."""
        return 0.5 * self._sum.value


@final
class RunningIntegral:
    """∫ y dt from the first row on, by trapezoids, of rows that come in pieces; `value`: so far."""

    def __init__(self) -> None:
        self.value = 0.0
        self._y = self._t = np.empty(0)

    def add(self, y: Array, t: Array) -> Array:
        """Take the next rows (n,), `t` in s, and return the integral until each, (n,)."""
        y, t = np.concatenate((self._y, y)), np.concatenate((self._t, t))
        steps = np.diff(t) * (y[1:] + y[:-1]) / 2
        found = np.cumsum(np.concatenate(([self.value], steps)))[len(self._y) :]
        self._y, self._t, self.value = y[-1:], t[-1:], float(found[-1])
        return found


class NotFinite(Exception):
    """Signals of which there is no number; the message is the reason, a sentence."""


@final
class Stacked:
    """Signals side by side that are read in pieces, any number of times.

    `unit`, `names` (m,) of the columns, `rows`: how many there are, `first`, `last`: their times,
    s. Raises ScenarioError at `place` for signals that were not recorded or differ in their units.
    """

    def __init__(self, signals: Signals, of: Sequence[str], place: str) -> None:
        self._signals, self._of, self._place = signals, tuple(of), place
        try:
            self.names = tuple(entry for name in of for entry in signals.entries(name))
            units = [signals.unit(name) for name in of]
            for name, unit in zip(of, units, strict=True):
                if parse(unit) != parse(units[0]):
                    raise ScenarioError(f"{of[0]} is in [{units[0]}] but {name} is in [{unit}]")
        except CosimError as error:
            raise ScenarioError(str(error), place) from error
        self.unit = units[0]
        self.rows, self.first, self.last = extent(signals)

    def __iter__(self) -> Iterator[Stack]:
        """Stacks of finite numbers, one at least. Raises NotFinite."""
        return self.since(-inf)

    def since(self, time: float) -> Iterator[Stack]:
        """Stacks with all rows from a time on, s. Raises NotFinite."""
        for piece in pieces(self._signals, self._of, time):
            found = stack(piece, self._of, self._place)
            if found.problem:
                raise NotFinite(found.problem)
            yield found


def extent(signals: Signals) -> tuple[int, float, float]:
    """The number of rows, and the times of the first and the last one, s, NaN where none is."""
    if isinstance(signals, Run):
        return len(signals), *(signals.span if len(signals) else (np.nan, np.nan))
    t = np.asarray(signals.t, dtype=np.float64)
    return len(t), *((float(t[0]), float(t[-1])) if len(t) else (np.nan, np.nan))


@final
class AtTimes:
    """Values at times `t` (m,), ascending, between rows that come in pieces on a line.

    `values` (m,): before the first row and after the last one those there.
    """

    def __init__(self, t: Array) -> None:
        self.values = np.empty(len(t))
        self._times, self._done = t, 0
        self._t = self._x = np.empty(0)

    def add(self, t: Array, x: Array) -> None:
        """Take the next rows, (n,): `t` as the times, `x` in one unit."""
        if not len(t):
            return
        t, x = np.concatenate((self._t, t)), np.concatenate((self._x, x))
        ready = int(np.searchsorted(self._times, t[-1], side="right"))
        self.values[self._done : ready] = np.interp(self._times[self._done : ready], t, x)
        self.values[ready:] = x[-1]
        self._t, self._x, self._done = t[-1:].copy(), x[-1:].copy(), max(self._done, ready)


def at_times(run: Run, names: Sequence[str], t: Array) -> dict[str, Array]:
    """Scalars at the times `t` (m,), s, ascending, by name: (m,) each, as :class:`AtTimes`."""
    found = {name: AtTimes(t) for name in names}
    for piece in run.pieces(names) if names else ():
        for name, values in found.items():
            values.add(piece.t, piece.column(name))
    return {name: values.values for name, values in found.items()}


def first_step(run: Run, default: float) -> float:
    """The time between the first two rows, s, or `default`, where there is none."""
    first = next(run.pieces(())).t[:2]
    return float(first[1] - first[0]) if len(first) > 1 else default


@final
class RunRows:
    """Some rows of a run, chosen by their numbers, as signals.

    `t` (n,), s, and the scalars `names`, in their units.
    """

    def __init__(self, run: Run, names: Sequence[str], rows: NDArray[np.intp]) -> None:
        self._run, at = run, 0
        found: dict[str, list[Array]] = {name: [] for name in ("t", *names)}
        for piece in run.pieces(names):
            chosen = rows[slice(*np.searchsorted(rows, (at, at + len(piece.t))))] - at
            for name, values in found.items():
                values.append((piece.t if name == "t" else piece.column(name))[chosen])
            at += len(piece.t)
        self._columns = {name: np.concatenate(values) for name, values in found.items()}

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s."""
        return self._columns["t"]

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        return np.stack([self._columns[name] for name in self.entries(prefix)], axis=1)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries."""
        return self._run.entries(prefix)

    def unit(self, prefix: str) -> str:
        """Unit of a signal. Raises ScenarioError if its entries differ in it."""
        return self._run.unit(prefix)


def rows_at(run: Run, t: Array) -> NDArray[np.intp]:
    """The first rows from the times `t` (m,), s, ascending, on, each once; those that there are."""
    found, at, done = list[NDArray[np.intp]](), 0, 0
    for piece in run.pieces(()):
        ready = int(np.searchsorted(t, piece.t[-1], side="right"))
        found.append(at + np.searchsorted(piece.t, t[done:ready]))
        at, done = at + len(piece.t), max(done, ready)
    return np.unique(np.concatenate(found))
