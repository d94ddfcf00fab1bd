"""Pipe or event on which a sending thread sleeps until C writes to it."""

from __future__ import annotations

import os
import sys
from typing import final


@final
class Wake:
    """A descriptor to write 8 bytes to (`inn`), and one to read from (`out`): eventfd or pipe."""

    def __init__(self) -> None:
        if sys.platform == "linux":
            self.out = self.inn = os.eventfd(0, os.EFD_CLOEXEC)
        else:
            self.out, self.inn = os.pipe()
            os.set_blocking(self.inn, False)

    def set(self) -> None:
        """End the wait."""
        os.write(self.inn, (1).to_bytes(8, sys.byteorder))

    def close(self) -> None:
        """Close the descriptors."""
        for descriptor in {self.out, self.inn}:
            os.close(descriptor)
