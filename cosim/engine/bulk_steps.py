"""Ticks that can be run as one: those within which nothing but steps of a tick is due."""

from __future__ import annotations

import numpy as np

from cosim.engine.arrays import ranges, rows_of
from cosim.engine.binding import Binding
from cosim.native.enums import Code

#: What only hands on values that nothing changes in between.
HELD = (Code.COPY, Code.SCALE)


def stride(bound: Binding) -> int:
    """The number of ticks that can be run as one, from a multiple of it to the next; 1: none.

    Components that are stepped in each tick are stepped so often one after the other. So nothing
    else may come behind their steps in a tick, or read what they give before the next stride.
    """
    plan, units = bound.plan, rows_of(bound.units)
    rows = bound.operations[: len(plan.operations)]
    longer = np.unique(rows["period"][rows["period"] > 1])
    found = int(np.gcd.reduce(np.r_[bound.state.every, longer]))
    if found == 1 or any(op.first for op in plan.operations):
        return 1
    each = rows["period"] == 1
    step = each & (rows["code"] == Code.STEP)
    step[step] = units["steps"][rows["index"][step]] > 0
    first = int(np.argmax(step)) if step.any() else len(rows)
    others = rows[:first][each[:first] & (rows["code"][:first] != Code.RECORD)]
    if not step[first:].all() or not np.isin(others["code"], HELD).all():
        return 1
    given = np.zeros(plan.n_signals, dtype=bool)
    often = units[units["period"] == 1]
    given[ranges(often["output"], often["output_count"])] = True
    return 1 if given[ranges(others["source"], others["count"])].any() else found
