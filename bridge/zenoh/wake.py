"""What a sending thread sleeps on until C writes to it."""

from __future__ import annotations

import os
import sys
from typing import final


@final
class Wake:
    """A descriptor to write to (`inn`, 8 bytes) and a wait for it: an eventfd, or a pipe."""

    def __init__(self) -> None:
        if sys.platform == "linux":
            self._out = self.inn = os.eventfd(0, os.EFD_CLOEXEC)
        else:
            self._out, self.inn = os.pipe()
            os.set_blocking(self.inn, False)

    def wait(self) -> None:
        """Until somebody has written since the last wait."""
        os.read(self._out, 65536)

    def set(self) -> None:
        """End the wait."""
        os.write(self.inn, (1).to_bytes(8, sys.byteorder))

    def close(self) -> None:
        """Close the descriptors."""
        for descriptor in {self._out, self.inn}:
            os.close(descriptor)
