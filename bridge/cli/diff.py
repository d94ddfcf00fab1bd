"""``cosim diff``: two runs side by side, whatever they were made by."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct
from cosim.cli.options import Json, finite, write_json

if TYPE_CHECKING:
    from bridge.replay.diff import RunDifference

#: Signals shown if all are asked for; ``--json`` has them all.
SHOWN = 12


class DifferenceFiles(Struct, frozen=True):
    """Files of the differences."""

    json: Json = None
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write a page to look at both.")
    ] = None
    junit: Annotated[
        Path | None,
        typer.Option(
            "--junit",
            metavar="FILE",
            help="Write a test case a signal and requirement, as JUnit XML.",
        ),
    ] = None


def diff(
    run_a: Annotated[Path, typer.Argument(help="Run folder.")],
    run_b: Annotated[Path, typer.Argument(help="Run folder to compare it with.")],
    files: DifferenceFiles,
    signals: Annotated[
        list[str] | None,
        typer.Argument(
            help="Signals to compare: component, component.port or one entry. Default: all.",
            metavar="SIGNAL",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            callback=finite,
            min=0.0,
            help="Allowed difference, RMS and maximum, in the unit of each signal.",
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option("--verify/--no-verify", help="Check the SHA-256 sums of both runs first."),
    ] = True,
) -> None:
    """Compare two runs signal by signal, largest differences first, and print a verdict.

    The runs may be offline, twin, rehearsal or hardware runs. Exit status 1 if they differ, also
    in length.
    """
    from bridge.replay.diff import compare_runs
    from bridge.replay.page import write_diff_page, write_junit
    from cosim.record import verify

    for run in (run_a, run_b) if check else ():
        verify(run)
    found = compare_runs(run_a, run_b, signals or (), tolerance)
    typer.echo("\n".join(lines(found)))
    if files.json is not None:
        write_json(files.json, "diff", found.as_data())
    if files.html is not None:
        write_diff_page(found, files.html)
    if files.junit is not None:
        write_junit(found, files.junit)
    raise typer.Exit(found.exit_code)


def lines(found: RunDifference) -> list[str]:
    """The printed lines."""
    from cosim.cli.show import aligned

    ends = [last for _, last in found.spans]
    text = [f"a  {found.a}", f"b  {found.b}", f"{found.rows} rows to {found.t_end:g} s"]
    if not found.same_span:
        text[0:2] = [f"{line}, to {end:g} s" for line, end in zip(text[:2], ends, strict=True)]
    table = [["signal", "RMS", "largest", "at", "RMS may be", "unit"]]
    for s in found.signals[:SHOWN]:
        bound = f"{s.bound_rms:.3g}" if s.judged else "not judged"
        table.append([s.name, f"{s.rms:.3g}", f"{s.largest:.3g}", f"{s.at:g} s", bound, s.unit])
    text += ["", *aligned(table)]
    if len(found.signals) > SHOWN:
        text.append(f"  … and {len(found.signals) - SHOWN} signals that differ less")
    if found.metrics:
        rows = [["metric", "a", "b", "b - a", "unit"]]
        rows += [
            [m.label, f"{m.a:.5g}", f"{m.b:.5g}", f"{m.b - m.a:.2g}", m.unit] for m in found.metrics
        ]
        text += ["", *aligned(rows)]
    if found.requirements:
        rows = [["requirement", "a", "b"]]
        rows += [[r.name, r.a.text, r.b.text] for r in found.requirements]
        text += ["", *aligned(rows)]
        changed = [r.name for r in found.requirements if r.changed]
        text += [f"changed verdict: {', '.join(changed)}"] if changed else []
    for run, only in zip("ab", found.only, strict=True):
        if only:
            text.append(f"only in {run}: {', '.join(only)}")
    return [*text, *found.remarks, f"verdict: {found.sentence()}"]
