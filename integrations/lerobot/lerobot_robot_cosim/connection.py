"""The two directions of a connection, without LeRobot: what is pushed, and what is held at a look.

In one process a direction is a link of cosim: its table says which sample is held at each look, so
the same file or law gives the same bits in every run, however long the loop really takes. The
directions of a pair have a name in common, by which both plug-ins find them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

from cosim.base.convert import number
from cosim.base.errors import ScenarioError
from cosim.base.toml import parse
from cosim.links.keys import Drop, Semantics, Take
from cosim.links.semantics import Grid
from cosim.links.spec import link_table
from cosim.links.storage import write_groups
from cosim.links.table import TableStream


@dataclass(frozen=True, slots=True)
class Held:
    """The sample that a receiver holds: `values`, None: nothing yet.

    `sequence`: the number of the sample, from 0; -1: none. `age`: since it was sent, s; `delay`:
    from then until it was held first, s; both nan if there is none.
    """

    values: tuple[float, ...] | None = None
    sequence: int = -1
    age: float = float("nan")
    delay: float = float("nan")


class Direction(Protocol):
    """One direction of a connection, used once in each cycle of the loop at each end."""

    def push(self, values: Sequence[float]) -> None:
        """Send a sample."""

    def pull(self) -> Held:
        """The sample that is held now."""

    def close(self) -> None:
        """Release what it has open."""


@dataclass(frozen=True, slots=True)
class LinkOptions:
    """The delay of one direction.

    `delay`: a file with measured delays (CSV or Parquet: t_send, delay), a link table of a run, or
    a law as in a scenario, ``{ law = "gamma", shift = "20 ms", ... }``, or a time, ``"150 ms"``.
    `loss`: a model of losses as in a scenario. `semantics`: the rule of the receiver.
    """

    delay: str = "0 s"
    loss: str = ""
    semantics: Semantics = "newest-stamp"
    playout: float | None = None
    depth: int | None = None
    drop: Drop | None = None
    take: Take | None = None


@dataclass(frozen=True, slots=True)
class _LinkKeys:
    """The keys of a link of a scenario."""

    delay: dict[str, Any]
    loss: dict[str, Any] | None
    semantics: Semantics
    playout: float | None
    depth: int | None
    drop: Drop | None
    take: Take | None


class TableDirection:
    """A direction whose delays are a table, in cycles of `fps` (1/s). Raises ScenarioError.

    `name` and `seed` determine the random numbers of a law.
    """

    def __init__(self, name: str, options: LinkOptions, fps: int, seed: int = 0) -> None:
        self._period = 1.0 / fps
        grid = Grid(1, 1, self._period)
        table = link_table(_keys(options, name), name, seed, grid, Path())
        self._stream: TableStream = table.stream()
        self._facts = table.facts()
        self._sent: list[tuple[float, ...]] = []
        self.rows: list[int] = []  # held at each look
        self._last = Held()

    def push(self, values: Sequence[float]) -> None:
        """Send a sample."""
        self._sent.append(tuple(values))

    def pull(self) -> Held:
        """The sample that is held now. Raises ScenarioError if it was not pushed before the look.

        Raises RunError at the end of a file of delays.
        """
        look = len(self.rows)
        row = int(self._stream.rows(1)[0])
        if row >= len(self._sent):
            raise ScenarioError(
                f"cycle {look} holds sample {row}, and {len(self._sent)} were pushed; expected a "
                "push before it in each cycle, or a delay of at least one cycle"
            )
        self.rows.append(row)
        if row < 0:
            return self._last
        age = float(Fraction(look - row) * Fraction(self._period).limit_denominator(10**6))
        delay = age if row != self._last.sequence else self._last.delay
        self._last = Held(self._sent[row], row, age, delay)
        return self._last

    def save(self, path: Path) -> None:
        """Write the rows so far as a link table, which another connection or scenario repeats."""
        import numpy as np

        write_groups(path, self._facts, [np.array(self.rows, np.int32)])

    def close(self) -> None:
        """It has nothing open."""


def _keys(options: LinkOptions, place: str) -> _LinkKeys:
    """The keys of a link for the options. Raises ScenarioError."""
    loss = _law(options.loss, f"{place}.loss") if options.loss else None
    o = options
    delay = _delay(o.delay, place)
    return _LinkKeys(delay, loss, o.semantics, o.playout, o.depth, o.drop, o.take)


def _delay(text: str, place: str) -> dict[str, Any]:
    if text.lstrip().startswith("{"):
        return _law(text, f"{place}.delay")
    path = Path(text).expanduser()
    if path.suffix in (".csv", ".parquet"):
        if not path.is_file():
            raise ScenarioError("no such file", str(path))
        return {"law": "table" if _is_table(path) else "trace", "file": str(path.resolve())}
    return {"law": "constant", "delay": number(text, "s", f"{place}.delay")}


def _is_table(path: Path) -> bool:
    if path.suffix != ".parquet":
        return False
    import pyarrow.parquet as pq

    return "sent" in pq.read_schema(path).names


def _law(text: str, place: str) -> dict[str, Any]:
    found: dict[str, Any] = parse(f"law = {text}", place)["law"]
    return found


@dataclass(slots=True)
class Connection:
    """The two directions of a pair, and the names of the numbers in their samples."""

    there: Direction
    back: Direction
    users: int = 0
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def close(self) -> None:
        """Close both directions."""
        self.there.close()
        self.back.close()


_OPEN: dict[str, Connection] = {}


def opened(name: str, fps: int, there: LinkOptions, back: LinkOptions, seed: int) -> Connection:
    """The connection of a name in this process, opened by the first of its two users."""
    found = _OPEN.get(name)
    if found is None:
        found = _OPEN[name] = Connection(
            TableDirection(f"{name}.there", there, fps, seed),
            TableDirection(f"{name}.back", back, fps, seed),
        )
    found.users += 1
    return found


def closed(name: str, connection: Connection) -> None:
    """One user less; the last one closes the directions."""
    connection.users -= 1
    if connection.users <= 0:
        connection.close()
        if _OPEN.get(name) is connection:
            del _OPEN[name]
