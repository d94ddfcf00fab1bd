"""The digest of a run: equal where all recorded numbers are, to the last bit."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from cosim.record.run import Run


def digest(run: Run) -> str:
    """SHA-256 of the times (s) and all recorded columns, as a hexadecimal number.

    Each is its name, a zero byte, and its numbers (float64, little-endian). What is not a number
    has the bits of :data:`numpy.nan`, since processors differ in these.
    """
    found = sha256()
    for name in ("t", *run.names):
        found.update(f"{name}\0".encode())
        for piece in run.pieces([name]):
            values = np.ascontiguousarray(piece.column(name), "<f8")
            missing = np.isnan(values)
            if missing.any():
                values = np.where(missing, np.nan, values)
            found.update(values.data)
    return found.hexdigest()
