"""Garbage collection while tests run: what pytest has collected is not looked at again."""

from __future__ import annotations

import gc

#: Python's own, which `freeze_tests` replaces.
unfreeze = gc.unfreeze


def freeze_tests() -> None:
    """Set aside all objects there are, until the process ends.

    A node that freezes its objects thaws all objects at its end; these ones stay frozen.
    """
    gc.collect()
    gc.freeze()
    gc.unfreeze = lambda: None
