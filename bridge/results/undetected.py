"""Comparison of the record of injected faults with the samples that receivers accepted.

The checks of a receiver must refuse a corrupted frame. Its sequence number is known, because the
record contains the original data with the counter, and the time of arrival. No such number may be
among the accepted ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.native.bus import Accept
from bridge.native.faults import CORRUPT
from bridge.native.message import Decoded, is_preview
from cosim.links.laws import IntArray

Rows = NDArray[np.void]


def corrupted_frames(rows: Rows, accept: Accept) -> Rows:
    """Return the frames (m,) of a message that were delivered corrupted; `rows` (n,): INJECTED."""
    flipped = rows["kinds"] >> CORRUPT & 1 == 1
    found: Any = rows[
        flipped & accept.among(rows) & (rows["copies"] > 0) & (rows["crc"] != rows["crc_after"])
    ]
    return found  # type: ignore[no-any-return]


def frames_of_run(rows: Rows, encoding: Codec) -> NDArray[np.bool_]:
    """A mask (rows,) of the frames that were samples of the run; the others were previews.

    Receivers count no preview, so nothing that was done to one shows in a counter.
    """
    decoded = (encoding.decode(bytes(row["data"][: row["length"]])) for row in rows)
    return np.array(
        [r is not Decoded.OK or not is_preview(encoding.message, h.status) for r, _, h in decoded],
        dtype=np.bool_,
    )


def sequences(
    rows: Rows,
    counter: Callable[[bytes], int],
    bits: int,
    period_ns: int,
    offset_ns: int = 0,
) -> IntArray:
    """The sequence number of each frame, (rows,): the last before its arrival with its counter.

    `counter`: of the data of a frame as it was, `bits` long; samples are sent every `period_ns`,
    the first at `offset_ns`. It holds for frames that took less than 2^bits periods.
    """
    span = 1 << bits
    expected = (rows["t_ns"] - offset_ns) // period_ns
    counters = [counter(bytes(row["data"][: row["length"]])) for row in rows]
    found: IntArray = expected - (expected - np.array(counters, dtype=np.int64)) % span
    return found


def undetected(corrupted: IntArray, accepted: Iterable[int]) -> list[int]:
    """Return the sequence numbers of corrupted frames that a receiver accepted, ascending.

    `corrupted`: sequence numbers (n,). A campaign passes if there are none. (A frame of which an
    intact copy was received, too, is included; scripts that corrupt and duplicate the same message
    cannot be evaluated in this way.)
    """
    return sorted(set(corrupted.tolist()) & set(accepted))
