"""A link as a component of a system, so that other co-simulation masters simulate its latency too.

The samples u_k of each step are stored, and the table of the link selects the one that is held::

    y_(k+1) = u_(held_(k+1))        held_(k+1) >= 0
    y_(k+1) = y_0                   held_(k+1) = -1: nothing has arrived yet

y_0 = u_0 is the sender's output at the start, unless the link declares start values. A constant
delay of d steps is held_k = k - d for every k. Any other table is compiled into the model; after
its last row the age of the held sample stays constant.

Continuous: the input is that of t_k and the output that of t_k + h. A Jacobi master passes this
output on at t_(k+1), so that it adds no step to the delay of the link. The delay is counted in
steps, so the communication step must be the one that the model was built for.

Source: own construction; docs/network.md describes the table of a link.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, final

from cosim.base.component import Kind
from fmus.build.archive import Version, pack
from fmus.build.library import compile_models
from fmus.model import Model, Variable

_KIND: Kind = "continuous"


def model(identifier: str, width: int, history: int, unit: str, step: float, table: Path) -> Model:
    """Declare a delay of `width` scalars that keeps `history` samples.

    `table`: the generated header ``delay_table.h``; `step`: what the delay is counted in, s.
    """
    entries = width * history
    return Model(
        identifier=identifier,
        description=f"Latency of a link, in steps of {step:g} s",
        kind=_KIND,
        variables=(
            Variable("u", "input", (width,), unit, description="What is sent"),
            Variable(
                "y", "output", (width,), unit, description="What is held", start_depends=("u",)
            ),
            Variable("before", "local", (width,), unit, description="Held before any arrived"),
            Variable("sent", "local", (entries,), unit, description="The last samples sent"),
            Variable("k", "local", (), "1", description="Steps taken"),
        ),
        sources=("delay.c", str(table)),
        step=step,
        documentation=__doc__ or "",
    )


@final
class LinkDelay(NamedTuple):
    """A link as :func:`build_links` needs it.

    `rows`: the sample that is held after each step, -1: none yet; `width`: number of scalars;
    `step`: s; `initial` (width,): what is held before anything has arrived, None: the input at the
    start.
    """

    identifier: str
    rows: Sequence[int]
    history: int
    width: int
    unit: str
    step: float
    initial: Sequence[float] | None


def build_links(
    links: Sequence[LinkDelay], folder: Path, version: Version = "2.0"
) -> dict[str, Path]:
    """Build an FMU for each of `links` into `folder`; their paths by identifier.

    What their libraries share is compiled once. Raises as :func:`fmus.build.archive.build` does.
    """
    with tempfile.TemporaryDirectory(prefix="delay-") as scratch:
        models = [_declared(link, Path(scratch) / link.identifier) for link in links]
        compiled = compile_models(models)
        return {
            each.identifier: pack(each, version, folder, binaries)
            for each, binaries in zip(models, compiled, strict=True)
        }


def _declared(link: LinkDelay, folder: Path) -> Model:
    """The model of a link, with its table in the new `folder`."""
    folder.mkdir()
    table = folder / "delay_table.h"
    capacity = _capacity(link.rows, link.history)
    table.write_text(_header(link.rows, capacity, link.width, link.initial), encoding="utf-8")
    return model(link.identifier, link.width, capacity, link.unit, link.step, table)


def constant(rows: Sequence[int]) -> int | None:
    """Steps d where the table is that of a constant delay of d steps: held_k = max(k - d, -1)."""
    last = len(rows) - 1
    d = last - rows[last] if rows[last] >= 0 else 0
    return d if d > 0 and all(row == max(k - d, -1) for k, row in enumerate(rows)) else None


def _capacity(rows: Sequence[int], history: int) -> int:
    """Samples to keep: as many as any row looks back, and the newest."""
    ages = [k - row for k, row in enumerate(rows) if row >= 0]
    return max(1, history, *ages)


def _header(rows: Sequence[int], capacity: int, width: int, initial: Sequence[float] | None) -> str:
    d = constant(rows)
    lines = [
        "/* delay_table.h - generated: which sample is held after each step. */",
        f"enum {{ WIDTH = {width}, CAPACITY = {capacity}, DELAY = {d or 0}, "
        f"HAS_INITIAL = {int(initial is not None)}, ROWS = {0 if d else len(rows)} }};",
        f"static const double initial[WIDTH] = {{{', '.join(map(repr, initial or [0.0]))}}};",
    ]
    table = [0] if d else list(rows)
    lines.append(f"static const int held[{len(table)}] = {{")
    for i in range(0, len(table), 16):
        lines.append("    " + ", ".join(map(str, table[i : i + 16])) + ",")
    return "\n".join([*lines, "};", ""])
