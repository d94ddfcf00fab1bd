"""Delay lines driven by samples as a network brings them, and the tables they are held against."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from bridge.native import delay as native
from bridge.native.delay import DelayLine
from cosim.links.semantics import Grid, PacketSemantics, SignalSemantics
from cosim.links.table import DrawnTable
from cosim.links.traces import DelayTrace

MS = 1_000_000  # ns
LOOKS = 40
N = 280  # samples sent by then, at most
RULES = {
    native.SIGNAL: SignalSemantics(),
    native.LAST: PacketSemantics("last-arrival"),
    native.STAMP: PacketSemantics("newest-stamp"),
    native.FIFO: PacketSemantics("fifo"),
}
periods = st.integers(1, 7)
steps = st.sampled_from([0.005, 0.001, 0.0125, 1 / 3, 0.0007, 1e-9 * 333_333])


def line(kind, grid, delays, capacity=1024, **more):
    return DelayLine(kind, 1, grid.n_s, grid.n_r, grid.h, capacity, delays, **more)


def drive(d, grid, arrivals, looks=LOOKS, phase=0):
    """The rows held when samples come in as they arrive: (sequence, sent, arrival), ns, by arrival.

    `phase`: of the receiver's slots, ns. Values are checked: sample j carries j.
    """
    rows, coming = [], list(arrivals)
    for row in range(looks):
        now = round(row * grid.n_r * grid.h * 1e9) + phase
        while coming and coming[0][2] <= now + 1:
            j, sent, arrival = coming.pop(0)
            d.put(j, sent, arrival, [float(j)])
        rows.append(d.take(row, now))
        if rows[-1] >= 0:
            assert d.values().tolist() == [rows[-1]]
            assert d.struct.given.sequence == rows[-1]
    return rows


def sent_ns(grid, j):
    return round(j * grid.n_s * grid.h * 1e9)


def arrivals(grid, network, lost=()):
    """Every sample behind the network: (sequence, sent, arrival), by arrival; ns."""
    found = [
        (j, sent_ns(grid, j), sent_ns(grid, j) + d) for j, d in enumerate(network) if j not in lost
    ]
    return sorted(found, key=lambda a: (a[2], a[0]))


def arrived(grid, j, network, row):
    """True if sample j, for which the network takes so many ns, is there at a look."""
    return j * grid.n_s + grid.ticks(1e-9 * network) <= row * grid.n_r


def rows_of(rule, grid, T, looks=LOOKS):
    """The rows of the table for delays T, s, by look or by sample."""
    law = DelayTrace(np.arange(len(T)), np.array(T), lookup="index")
    return DrawnTable("x", grid, law, rule, 0).stream(looks).rows(looks).tolist()


@st.composite
def links(draw, losses=True):
    """A grid and delays, s, whole quarters of a tick; not a number: lost."""
    grid = Grid(draw(periods), draw(periods), draw(steps))
    longest = draw(st.sampled_from([3, 40, 400]))
    one = st.integers(0, longest)
    values = draw(st.lists(st.none() | one if losses else one, min_size=1, max_size=40))
    values = values if any(q is not None for q in values) else [draw(one)]
    values = (values * N)[:N]
    T = [np.nan if q is None else q / 4 * grid.h for q in values]
    return grid, T
