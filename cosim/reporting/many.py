"""Many robots in a report: quantiles in place of their lines, and the first ones of a list."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Most lines of a diagram; of more, quantiles over them are drawn.
LINES = 24
#: Most signals that a page lets choose from, arms that move, links and rows of its tables.
SIGNALS, ARMS, LINKS, ROWS = 400, 12, 24, 100
#: Links whose ages are drawn if there are more links than are listed.
AGES = 4
#: Names of quantiles, and which they are.
QUANTILES = (
    ("greatest", 1.0), ("90 %", 0.9), ("median", 0.5), ("10 %", 0.1), ("least", 0.0),
)  # fmt: skip


def quantile_lines(values: Array) -> list[tuple[str, Array]]:
    """Names and quantiles over the columns of `values` (n, m) at each row, (n,), in their unit.

    A value that is not finite counts as missing; a row of these only is NaN.
    """
    known = np.where(np.isfinite(values), values, np.nan)
    found = np.full((len(QUANTILES), len(values)), np.nan)
    rows = np.isfinite(known).any(axis=1)
    found[:, rows] = np.nanquantile(known[rows], [q for _, q in QUANTILES], axis=1)
    return [(name, line) for (name, _), line in zip(QUANTILES, found, strict=True)]


def further(total: int, shown: int, what: str) -> str:
    """A paragraph (HTML) about those that are not shown; empty if there are none."""
    if total <= shown:
        return ""
    return f"<p>{total - shown} further {what} are in the run folder only.</p>"
