"""All cases of a comparison: made, run in parallel, and gathered into one result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

from cosim.base.processes import processes
from cosim.comparison.documents import Base, Case, scenario
from cosim.comparison.kept import KeptResults
from cosim.comparison.measure import CaseOutcome, Task, failed_case, run_case
from cosim.comparison.port_columns import PortOutcome, PortTask, run_port
from cosim.comparison.same_links import Tables
from cosim.comparison.variants import ComparisonSelection, MetricColumn, PortMeasure, Variants


@dataclass(frozen=True, slots=True)
class Comparison:
    """The compared cases and their results, in the order of the table."""

    base: Base
    variants: Variants
    chosen: ComparisonSelection
    seeds: tuple[int, ...]
    outcomes: tuple[CaseOutcome, ...]
    tables: Tables

    def of(self, link: str, operator: str, controller: str) -> tuple[CaseOutcome, ...]:
        """The outcomes of one row of the table, a seed each."""
        wanted = (link, operator, controller)
        return tuple(
            o for o in self.outcomes
            if (o.case.link, o.case.operator, o.case.controller) == wanted
        )  # fmt: skip


def cases(chosen: ComparisonSelection, seeds: Sequence[int]) -> list[Case]:
    """Every combination: by link law, operator, controller, seed."""
    return [
        Case(controller, operator, link, seed)
        for link, operator, controller, seed in product(
            chosen.links, chosen.operators, chosen.controllers, seeds
        )
    ]


def compare(
    base: Base,
    variants: Variants,
    chosen: ComparisonSelection,
    seeds: Sequence[int],
    *,
    jobs: int = 1,
    kept: KeptResults | None = None,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> Comparison:
    """Run every case of `chosen` with every seed, but for those whose results are `kept`.

    A failure is an outcome with its reason; :func:`cosim.comparison.documents.check` finds cases
    that cannot be assembled beforehand. `progress` is called with (done, all) runs.
    """
    kept = kept or KeptResults()
    of_runs = [c for c in variants.columns if not isinstance(c.metric, PortMeasure)]
    tasks = [
        Task(
            case,
            scenario(base, variants, case),
            tuple(c for c in of_runs if c.applies(variants.operators[case.operator])),
            variants.stability,
            variants.picture,
            None if kept.runs is None else kept.runs / case.name,
        )
        for case in cases(chosen, seeds)
    ]
    ports = _port_tasks(base, variants, chosen, seeds)
    tables, found, told = Tables(), dict[Case, CaseOutcome](), 0
    total = len(tasks) + len(ports)
    opened = None if jobs < 2 else partial(processes, jobs)
    for task, result in kept.results(run_case, tasks, CaseOutcome, opened):
        found[task.case] = failed_case(task.case, result) if isinstance(result, str) else result
        while told < len(tasks) and tasks[told].case in found:  # in order, whoever was done first
            outcome = found[tasks[told].case]
            tables.add(outcome.case, outcome.tables)
            found[outcome.case] = outcome.without_tables()
            told += 1
        progress(len(found), total)
    measures = kept.results(run_port, ports, PortOutcome, opened)
    for done, (port, measured) in enumerate(measures, len(found) + 1):
        _add(found, port, PortOutcome(reason=measured) if isinstance(measured, str) else measured)
        progress(done, total)
    outcomes = tuple(found[task.case] for task in tasks)
    return Comparison(base, variants, chosen, tuple(seeds), outcomes, tables)


def _port_tasks(
    base: Base, variants: Variants, chosen: ComparisonSelection, seeds: Sequence[int]
) -> list[PortTask]:
    """A test for each controller, link law and seed: at a port the operator makes no difference."""
    columns: tuple[MetricColumn, ...] = tuple(
        c for c in variants.columns if isinstance(c.metric, PortMeasure)
    )
    if not columns or variants.port is None:
        return []
    first = replace(chosen, operators=chosen.operators[:1])
    return [
        PortTask(case, scenario(base, variants, case), variants.port, columns)
        for case in cases(first, seeds)
    ]


def _add(found: dict[Case, CaseOutcome], task: PortTask, measured: PortOutcome) -> None:
    """Give what was measured of a port to the cases of every operator."""
    for case, outcome in found.items():
        if replace(case, operator=task.case.operator) == task.case:
            found[case] = replace(
                outcome,
                numbers={**outcome.numbers, **measured.numbers},
                errors={**outcome.errors, **measured.errors},
                remark=measured.reason,
            )
