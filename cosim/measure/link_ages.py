"""Ages of what the receiver of a link held, from the link's stored table."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.links.storage import load_table
from cosim.record.signals import Array


@dataclass(frozen=True, slots=True)
class LinkAges:
    """Ages `age` (n,), s, at the steps of a receiver, `period` s apart; NaN: it held nothing yet.

    `sent` (n,): the number of the sample held; -1: none.
    """

    age: Array
    period: float
    sent: NDArray[Any]

    @property
    def waited(self) -> Array:
        """The ages (n,), s; before the first sample came, the time that the link has existed."""
        return np.where(np.isnan(self.age), np.arange(self.age.size) * self.period, self.age)


def link_ages(path: Path) -> LinkAges:
    """The ages in a stored table of a link. Raises ScenarioError for another file."""
    facts, rows = load_table(path)
    sent = rows.astype(np.int64)
    period = facts["receiver_period"]
    ticks = np.arange(sent.size) * period - sent * facts["sender_period"]
    return LinkAges(np.where(sent >= 0, ticks * facts["h"], nan), period * facts["h"], sent)
