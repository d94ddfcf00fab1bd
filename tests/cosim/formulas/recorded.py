"""Rows in memory, and the requirement that a text makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cosim.measure.requirements import Requirement, requirements
from cosim.record import Column
from cosim.scenario.spec import build
from cosim.study.memory import Memory


def rows(t: Sequence[float], units: Mapping[str, str], **x: Sequence[float]) -> Memory:
    """Signals of rows at the times `t`; ``a_x`` is ``a.x``, ``a_x_1`` is ``a.x[1]``."""
    names = list(units)
    columns = [Column(name, units[name], i) for i, name in enumerate(names)]
    keys = [name.replace(".", "_").replace("[", "_").rstrip("]") for name in names]
    return Memory(columns, np.array(t, float), np.array([x[key] for key in keys], float))


def declared(units: Mapping[str, str], **tables: object) -> list[Requirement]:
    """The requirements of a scenario with these tables ``[require.NAME]``, of 100 s."""
    document = {"run": {"step": "1 s", "stop": "100 s"}, "components": {}, "require": tables}
    return requirements(build(document, "test.toml"), units)


def requirement(units: Mapping[str, str], **keys: object) -> Requirement:
    """The requirement of one table with these keys."""
    return declared(units, one=keys)[0]
