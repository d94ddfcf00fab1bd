"""Columns of the scenario's requirements: the margin of each, below 0 where it is violated.

A requirement is a column if all its signals are those of the arms of roles, which every variant
has. Its name is ``NAME.margin``, as in the table of a sweep.
"""

from __future__ import annotations

from collections.abc import Iterator

from cosim.base.copies import replace
from cosim.comparison.documents import Base
from cosim.comparison.requirement_margin import RequirementMargin
from cosim.comparison.variants import MetricColumn, Variants
from cosim.scenario.spec import build


def with_requirements(variants: Variants, base: Base) -> Variants:
    """The variants with a column for each requirement of the scenario, behind their own.

    Raises ScenarioError for requirements that cannot be read.
    """
    margins = _margins(variants, base)
    columns = [MetricColumn(f"{m.name}.margin", f"{m.name}, margin", "", m, ()) for m in margins]
    names = (column.name for column in columns)
    shown = variants.default_columns and (*variants.default_columns, *names)
    return replace(variants, columns=(*variants.columns, *columns), default_columns=shown)


def _margins(variants: Variants, base: Base) -> Iterator[RequirementMargin]:
    document = base.document
    if not document.get("require"):
        return
    kept = {key: document.get(key, {}) for key in ("run", "metrics", "require")}
    declared = build({**kept, "components": {}}, base.path)
    arms = {role.arm for role in variants.roles.values()}
    for name, spec in declared.require.items():
        metrics, signals = {}, spec.names
        if spec.form == "metric":
            of = {metric.partition(".")[0] for metric in spec.names}
            metrics = {m: declared.metrics[m] for m in of if m in declared.metrics}
            targets = (m.target for m in metrics.values() if isinstance(m.target, str))
            read = (signal for m in metrics.values() for signal in (*m.of, *m.contact))
            signals = (*read, *targets)
        if all(signal.partition(".")[0] in arms for signal in signals):
            only = {"require": {name: document["require"][name]}, "components": {}}
            given = {m: document["metrics"][m] for m in metrics}
            parts = {"run": document["run"], "metrics": given, **only}
            yield RequirementMargin(name, parts, tuple(dict.fromkeys(signals)), base.path)
