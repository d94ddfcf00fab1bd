"""Times at which nodes sent the frames that feed the watchdogs of drives, by their own logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.native.frame import Flags
from bridge.native.journal import Journal


def sent_times(log: Path, identifier: int) -> NDArray[np.int64]:
    """The times (n,) at which a node sent the frames of an identifier, ns."""
    frames = Journal.open(log)
    own = frames[(frames["flags"] & Flags.SENT != 0) & (frames["id"] == identifier)]
    return own["t_ns"].astype(np.int64)


def longest_gap(times: NDArray[np.int64]) -> float:
    """The longest time between two of these (n,), ns; 0: there are fewer than two."""
    return float(np.diff(times).max(initial=0))
