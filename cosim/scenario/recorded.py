"""Run -> table, table -> run: a plan over the links of a recorded run.

For any kind of run (engine, twin, rehearsal over a network), a link is a table of the samples that
its receiver held. The same scenario, or another controller, can therefore receive the same samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.links.semantics import Grid
from cosim.links.spec import QUEUE_KEYS, link_table
from cosim.links.storage import StoredTable, load_table, open_table
from cosim.links.table import TableSpec
from cosim.record.folder import read_metadata
from cosim.record.recover import stored_tables
from cosim.scenario.spec import LinkSpec
from cosim.schedule.parts import Link, Player
from cosim.schedule.plan import Plan, compile_plan


def with_recorded_links(plan: Plan, run: str | Path, players: Iterable[Player] = ()) -> Plan:
    """The plan with the stored tables of the run folder `run` in place of its links' laws.

    `players`: further inputs that are fed from what was recorded. Raises ScenarioError where the
    run has no table for a link, one of other periods, or one that is too short. The tables of a run
    that stopped before its end are continued by their laws up to there.
    """
    run = Path(run)
    if not run.is_dir():
        raise ScenarioError("there is no such run folder", str(run))
    files = stored_tables(run)
    facts, links = read_metadata(run), []
    begun = int(facts.get("ticks") or 0) if facts.get("status") == "stopped" else 0
    for link in plan.links:
        if link.name not in files:
            found = ", ".join(files) or "none"
            raise ScenarioError(
                f"no table of the link {link.name!r} in this run; it has: {found}", str(run)
            )
        table = _table(link, files[link.name], plan.ticks, plan.ticks <= begun)
        links.append(replace(link, table=table))
    order = plan.later if plan.algorithm == "gauss-seidel" else ()
    of_buses = {gate.name for bus in plan.buses for gate in bus.gates}  # the tables replace them
    return compile_plan(
        plan.h, plan.ticks, plan.components, plan.wires, links, plan.algorithm,
        [*plan.players, *players], order, [g for g in plan.gates if g.name not in of_buses],
        adaptive=plan.adaptive, start=plan.start,
    )  # fmt: skip


def _table(link: Link, path: Path, ticks: int, stopped: bool) -> TableSpec:
    """The stored table of a link; of a run that `stopped`, its continuation if that is needed."""
    grid: Grid = link.table.grid
    table = open_table(path, name=link.table.name, grid=grid)
    rows = -(-ticks // grid.n_r)
    if rows <= table.length:
        return table
    continued = _continued(table) if stopped else None
    if continued is None:
        raise ScenarioError(
            f"the table ends at {table.length * grid.n_r * grid.h:g} s, the run at "
            f"{ticks * grid.h:g} s; expected a run.stop that is no later",
            str(path),
        )
    return continued


def _continued(stored: StoredTable) -> TableSpec | None:
    """The table of the law and seed of a stored one, None if it does not begin like that."""
    facts, rows = load_table(stored.path)
    delay, loss = {**(facts.get("delay") or {})}, None
    queue: dict[str, Any] = {key: facts.get(key) for key in QUEUE_KEYS}
    if delay.get("law") != "sum":
        loss = delay.pop("loss", None)
    try:
        keys = LinkSpec(
            source="", target="", delay=delay, loss=loss, semantics=facts["semantics"],
            playout=facts.get("playout"), **queue,
        )  # fmt: skip
        table = link_table(keys, facts["name"], facts["seed"], stored.grid, Path())
        same = np.array_equal(table.stream().rows(len(rows)), rows)
    except (KeyError, CosimError):
        return None
    return table if same else None
