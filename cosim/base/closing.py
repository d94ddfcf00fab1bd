"""Files that are written until they are closed, as context managers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from cosim.base.errors import RunError


class Closing(ABC):
    """Closed at the end of a ``with`` block, also after an error: what was written is kept.

    An error of :meth:`close` is raised, or, where the block has failed already, added to that
    error as a note.
    """

    @abstractmethod
    def close(self) -> None:
        """Complete what is being written. Raises RunError."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except RunError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # what stopped the run comes first
