"""The table of a link by its keys, as a scenario has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base.convert import convert
from cosim.links.semantics import Grid
from cosim.links.spec import link_table
from cosim.links.table import TableSpec
from cosim.scenario.spec import LinkSpec


def table_of(
    *, name: str = "x", seed: int = 0, h: float = 0.005, sender_period: int = 1,
    receiver_period: int = 1, folder: Path | None = None, ticks: int | None = None, **keys: Any,
) -> TableSpec:  # fmt: skip
    given = {key: value for key, value in keys.items() if value is not None}
    link = convert({"from": "a.x", "to": "b.x", **given}, LinkSpec, Path("s.toml"))
    grid = Grid(sender_period, receiver_period, h)
    return link_table(link, name, seed, grid, folder or Path(), ticks)
