"""All cases of a comparison: made, run in parallel, and gathered into one result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

from cosim.base.copies import replace
from cosim.base.processes import processes
from cosim.comparison.documents import Base, Case, scenario
from cosim.comparison.kept import KeptResults, OutcomeRow, run_task
from cosim.comparison.measure import CaseOutcome, Task
from cosim.comparison.port_columns import PortOutcome, PortTask
from cosim.comparison.same_links import Tables
from cosim.comparison.spec import PortMeasure
from cosim.comparison.variants import ComparisonSelection, MetricColumn, Variants
from cosim.study.runner import UNOBSERVED, Observer, run_named


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
            o for o in self.outcomes if (o.case.link, o.case.operator, o.case.controller) == wanted
        )


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
    observer: Observer = UNOBSERVED,
) -> Comparison:
    """Run every case of `chosen` with every seed, but for those whose results are `kept`.

    A failure is an outcome with its reason; :func:`cosim.comparison.documents.check` finds cases
    that cannot be assembled beforehand.
    """
    kept = kept or KeptResults()
    made = tasks(base, variants, chosen, seeds, kept)
    perform(made, kept, jobs, observer)
    tables, found = Tables(kept), dict[Case, CaseOutcome]()
    for name, task in made.items():
        if isinstance(task, Task):
            outcome = kept.case(name, task)
            tables.add(outcome.case, outcome.tables)
            found[outcome.case] = outcome
        else:
            _add(found, task, kept.port(name))
    return Comparison(base, variants, chosen, tuple(seeds), tuple(found.values()), tables)


def tasks(
    base: Base,
    variants: Variants,
    chosen: ComparisonSelection,
    seeds: Sequence[int],
    kept: KeptResults,
) -> dict[str, Task | PortTask]:
    """All tasks of a comparison by the names of their results: runs, then tests of the port."""
    made: dict[str, Task | PortTask] = {
        kept.name(task): task for task in _tasks(base, variants, cases(chosen, seeds), kept)
    }
    return made | {kept.name(task): task for task in _port_tasks(base, variants, chosen, seeds)}


def perform(
    made: Mapping[str, Task | PortTask], kept: KeptResults, jobs: int, observer: Observer
) -> None:
    """Run the tasks whose results are not `kept`; a failure is a result with its reason."""
    every = {name: (name, task) for name, task in made.items()}
    opened = None if jobs < 2 else partial(processes, jobs)
    run_named(run_task, every, kept, opened, observer, died=lambda n, why: OutcomeRow(n, None, why))


def _tasks(
    base: Base, variants: Variants, every: Sequence[Case], kept: KeptResults
) -> Iterator[Task]:
    of_runs = [c for c in variants.columns if not isinstance(c.metric, PortMeasure)]
    for case in every:
        yield Task(
            case,
            scenario(base, variants, case),
            tuple(c for c in of_runs if c.applies(variants.operators[case.operator])),
            variants.stability,
            variants.picture,
            kept.tables,
            None if kept.runs is None else kept.runs / case.name,
        )


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
