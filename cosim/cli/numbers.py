"""Numbers on the command line: the same rule as in files (:mod:`cosim.base.toml`)."""

from __future__ import annotations

import typer

from cosim.base.toml import EXPECTED, is_usable_number


def finite(value: float | None) -> float | None:
    """The callback of a numeric option, in the unit its help gives. Raises BadParameter."""
    if value is not None and not is_usable_number(value):
        raise typer.BadParameter(f"found {value!r}; expected {EXPECTED}")
    return value
