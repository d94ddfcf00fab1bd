"""A plan's links as delay lines: the very delays that the offline table would have drawn.

A delay line gives the rows of the link's table where the network takes no time; what the network
takes comes on top (``bridge/c/delay.h``). All delays of a run are drawn before it: 8 bytes a sample
(a look, for `signal`), 29 MB for an hour at 1 kHz.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from bridge.native import delay as native
from bridge.native.delay import DelayLine
from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Constant, FloatArray
from cosim.links.semantics import (
    Grid,
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    Rule,
    SignalSemantics,
)
from cosim.links.storage import StoredTable
from cosim.links.table import DrawnTable, TableSpec
from cosim.schedule.parts import Link, Wire

#: Time that a delay line keeps samples beyond its law, s: for the network's own delay, and a
#: receiver that stood still.
MARGIN = 1.0
_ORDERS = {
    "last-arrival": native.LAST,
    "newest-stamp": native.STAMP,
    "fifo": native.FIFO,
}


@dataclass(frozen=True, slots=True, eq=False)
class DelaySpec:
    """Everything a delay line is made of.

    `kind`: of :mod:`bridge.native.delay`; `width`: values of a sample; `period`, `look`: ticks of
    `h` (s) between two samples and two looks; `delays`: s, (looks,) or (samples,); `buffer`: s, or
    the rule of a queue; `capacity`: samples kept, a power of two.
    """

    name: str
    kind: int
    width: int
    period: int
    look: int
    h: float
    delays: FloatArray
    buffer: float | QueueSemantics
    capacity: int

    def line(self, phase_ns: int = 0) -> DelayLine:
        """A new, empty line; `phase_ns`: of the receiver's slots less that of the sender's."""
        return DelayLine(
            self.kind,
            self.width,
            self.period,
            self.look,
            self.h,
            self.capacity,
            self.delays,
            self.buffer,
            phase_ns,
        )


def delays_for(link: Link, ticks: int, every: int = 1, margin: float = MARGIN) -> DelaySpec:
    """The delay line of a link for a run of `ticks` base ticks.

    `every`: hits of the sender between two messages; then the law is drawn a message, as for a
    sender that runs that much slower. `margin`: s, kept beyond what the law needs. Raises
    ScenarioError, as the offline run does, where the law or the stored table is too short.
    """
    table = link.table
    grid = Grid(table.grid.n_s * every, table.grid.n_r, table.grid.h)
    looks = -(-ticks // grid.n_r)
    buffer: float | QueueSemantics = 0.0
    if isinstance(table, DrawnTable):
        table = DrawnTable(table.name, grid, table.law, table.rule, table.seed)
        table.check(looks)
        kind, buffer = _kind(table.rule, link.name)
        delays, greatest = _drawn(table, looks), table.rule.greatest(table.law, grid)
        if isinstance(table.rule, QueueSemantics):  # which the network may fill
            full = grid.ticks(table.law.maximum) + table.rule.depth * max(grid.n_s, grid.n_r)
            greatest = min(full, ticks)
    elif isinstance(table, StoredTable):
        kind = native.SIGNAL
        delays, greatest = _stored(table, looks, grid.n_s)
    else:
        raise _unknown(f"table {type(table).__name__}", link.name)
    capacity = _capacity(grid, greatest, margin)
    width, h = link.source.size, grid.h
    return DelaySpec(link.name, kind, width, grid.n_s, grid.n_r, h, delays, buffer, capacity)


def network_delays(
    link: Link, ticks: int, sent: FloatArray, delay: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times (s) and delays (s) of the samples of a link over a network, for `ticks` ticks.

    `sent`, `delay` (n,): measured, s; NaN: lost; repeated for the duration of the run. The delay
    drawn by the link's law is added. A link with semantics `signal` evaluates its delay and loses
    nothing: there, the delay of a lost sample is interpolated between its neighbors.
    """
    spec, grid = delays_for(link, ticks), link.table.grid
    looks = spec.kind == native.SIGNAL
    period = grid.n_r if looks else grid.n_s
    n = ticks // period + 2
    t = np.arange(n) * period * grid.h
    there = ~np.isnan(delay)
    known = np.interp(sent, sent[there], delay[there]) if looks else delay
    length = sent[-1] + (sent[-1] - sent[0]) / max(len(sent) - 1, 1)
    taken = known[np.searchsorted(sent, np.mod(t, length), side="right") - 1]
    drawn = np.resize(spec.delays, n)
    drawn[len(spec.delays) :] = spec.delays[-1]
    total: FloatArray = np.where(np.isfinite(drawn), drawn, np.nan) + taken
    return t.astype(np.float64), total


def zero_delay(edge: Wire | Link, period: int, look: int, h: float) -> DelaySpec:
    """A line that adds nothing and holds the newest that came: of a wire that crosses a cut.

    `period`, `look`: ticks of `h` (s) between two samples and two looks.
    """
    name = f"{edge.source.name} -> {edge.target.name}"
    return DelaySpec(name, native.NONE, edge.source.size, period, look, h, np.empty(0), 0.0, 16)


def _kind(rule: Rule, name: str) -> tuple[int, float | QueueSemantics]:
    """The kind and the buffer (s, or the queue) of a semantics."""
    match rule:
        case SignalSemantics():
            return native.SIGNAL, 0.0
        case PacketSemantics(order):
            return _ORDERS[order], 0.0
        case PlayoutSemantics(buffer):
            return native.PLAYOUT, buffer
        case QueueSemantics():
            return native.QUEUE, rule
    raise _unknown(f"semantics {type(rule).__name__}", name)


def _unknown(what: str, name: str) -> ScenarioError:
    return ScenarioError(
        f"{what} has no delay line; expected a drawn or stored table of cosim.links", name
    )


def _drawn(table: DrawnTable, looks: int) -> FloatArray:
    """The delays a run of so many looks asks for, s; one for all where they are constant."""
    if isinstance(table.law, Constant):
        return np.array([table.law.delay])
    period, asked = table.rule.asks(table.grid, looks)
    drawn = table.law.stream(period, generator(table.seed, table.name)).take(asked)
    drawn.flags.writeable = False
    return drawn


def _stored(table: TableSpec, looks: int, period: int) -> tuple[FloatArray, int]:
    """The ages (s) of a stored table's rows as delays at reception, and the greatest in ticks.

    A row that holds nothing yet is as old as a sample `period` ticks before the first.
    """
    grid = table.grid
    held = table.stream(looks).rows(looks).astype(np.int64)
    sent = np.where(held < 0, -period, grid.n_s * held)
    age = grid.n_r * np.arange(looks, dtype=np.int64) - sent
    seconds: FloatArray = age.astype(np.float64) * grid.h
    return seconds, int(age[held >= 0].max(initial=0))


def _capacity(grid: Grid, greatest: int, margin: float) -> int:
    """Samples sent within `greatest` ticks and `margin` (s), to the next power of two."""
    samples = (greatest + ceil(margin / grid.h)) // grid.n_s + 2
    return 1 << (samples - 1).bit_length()
