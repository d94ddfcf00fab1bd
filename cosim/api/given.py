"""Components that a program gives as Python objects: ``cosim.api.given:NAME`` in a scenario.

A scenario refers to a model by a text. :func:`name_of` keeps an object under a name of its own in
this module, where the loader finds it as it finds the attribute of any module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def name_of(maker: Callable[..., Any]) -> str:
    """The model name of a class or function that makes a component: one for each object."""
    kept = globals()
    for name, value in kept.items():
        if value is maker:
            return f"{__name__}:{name}"
    stem = "".join(c if c.isalnum() else "_" for c in getattr(maker, "__name__", "component"))
    name, n = f"given_{stem}", 1
    while name in kept:
        n += 1
        name = f"given_{stem}_{n}"
    kept[name] = maker
    return f"{__name__}:{name}"
