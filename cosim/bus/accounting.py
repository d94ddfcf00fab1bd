"""What became of requests on a simulated bus: response times and losses of each identifier."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.bus.frames import BusEvent, DropCause


class IdentifierAccount(NamedTuple):
    """An identifier's frames: how many were sent, and how long they took, ps.

    `mean` and `worst` are from the request to the end of EOF, `worst_queueing` from the request to
    the start of the attempt that succeeded. `errors`: attempts that failed. `lost`: how many
    requests were dropped, by cause.
    """

    identifier: int
    extended: bool
    sent: int
    mean: float
    worst: int
    worst_queueing: int
    errors: int
    lost: dict[DropCause, int]


def accounts(
    requests: NDArray[np.void], events: NDArray[np.void], first: int = 0
) -> list[IdentifierAccount]:
    """The account of each identifier, by identifier.

    `requests`: rows of ``REQUEST``, shape (n,), in the order in which they were made; `first`: the
    number of the first. `events`: all events since, shape (m,), with STARTED, SENT, ERROR and
    DROPPED recorded. Times in ps.
    """
    events = events[(events["request"] >= first) & (events["request"] < first + len(requests))]
    begun, ended = (np.full(len(requests), -1, np.int64) for _ in range(2))
    for kind, times in ((BusEvent.STARTED, begun), (BusEvent.SENT, ended)):
        rows = events[events["kind"] == kind]
        times[rows["request"] - first] = rows["time"]  # of several, the last
    failed = events[(events["kind"] == BusEvent.ERROR) & (events["role"] & 2 != 0)]
    errors = np.bincount(failed["request"] - first, minlength=len(requests))
    dropped = events[events["kind"] == BusEvent.DROPPED]
    dropped = dropped[dropped["code"] != DropCause.RECEIVE_OVERFLOW]
    extended = requests["frame"]["flags"] & 16 != 0
    key = requests["frame"]["id"].astype(np.int64) << 1 | extended
    found = []
    for value in np.unique(key).tolist():
        mine = key == value
        sent = mine & (ended >= 0)
        response = (ended - requests["at"])[sent]
        causes = dropped["code"][mine[dropped["request"] - first]]
        found.append(
            IdentifierAccount(
                identifier=value >> 1,
                extended=bool(value & 1),
                sent=int(sent.sum()),
                mean=float(response.mean()) if len(response) else 0.0,
                worst=int(response.max(initial=0)),
                worst_queueing=int((begun - requests["at"])[sent].max(initial=0)),
                errors=int(errors[mine].sum()),
                lost={c: int((causes == c).sum()) for c in DropCause if (causes == c).any()},
            )
        )
    return found
