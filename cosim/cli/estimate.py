"""Output of ``cosim run --estimate-error``: text, and ``estimate.json`` in the run folder."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.estimate.local_error import ComponentError, Estimate


def lines(found: Estimate) -> list[str]:
    """The estimate as text: a line per component, omitted components with reasons, the advice."""
    from cosim.cli.show import aligned

    text = [
        f"local error of a step, at {found.samples} points "
        f"(in halves and quarters; tolerance {found.tolerance:g} of the largest value)"
    ]
    if found.components:
        text += aligned([_row(c) for c in found.components])
    text += [f"  {name}: not estimated: {why}" for name, why in sorted(found.left_out.items())]
    return [*text, f"{'advice':<16} {_advice(found)}"]


def _row(c: ComponentError) -> list[str]:
    w = c.worst
    order = f"order {w.order:.1f}" if isfinite(w.order) else "order not seen"
    advised = f"step up to {c.advised:.3g} s" if isfinite(c.advised) else "exact at any step"
    return [
        c.name,
        f"step {c.step:g} s",
        f"max {w.largest:.2e} {w.unit} ({w.name}, t = {w.time:g} s)",
        f"rms {w.rms:.2e}",
        order,
        advised,
    ]


def _advice(found: Estimate) -> str:
    if not found.components:
        return "none: no component could be tried"
    if not isfinite(found.advised):
        return "no error seen; sampled components and links decide the step"
    if found.advised >= found.h:
        return f"run.step = {found.h:g} keeps the tolerance; up to {found.advised:g} s would"
    return f"run.step = {found.advised:g} keeps the tolerance; {found.h:g} s does not"


def write(found: Estimate, folder: Path) -> Path:
    """Everything, as JSON; numbers that are not finite become null."""
    from cosim.base.aside import write_file
    from cosim.record.folder import ESTIMATE

    path = folder / ESTIMATE
    write_file(path, json.dumps(_finite(asdict(found)), indent=1) + "\n")
    return path


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not isfinite(value) else value
