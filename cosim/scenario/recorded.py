"""Run -> table, table -> run: a plan over the links of a recorded run.

For any kind of run (engine, twin, rehearsal over a network), a link is a table of the samples that
its receiver held. The same scenario, or another controller, can therefore receive the same samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cosim.base.convert import replace
from cosim.base.errors import ScenarioError
from cosim.links.semantics import Grid
from cosim.links.storage import StoredTable, open_table
from cosim.record.recover import stored_tables
from cosim.schedule.parts import Link, Player
from cosim.schedule.plan import Plan, compile_plan


def with_recorded_links(plan: Plan, run: str | Path, players: Iterable[Player] = ()) -> Plan:
    """The plan with the stored tables of the run folder `run` in place of its links' laws.

    `players`: further inputs that are fed from what was recorded. Raises ScenarioError where the
    run has no table for a link, one of other periods, or one that is too short.
    """
    run = Path(run)
    if not run.is_dir():
        raise ScenarioError("there is no such run folder", str(run))
    files = stored_tables(run)
    links = []
    for link in plan.links:
        if link.name not in files:
            found = ", ".join(files) or "none"
            raise ScenarioError(
                f"no table of the link {link.name!r} in this run; it has: {found}", str(run)
            )
        links.append(replace(link, table=_table(link, files[link.name], plan.ticks)))
    order = plan.later if plan.algorithm == "gauss-seidel" else ()
    of_buses = {gate.name for bus in plan.buses for gate in bus.gates}  # the tables replace them
    return compile_plan(
        plan.h, plan.ticks, plan.components, plan.wires, links, plan.algorithm,
        [*plan.players, *players], order, [g for g in plan.gates if g.name not in of_buses],
        adaptive=plan.adaptive, start=plan.start,
    )  # fmt: skip


def _table(link: Link, path: Path, ticks: int) -> StoredTable:
    grid: Grid = link.table.grid
    table = open_table(path, name=link.table.name, grid=grid)
    rows = -(-ticks // grid.n_r)
    if rows > table.length:
        raise ScenarioError(
            f"the table ends at {table.length * grid.n_r * grid.h:g} s, the run at "
            f"{ticks * grid.h:g} s; expected a run.stop that is no later",
            str(path),
        )
    return table
