"""NumPy arrays as Arrow arrays and back, without what Arrow's own conversions import.

``pyarrow.array(ndarray)`` and ``to_numpy()`` import pandas wherever it is installed, which takes
longer than a short run; ``numpy.ma`` takes 10 ms.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {np.dtype(np.float64): "float64", np.dtype(np.int32): "int32"}


def arrow(values: NDArray[Any]) -> Any:
    """An Arrow array of `values` (n,), float64 or int32, contiguous, as they lie there."""
    import pyarrow as pa

    kind = getattr(pa, _TYPES[values.dtype])()
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(values)])


def numpy(column: Any, dtype: type[np.float64] | type[np.int32]) -> NDArray[Any]:
    """Return a copy (n,) of a column of a table in its unit, cast to `dtype` if necessary.

    Null becomes NaN; in an integer column it raises ValueError (pyarrow.ArrowInvalid).
    """
    import pyarrow as pa

    kind = getattr(pa, _TYPES[np.dtype(dtype)])()
    if column.type != kind:  # a cast imports pyarrow.compute, as long as the rest of pyarrow
        column = column.cast(kind)
    if column.null_count:
        import pyarrow.compute as pc

        if dtype is not np.float64:
            raise pa.ArrowInvalid(f"{column.null_count} values are null; expected integers")
        column = pc.fill_null(column, float("nan"))
    whole = np.empty(len(column), dtype)
    at = 0
    for chunk in column.chunks:
        first = chunk.offset * whole.itemsize
        there = np.frombuffer(chunk.buffers()[1], dtype, len(chunk), first)
        whole[at : at + len(chunk)] = there
        at += len(chunk)
    return whole
