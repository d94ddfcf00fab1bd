"""``cosim reproduce``: run a paper's experiments and compare them with its statements."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Protocol, cast

import typer

from cosim.base.convert import Struct
from cosim.base.copies import asdict
from cosim.base.parts import part
from cosim.cli.options import Json, write_json

Row = Mapping[str, Any]


class Reproduction(Protocol):
    """The members of the module; a row is a claim, with the keys of ``claims.json`` and
    ``section``.
    """

    def listing(self, wanted: Sequence[str] = ()) -> list[dict[str, Any]]:
        """The claims about `wanted`, nothing measured."""

    def reproduce(
        self,
        folder: Path,
        wanted: Sequence[str] = (),
        *,
        seed: int,
        jobs: int,
        force: bool,
        progress: Callable[[int, int], None],
    ) -> list[dict[str, Any]]:
        """Run, judge, draw into `folder`; the rows of the table."""

    def write_report(self, rows: Sequence[Row], folder: Path, repeat: str) -> Path:
        """Write ``report.html`` into `folder`; `repeat`: the command."""


class ReproductionOptions(Struct, frozen=True):
    """The runs of a reproduction."""

    jobs: Annotated[int, typer.Option(min=1, help="Number of processes.")] = os.cpu_count() or 1
    seed: Annotated[int, typer.Option(min=0, help="Seed of delays and switching graphs.")] = 0
    force: Annotated[
        bool, typer.Option("--force", help="Replace the results of an earlier reproduction.")
    ] = False


def reproduce(
    runs: ReproductionOptions,
    only: Annotated[
        str,
        typer.Option(
            metavar="LIST", help="Figures, theorems, oracles or claims, e.g. 6,12,thm2,o5."
        ),
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results. Default: runs/reproduce-DATE-TIME.")
    ] = None,
    list_: Annotated[
        bool, typer.Option("--list", help="List the claims, without running anything.")
    ] = False,
    json: Json = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only the claims that fail.")
    ] = False,
) -> None:
    """Reproduce the paper: run Sec. VII and Theorems 1-5, draw figures, check all claims."""
    from cosim.base.clock import stamp, stopwatch
    from cosim.cli.summary import progress_bar, this_command

    wanted = [part.strip() for part in only.split(",") if part.strip()]
    paper = cast(Reproduction, part("paper"))
    if list_:
        typer.echo("\n".join(_listing(paper.listing(wanted))))
        return
    folder = out or Path("runs") / f"reproduce-{stamp()}"
    watch = stopwatch()
    with progress_bar(quiet) as progress:
        rows = paper.reproduce(folder, wanted, **asdict(runs), progress=progress)
    page = paper.write_report(rows, folder, this_command())
    if json is not None:
        write_json(json, "reproduce", {"folder": str(folder), "claims": rows})
    failed = [row for row in rows if not row["passed"]]
    for line in _table(failed if quiet else rows, colour=sys.stdout.isatty()):
        typer.echo(line)
    if not quiet:
        passed = len(rows) - len(failed)
        typer.echo(f"\n{len(rows)} claims: {passed} pass, {len(failed)} FAIL; {watch():.1f} s")
        typer.echo(f"figures, their numbers, runs and claims.json: {folder}")
        typer.echo(f"report: {page}")
    if failed:
        raise typer.Exit(1)


def _table(rows: Iterable[Row], *, colour: bool) -> list[str]:
    """Sections with a line a claim; below what fails, why and where the expectation is from."""
    lines: list[str] = []
    for section, group in groupby(rows, key=lambda row: row["section"]):
        claims = list(group)
        cells = [
            (row["name"], _text(row), row["expected"], _measured(row), row["unit"])
            for row in claims
        ]
        widths = [max(len(cell[i]) for cell in cells) for i in range(4)]
        lines += ["", section]
        for row, cell in zip(claims, cells, strict=True):
            name, text, expected, measured = (
                f"{part:<{width}}" for part, width in zip(cell, widths, strict=False)
            )
            word = _word(row["passed"], colour)
            lines.append(f"  {word}  {name}  {text}  {expected}  {measured}  {cell[4]}".rstrip())
            if not row["passed"]:
                lines.append(f"        {row['note'] or 'expected from: ' + row['source']}")
    return [*lines, *_legend(lines)]


def _legend(lines: Sequence[str]) -> list[str]:
    marked = any("(!)" in line for line in lines)
    return ["", "(!) a hypothesis is broken on purpose: the theorem's conclusion fails"][
        : 2 * marked
    ]


def _text(row: Row) -> str:
    return f"{row['text']} (!)" if row["breaks"] else str(row["text"])


def _measured(row: Row) -> str:
    value = row["measured"]
    if value is None:
        return "nothing"
    if isinstance(value, str):
        return "never" if value == "inf" else value
    return f"{value:.4g}"


def _word(passed: bool, colour: bool) -> str:
    word = "pass" if passed else "FAIL"
    return f"\x1b[{32 if passed else 31}m{word}\x1b[0m" if colour else word


def _listing(rows: Iterable[Row]) -> list[str]:
    """Sections with two lines per claim: its text, and the source of the expected value."""
    lines: list[str] = []
    for section, claims in groupby(rows, key=lambda row: row["section"]):
        lines += ["", section]
        for row in claims:
            about = " ".join(row["about"])
            unit = "" if row["unit"] == "1" else f" {row['unit']}"
            lines.append(f"  {row['name']:<22} {_text(row)} {row['expected']}{unit}")
            lines.append(f"  {'':<22} [{about}] {row['source']}")
    return [*lines, *_legend(lines)]
