"""Formulas on rows that are read in pieces, against the same rows at once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.formulas.in_pieces import LongTrace
from cosim.formulas.terms import Lookup
from cosim.formulas.trace import RecordedTrace
from cosim.formulas.windows import Array
from tests.cosim.formulas import texts
from tests.cosim.formulas.recorded import requirement

UNITS = {"a.x": "m", "b.x": "m"}


def in_pieces(
    t: Array, x: dict[str, Array], cuts: Sequence[int], end: float, beyond: int | None
) -> LongTrace:
    """The rows as a trace whose pieces begin at `cuts`."""
    edges = sorted({0, len(t), *(cut for cut in cuts if cut < len(t))})
    step = float(t[-1] - t[0]) / max(1, len(t) - 1)

    def pieces(names: Sequence[str], since: float) -> Iterator[tuple[Array, Lookup]]:
        for first, last in reversed(list(pairwise(edges))):
            if t[last - 1] < since:
                return
            part = {name: x[name][None, first:last] for name in names}
            yield t[first:last], part.__getitem__

    return LongTrace(pieces, len(t), float(t[0]), end, beyond, step)


@settings(max_examples=300, deadline=None)
@given(
    st.data(), texts.formulas(), st.lists(st.integers(1, 3), min_size=1, max_size=14),
    st.lists(st.integers(1, 14), max_size=6), st.sampled_from([0.0, 3.0]),
    st.sampled_from([None, 1, -1]),
)  # fmt: skip
def test_value_and_row_do_not_depend_on_pieces(
    data: st.DataObject, text: str, steps: list[int], cuts: list[int], later: float,
    beyond: int | None,
) -> None:  # fmt: skip
    t = np.cumsum([0, *steps], dtype=np.float64)
    x = {name: np.array(data.draw(texts.values(len(t))), float) for name in texts.SIGNALS}
    formula = requirement(UNITS, formula=text).formula
    whole = RecordedTrace(t, lambda name: x[name][None], t[-1] + later, beyond)
    found = in_pieces(t, x, cuts, t[-1] + later, beyond)
    assert found.at_first(formula) == whole.at_first(formula)
    assert found.decisive(formula) == whole.decisive(formula)


@pytest.mark.parametrize(
    "text",
    [
        "always eventually within 5 s a.x >= 0.9 m",
        "eventually always abs(a.x) <= 2 m",
        "always (b.x <= 2 m until within [1 s, 3 s] a.x >= 0.5 m)",
        "b.x <= 2 m until always after 2 s a.x >= -2 m",
    ],
)
def test_memory_does_not_grow_with_the_rows(text: str) -> None:
    formula = requirement(UNITS, formula=text).formula
    peaks = []
    for rows in (20_000, 200_000):
        t = np.arange(rows) * 0.01
        x = {"a.x": np.sin(t), "b.x": np.cos(t)}
        trace = in_pieces(t, x, range(0, rows, 4000), t[-1], None)
        tracemalloc.start()
        assert abs(trace.at_first(formula)) < inf and trace.decisive(formula) is not None
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0] < 8e6
