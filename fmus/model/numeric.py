"""NumPy for the laws of models, imported when the first law is evaluated.

Declarations are read without it, because an installation builds the FMUs without NumPy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
else:
    Array = Any

    class _NumPy:
        """Gives what NumPy has, and keeps it."""

        def __getattr__(self, name: str) -> object:
            import numpy

            found = getattr(numpy, name)
            setattr(self, name, found)
            return found

    np = _NumPy()

__all__ = ["Array", "np"]
